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
# torch's. What is freed is kept instead, in blocks of up to the first of these sizes, up to the second in all.
with suppress(AttributeError, OSError, TypeError):  # other C libraries have no mallopt, and keep what they like
    _mallopt = ctypes.CDLL(None).mallopt
    for _name, _number, _size in (("MMAP", -3, 256 << 20), ("TRIM", -1, 1 << 30)):  # numbers as in malloc.h
        if f"MALLOC_{_name}_THRESHOLD_" not in os.environ:  # else the user's own choice holds
            _mallopt(_number, _size)
