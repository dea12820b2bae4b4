"""Scores of pictures from elsewhere, and of the remaining noise."""
