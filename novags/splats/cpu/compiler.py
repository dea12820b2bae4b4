"""The decorators of CPU kernels, and where their machine code is kept between runs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit

from sensor_model.fast.machine_code import compiled, folder_for

FLAGS = ("contract", "nsz")  # neither reassociation nor nnan: results must not depend on how a compiler regroups sums
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": set(FLAGS)}  # Python's division check stops vectorising


def cache_folder() -> Path | None:
    """A folder named after the sources of all kernels, see `folder_for`."""
    here = Path(__file__).parent
    fields = here.parents[1] / "fields" / "cpu"  # whose kernels inline the kernels here
    return folder_for([*sorted(here.rglob("*.py")), here.parent / "sh.py", *sorted(fields.glob("*.py"))])


CACHE = cache_folder()


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile at the first call, keep the machine code on disk, run without the GIL."""
    made: Callable[..., Any] = compiled(function, CACHE, nogil=True, no_cfunc_wrapper=True, **_OPTIONS)
    return made


def inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that only kernels call; becomes part of them."""
    return njit(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, **_OPTIONS)(function)
