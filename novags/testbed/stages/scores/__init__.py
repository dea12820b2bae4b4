"""Scores of pictures from elsewhere, and of what is left of the noise."""
