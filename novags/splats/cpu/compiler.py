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

from sensor_model.files.own import cache_folder as user_cache
from sensor_model.files.own import own_folder

KEEP_DAYS = 30
FLAGS = ("contract", "nsz")  # neither reassociation nor nnan: results must not depend on how a compiler regroups sums
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": set(FLAGS)}  # Python's division check stops vectorising


def cache_folder() -> Path | None:
    """A folder named after the sources of all kernels; folders of other sources go when unused for KEEP_DAYS.

    Numba notices when the file of a kernel changes, not when a file it calls into, or takes constants from, does; stale
    machine code would then run. Numba runs any code it finds, whoever wrote it: None if no folder can be this user's
    alone.
    """
    here = Path(__file__).parent
    fields = here.parents[1] / "fields" / "cpu"  # whose kernels inline the kernels here
    sources = [*sorted(here.rglob("*.py")), here.parent / "sh.py", *sorted(fields.glob("*.py"))]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:16]
    name = f"kernels-{digest}"
    beside = [here / "__pycache__" / name] if os.access(here, os.W_OK) else []
    for folder in [Path(config.CACHE_DIR, name)] if config.CACHE_DIR else [*beside, user_cache(name)]:
        with suppress(OSError):
            own_folder(folder)
            _keep(folder)
            return folder
    return None


def _keep(folder: Path) -> None:
    """Mark a folder as used, and remove folders of other sources that have long been unused."""
    with suppress(OSError):  # root's
        os.utime(folder)
    for other in folder.parent.glob(f"kernels-{'[0-9a-f]' * 16}"):
        with suppress(OSError):  # somebody else's, or another process was faster
            if other != folder and other.lstat().st_mtime < time.time() - KEEP_DAYS * 86400:
                shutil.rmtree(other)


_CACHE = cache_folder()


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile at the first call, keep the machine code on disk, run without the GIL."""
    previous, config.CACHE_DIR = config.CACHE_DIR, str(_CACHE or "")
    try:
        return njit(nogil=True, cache=_CACHE is not None, no_cfunc_wrapper=True, **_OPTIONS)(function)
    finally:
        config.CACHE_DIR = previous


def inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that only kernels call; becomes part of them."""
    return njit(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, **_OPTIONS)(function)
