"""Numba kernels of the radiance field; everything here works on flat or contiguous float32 arrays."""
