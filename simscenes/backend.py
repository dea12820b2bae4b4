"""A Mitsuba variant that works on this machine.

A libLLVM that Dr.Jit accepts but cannot use aborts the whole process (version 15 lacks the instruction selection for
NaN-propagating minima), so nothing is tried in this process: each candidate traces a few rays in a subprocess first.
"""

from __future__ import annotations

import ctypes
import functools
import glob
import hashlib
import importlib.metadata
import json
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sensor_model.files.own import remember, remembered
from sensor_model.files.python import python

BACKENDS = ("cuda_ad", "llvm_ad", "scalar")  # fastest first
COLORS = ("rgb", "spectral", "spectral_polarized")
OLDEST_LLVM = 16
INSTALL_HINT = "install a newer one (Debian or Ubuntu: apt-get install libllvm19) or point DRJIT_LIBLLVM_PATH at it"

_PLACES = (
    "/usr/lib/*-linux-gnu/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
    f"{sys.prefix}/lib/libLLVM*.so*",
)

# dr.minimum is the operation that old LLVM versions abort on; the rays prove Embree or OptiX as well.
_PROBE = """
import sys, drjit as dr, mitsuba as mi
mi.set_variant(sys.argv[1])
assert list(dr.minimum(mi.Float([1, 2]), mi.Float([2, 1]))) == [1, 1]
scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere"}})
rays = mi.Ray3f(mi.Point3f(0, 0, 3), mi.Vector3f(mi.Float([0, 0.9]), 0, -1))
assert list(scene.ray_intersect(rays).is_valid()) == [True, False]
print("works")
"""


@dataclass(frozen=True)
class VariantStatus:
    """Whether a Mitsuba variant works here; `reason` names the library found, or says why it does not work and how to
    help.
    """

    variant: str
    works: bool
    reason: str


def llvm_candidates() -> list[Path]:
    """Shared libraries that may be libLLVM: first the path in DRJIT_LIBLLVM_PATH, then the newest."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    found = {os.path.realpath(f) for pattern in _PLACES for f in glob.glob(pattern)}
    by_age = sorted(found, key=lambda f: (_llvm_version(Path(f)) or 0, f), reverse=True)
    return [Path(f) for f in ([chosen] if chosen else []) + [f for f in by_age if f != chosen]]


def _llvm_version(library: Path) -> int | None:
    match = re.search(r"libLLVM\D*(\d+)", library.name)
    return int(match.group(1)) if match else None


def _run_probe(variant: str, library: Path | None) -> str:
    """Try a variant in a subprocess: "" if it works, else the error."""
    env = dict(os.environ)
    if library is not None:
        env["DRJIT_LIBLLVM_PATH"] = str(library)
    try:
        done = subprocess.run(
            python(_PROBE, variant), env=env, capture_output=True, text=True, timeout=120, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"the probe did not finish ({error})"
    if done.returncode == 0 and "works" in done.stdout:
        return ""
    if done.returncode < 0:
        return f"it aborts the process (signal {-done.returncode})"
    lines = (done.stderr + done.stdout).strip().splitlines()
    return next((line.strip() for line in reversed(lines) if line.strip()), f"exit status {done.returncode}")


def _probe(variant: str, library: Path | None, stamp: str) -> str:
    """Probe once per machine: successes are remembered in the user's cache folder, failures are tried again."""
    identity = json.dumps([variant, str(library), stamp, *map(importlib.metadata.version, ("drjit", "mitsuba"))])
    name = hashlib.sha256(identity.encode()).hexdigest()[:24]
    if remembered("variants", name):
        return ""
    problem = _run_probe(variant, library)
    if not problem:
        remember("variants", name)
    return problem


@functools.lru_cache(maxsize=1)
def _working_llvm() -> tuple[Path | None, str]:
    """The first libLLVM that works, or None; and a line about the search."""
    problems = []
    for library in llvm_candidates():
        version = _llvm_version(library)
        if not library.is_file():
            problems.append(f"{library} does not exist")
        elif version is not None and version < OLDEST_LLVM:
            problems.append(f"{library.name} is too old (Dr.Jit aborts below {OLDEST_LLVM})")
        else:
            stat = library.stat()
            problem = _probe("llvm_ad_rgb", library, f"{stat.st_mtime_ns} {stat.st_size}")
            if not problem:
                return library, f"uses {library}"
            problems.append(f"{library.name}: {problem}")
    found = "; ".join(problems) if problems else "no libLLVM found"
    return None, f"{found}; {INSTALL_HINT}"


@functools.lru_cache(maxsize=1)
def _working_cuda() -> tuple[bool, str]:
    driver = Path("/proc/driver/nvidia/version")
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False, "no NVIDIA driver (libcuda.so.1) found"
    problem = _probe("cuda_ad_rgb", None, driver.read_text() if driver.is_file() else "")
    return not problem, problem or "NVIDIA GPU with OptiX"


def backend_status(backend: str) -> tuple[bool, str]:
    """Whether one of `BACKENDS` works here, and the library found or a remedy."""
    if backend == "cuda_ad":
        return _working_cuda()
    if backend == "llvm_ad":
        library, reason = _working_llvm()
        return library is not None, reason
    return True, "always works; one sample at a time, several times slower than llvm_ad"


def variant_report() -> list[VariantStatus]:
    """Every variant that rendering can use, whether it works here, and why not. Does not import mitsuba."""
    status = {b: backend_status(b) for b in BACKENDS}
    return [VariantStatus(f"{b}_{c}", *status[b]) for b in BACKENDS for c in COLORS]


def choose_variant(variant: str = "auto", color: str = "rgb") -> str:
    """Name of the Mitsuba variant to use.

    Args:
        variant: "auto" for the fastest that works; a backend ("llvm_ad", ...); or a whole variant name.
        color: "rgb", "spectral" or "spectral_polarized"; used when `variant` does not name one.

    Raises:
        ValueError: If the variant does not exist, or was requested by name and does not work here.
    """
    if color not in COLORS:
        raise ValueError(f"color must be one of {COLORS}, got {color!r}")
    if variant == "auto":
        backend = next(b for b in BACKENDS if backend_status(b)[0])
        if backend == "scalar":
            warnings.warn(
                f"rendering falls back to the slow scalar variant: {backend_status('llvm_ad')[1]}", stacklevel=2
            )
        return f"{backend}_{color}"
    names = [f"{b}_{c}" for b in BACKENDS for c in COLORS]
    full = f"{variant}_{color}" if variant in BACKENDS else variant
    if full not in names:
        raise ValueError(f"variant must be 'auto', one of {BACKENDS} or one of {names}, got {variant!r}")
    works, reason = backend_status(next(b for b in BACKENDS if full.startswith(b)))
    if not works:
        raise ValueError(f"variant {full} does not work on this machine: {reason}")
    return full


def backend_of(variant: str = "auto") -> str:
    """The member of `BACKENDS` that a variant, as for `choose_variant`, runs on."""
    full = choose_variant(variant)
    return next(b for b in BACKENDS if full.startswith(b))


def activate(variant: str = "auto", color: str = "rgb") -> Any:
    """Set a working Mitsuba variant permanently and return the `mitsuba` module; temporarily: `using_variant`.

    Raises:
        ValueError: As `choose_variant`.
    """
    name = choose_variant(variant, color)
    library, _ = _working_llvm()
    # Loading mitsuba initialises Dr.Jit, which takes whatever libLLVM it finds first: it must see the working library.
    if library is not None:
        os.environ["DRJIT_LIBLLVM_PATH"] = str(library)
    import mitsuba as mi

    if mi.variant() is None:
        _more_than_one_thread()
    if mi.variant() != name:
        _switch(mi, name)
        # Below errors Mitsuba prints to stdout, past Python's warnings; serious faults are checked on our side.
        mi.set_log_level(mi.LogLevel.Error)
    return mi


@contextmanager
def using_variant(variant: str = "auto", color: str = "rgb") -> Iterator[Any]:
    """The `mitsuba` module in a working variant; afterwards the variant that was set before is set again.

    Where none was set before, which is a state that Mitsuba cannot return to, this one stays.

    Raises:
        ValueError: As `choose_variant`.
    """
    loaded = sys.modules.get("mitsuba")
    before = loaded.variant() if loaded is not None else None
    mi = activate(variant, color)
    try:
        yield mi
    finally:
        if before is not None and mi.variant() != before:
            _switch(mi, before)


def _more_than_one_thread() -> None:
    """Two threads where there is one core: with one alone, Mitsuba waits for ever where it reads or writes OpenEXR."""
    import drjit as dr

    if dr.thread_count() < 2:
        dr.set_thread_count(2)


def _switch(mi: Any, variant: str) -> None:
    """Set a variant, without Dr.Jit's warning from the 72nd time on about how Mitsuba loads its own Python code."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The AST-transforming decorator", RuntimeWarning)
        mi.set_variant(variant)
