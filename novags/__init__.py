"""Test bed for low-light 3D reconstruction: NOVA-GS, its rivals, and their score against the truth."""

import ctypes
import os
from contextlib import suppress

# Idle threads of torch's OpenMP spin by default, and steal the time of whatever else runs on a machine with few or busy
# cores. Not spinning at all makes them sleep and wake between the short layers of the denoiser. So they spin briefly.
# Must be set before torch loads.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "20000")

# On busy cores MKL sums small products of matrices in an order that changes from call to call, unless told not to: the
# last bits of a network's gradients, and of resumed fits of small pictures, would change. Must be set before its first
# use.
os.environ.setdefault("MKL_CBWR", "AUTO")

# Each iteration of a fit frees its arrays, and the next one asks for the same again. glibc returns them to the system
# in between, which hands them out again page by page and filled with zeros: a third of the time of a fit whose loss is
# torch's. What is freed is kept instead, up to the second of these sizes, in blocks of up to the first.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h
with suppress(AttributeError, OSError, TypeError):  # another C library has no mallopt, or cannot be asked
    if not any(name.startswith("MALLOC_") for name in os.environ):  # the user's own choice
        _libc = ctypes.CDLL(None)
        _libc.mallopt(M_MMAP_THRESHOLD, 256 << 20)
        _libc.mallopt(M_TRIM_THRESHOLD, 1 << 30)
