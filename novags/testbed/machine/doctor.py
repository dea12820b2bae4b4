"""What works on this machine, what does not, and how to install what is missing."""

import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from novags.testbed.machine.provenance import hardware, package_version
from novags.testbed.metrics import PerceptualDistance

GSPLAT_USE = "only for novags.splats.rasterize with CUDA tensors of your own"


@dataclass(frozen=True)
class Finding:
    """The result of one check. `state`: "ok"; "missing": optional, `detail` says how to get it; "broken": needed."""

    name: str
    state: Literal["ok", "missing", "broken"]
    detail: str


def examine() -> Iterator[Finding]:
    """Check everything, one finding at a time (Mitsuba's variants take some seconds the first time)."""
    yield _python()
    machine = hardware()
    memory = machine["memory_bytes"] / 2**30
    yield Finding("machine", "ok", f"{machine['processor']}, {machine['cores']} cores, {memory:.0f} GiB")
    yield _package("torch", "pip install torch")
    yield _cuda(machine["gpu"])
    yield _gsplat(machine["gpu"])
    yield from _mitsuba()
    yield _kernels()
    missing = PerceptualDistance.missing()
    yield Finding("LPIPS", "missing" if missing else "ok", missing or "package and weights found")


def _python() -> Finding:
    good = (3, 10) <= sys.version_info[:2] <= (3, 13)
    detail = f"{platform.python_version()} at {sys.executable}"
    return Finding("Python", "ok" if good else "broken", detail if good else f"{detail}; 3.10 to 3.13 are supported")


def _package(name: str, how: str) -> Finding:
    version = package_version(name)
    return Finding(name, "ok", version) if version else Finding(name, "broken", f"not installed: {how}")


def _cuda(gpu: str | None) -> Finding:
    if gpu:
        return Finding(
            "CUDA", "ok", f"{gpu}; Mitsuba renders on it if cuda_ad works below, training uses the processor"
        )
    return Finding("CUDA", "missing", "no GPU that torch can use; everything runs on the processor")


def _gsplat(gpu: str | None) -> Finding:
    if (version := package_version("gsplat")) is not None:
        return Finding("gsplat", "ok", f"{version}; {GSPLAT_USE}")
    where = "" if gpu else ", and this machine has no GPU"
    return Finding("gsplat", "missing", f"{GSPLAT_USE}{where}: scripts/setup cuda")


def _mitsuba() -> Iterator[Finding]:
    from simscenes.backend import BACKENDS, backend_status

    found = _package("mitsuba", "pip install 'mitsuba>=3.9,<3.10'")
    yield found
    if found.state == "broken":
        return
    for backend in BACKENDS:
        works, reason = backend_status(backend)
        yield Finding(f"mitsuba {backend}", "ok" if works else "missing", reason)


def _kernels() -> Finding:
    """Numba keeps compiled kernels beside the sources; without a writable place it compiles in every process."""
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(__file__).resolve().parents[2] / "splats")
    version = package_version("numba")
    if os.access(folder, os.W_OK):
        return Finding("numba", "ok", f"{version}; keeps compiled kernels in {folder}")
    how = "set NUMBA_CACHE_DIR to a folder you may write"
    return Finding(
        "numba", "missing", f"{version}, but {folder} is not writable, so kernels compile anew each time: {how}"
    )
