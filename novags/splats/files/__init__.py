"""Gaussians on disk: the standard PLY, and the small files of web viewers."""
