"""Parts that work on this machine, parts that do not, and how to install missing ones."""

import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from novags.testbed.console.provenance import hardware, package_version
from novags.testbed.metrics import METRICS
from sensor_model.files.python import INTERPRETER, python

GSPLAT = "pip install 'novags[cuda]'"


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
    yield _package("pycolmap", "pip install 'pycolmap>=4'")
    yield _cuda(machine["gpu"])
    yield _gsplat(machine["gpu"])
    yield from _mitsuba()
    yield _kernels()
    for metric in METRICS.values():
        if metric.missing is not None:
            why = metric.missing()
            yield Finding(metric.heading, "missing" if why else "ok", why or "package and weights found")


def _python() -> Finding:
    good = (3, 10) <= sys.version_info[:2] <= (3, 13)
    detail = f"{platform.python_version()} at {INTERPRETER}"
    return Finding("Python", "ok" if good else "broken", detail if good else f"{detail}; 3.10 to 3.13 are supported")


def _package(name: str, how: str) -> Finding:
    version = package_version(name)
    if version is None:
        return Finding(name, "broken", f"not installed: {how}")
    problem = _import_problem(name)
    return (
        Finding(name, "broken", f"{version} cannot be imported ({problem}): {how}")
        if problem
        else Finding(name, "ok", version)
    )


def _import_problem(module: str) -> str:
    """The error of importing it, "" if there is none: in a process of its own, which a broken library may end."""
    try:
        done = subprocess.run(python(f"import {module}"), capture_output=True, text=True, timeout=300, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"the attempt did not finish: {error}"
    if done.returncode == 0:
        return ""
    return (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]


def _cuda(gpu: str | None) -> Finding:
    if not gpu:
        return Finding("CUDA", "missing", "no GPU that torch can use; everything runs on the processor")
    renders = "Mitsuba renders on it if cuda_ad works below"
    if package_version("gsplat") is None:
        return Finding("CUDA", "missing", f"{gpu}; fits run on the processor until {GSPLAT}, {renders}")
    return Finding("CUDA", "ok", f"{gpu}; fits run on it (--device cpu: not), {renders}")


def _gsplat(gpu: str | None) -> Finding:
    use = "for fits on the GPU" if gpu else "for fits on a GPU, which this machine does not have"
    if (version := package_version("gsplat")) is not None:
        return Finding("gsplat", "ok", f"{version}; {use}")
    return Finding("gsplat", "missing", f"{use}: {GSPLAT}")


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
    """Where compiled kernels are kept; without a writable place they are compiled in every process."""
    version = package_version("numba")
    try:
        from novags.splats.cpu.compiler import cache_folder
    except ImportError as error:
        return Finding("numba", "broken", f"{version}; the engine of the splats cannot be imported: {error}")
    if (folder := cache_folder()) is not None and os.access(folder, os.W_OK):
        return Finding("numba", "ok", f"{version}; keeps compiled kernels in {folder.parent}")
    why = f"{folder} is not writable" if folder else "no folder for compiled kernels can be this user's alone"
    how = "set NUMBA_CACHE_DIR to a folder that nobody else may write"
    return Finding("numba", "missing", f"{version}, but {why}, so kernels compile anew each time: {how}")
