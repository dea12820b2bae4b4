"""The decorators of CPU kernels, and where their machine code is kept between runs."""

import hashlib
import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from numba import config, njit

KEEP_DAYS = 30
FLAGS = ("contract", "nsz")  # neither reassociation nor nnan: results must not depend on how a compiler regroups sums
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": set(FLAGS)}  # Python's division check stops vectorising


def cache_folder() -> Path:
    """A folder named after the sources of all kernels; those of other sources go when unused for KEEP_DAYS.

    Numba notices when the file of a kernel changes, not when a file it calls into, or takes constants from, does; stale
    machine code would then run.
    """
    here = Path(__file__).parent
    fields = here.parents[1] / "fields" / "cpu"  # whose kernels inline those of here
    sources = [*sorted(here.rglob("*.py")), here.parent / "sh.py", *sorted(fields.glob("*.py"))]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:16]
    if config.CACHE_DIR:
        base = Path(config.CACHE_DIR)
    elif os.access(here, os.W_OK):
        base = here / "__pycache__"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "novags"
    folder = base / f"kernels-{digest}"
    with suppress(OSError):  # not there yet, or somebody else's
        os.utime(folder)
    for other in base.glob(f"kernels-{'[0-9a-f]' * 16}"):  # nobody else's: the folder may be shared
        with suppress(OSError):  # another process was faster
            if other != folder and other.stat().st_mtime < time.time() - KEEP_DAYS * 86400:
                shutil.rmtree(other)
    return folder


_CACHE = str(cache_folder())


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile at the first call, keep the machine code on disk, run without the GIL."""
    previous, config.CACHE_DIR = config.CACHE_DIR, _CACHE
    try:
        return njit(nogil=True, cache=True, no_cfunc_wrapper=True, **_OPTIONS)(function)
    finally:
        config.CACHE_DIR = previous


def inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that only kernels call; becomes part of them."""
    return njit(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, **_OPTIONS)(function)
