"""Numba twins of the samplers and of the capture chain."""
