"""How a process of ours computes: speed, and the same bits whatever else the machine does.

Commands and workers call `settle` first. Importing novags changes nothing in a process; who uses it as a library calls
`settle` before torch is imported, or sets `ENVIRONMENT` before it starts Python.
"""

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

ENVIRONMENT = {
    # Idle threads of torch's OpenMP spin by default, and steal the time of whatever else runs on a machine with few or
    # busy cores. Not spinning at all makes them sleep and wake between the short layers of the denoiser. So they spin
    # briefly.
    "OMP_WAIT_POLICY": "PASSIVE",
    "GOMP_SPINCOUNT": "20000",
    # On busy cores MKL sums small products of matrices in an order that changes from call to call, unless told not to:
    # the last bits of a network's gradients, and of resumed fits of small pictures, would change.
    "MKL_CBWR": "AUTO",
    # colour-science warns of plots that it cannot draw without matplotlib; nobody asks it to.
    "COLOUR_SCIENCE__FILTER_USAGE_WARNINGS": "True",
}  # read by these libraries when they are loaded or first used
# Each iteration of a fit frees its arrays, and the next one asks for the same again. glibc returns them to the system
# in between, which hands them out again page by page and filled with zeros: a third of the time of a fit whose loss is
# torch's. Freed memory is kept instead, in blocks of up to the first of these sizes, up to the second in all.
KEPT = {"MMAP": 64 << 20, "TRIM": 1 << 30}
SPARING = 1 << 20  # bytes; blocks that are larger are returned where memory is short
_NUMBERS = {"MMAP": -3, "TRIM": -1}  # as in malloc.h
_settled: set[str] = set()


def settle() -> None:
    """Set what the user has not set himself. Must be called before torch is imported, to have its whole effect."""
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    with suppress(AttributeError, OSError, TypeError):  # other C libraries have no mallopt, keeping memory as they like
        mallopt = ctypes.CDLL(None).mallopt
        for name, size in KEPT.items():
            if f"MALLOC_{name}_THRESHOLD_" not in os.environ:  # else the user's own choice holds
                mallopt(_NUMBERS[name], size)
                _settled.add(name)


def give_back() -> None:
    """Return freed memory that `settle` keeps to the system, before other arrays are wanted or a peak is measured."""
    with suppress(AttributeError, OSError, TypeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


@contextmanager
def sparing(wanted: bool = True) -> Iterator[None]:
    """Return large blocks to the system as soon as they are freed, if `wanted`; before, all free memory.

    Arrays of whole pictures have many sizes. What one of them frees is cut into pieces for smaller ones if it is kept,
    and the next large one finds no place: a step of a network on 1 Mpx would hold a third more than its maps.
    """
    if wanted:
        give_back()
    if not wanted or "MMAP" not in _settled:
        yield
        return
    ctypes.CDLL(None).mallopt(_NUMBERS["MMAP"], SPARING)
    try:
        yield
    finally:
        ctypes.CDLL(None).mallopt(_NUMBERS["MMAP"], KEPT["MMAP"])
