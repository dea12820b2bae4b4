"""Denoise, then fit: a network that was trained on simulated cameras, adapted to the capture."""
