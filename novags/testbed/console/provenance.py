"""The origin and the cost of a result: versions, hardware, peak memory."""

import os
import platform
import resource
import sys
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from novags.process import give_back
from novags.testbed.console.cores import cores_here

PACKAGES = (
    "novags",
    "numpy",
    "scipy",
    "torch",
    "mitsuba",
    "drjit",
    "numba",
    "gsplat",
    "colour-demosaicing",
    "flip-evaluator",
)
DRIVERS = ("/proc/driver/nvidia", "/dev/nvidiactl", "/dev/dxg", "/dev/kfd")  # of NVIDIA; in WSL; of AMD


def package_version(name: str) -> str | None:
    """Installed version of a distribution, without importing it; None if it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def environment(outside: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Versions and hardware, as every record states them; `outside`: versions of other packages in use, by name."""
    return {"versions": {**_versions(), **(outside or {})}, "hardware": hardware()}


@cache
def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version(), **{name: package_version(name) for name in PACKAGES}}
    return {name: version for name, version in versions.items() if version}


def hardware() -> dict[str, Any]:
    """Processor, cores this process may use, memory, and the GPU that torch sees (None without one)."""
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "cores": cores_here(),
        "memory_bytes": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        "gpu": _gpu(),
    }


def _gpu() -> str | None:
    """Where Linux has no driver that torch could use, torch is not loaded to say so: that takes two seconds."""
    if sys.platform == "linux" and not any(Path(driver).exists() for driver in DRIVERS):
        return None
    import torch

    return torch.cuda.get_device_name(0) if torch.cuda.is_available() else None


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # not Linux: the platform module gives some name
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


class PeakMemory:
    """Peak resident memory of this process from here on, and of the GPU where torch uses one.

    Linux keeps a resettable high-water mark; elsewhere the number is the peak since the process began, an upper bound.
    """

    def __init__(self) -> None:
        give_back()
        try:
            Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # 5: reset VmHWM only
        except OSError:
            pass  # not Linux, or not allowed: the peak then counts from the start of the process, as said above
        torch = sys.modules.get("torch")
        if torch is not None and torch.cuda.is_available():
            torch.cuda.reset_peak_memory_stats()

    def peak_bytes(self) -> int:
        """Bytes; main memory plus GPU memory."""
        torch = sys.modules.get("torch")
        gpu = torch.cuda.max_memory_allocated() if torch is not None and torch.cuda.is_available() else 0
        return _high_water_mark() + int(gpu)


def _high_water_mark() -> int:
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        scale = 1 if sys.platform == "darwin" else 1024  # ru_maxrss: bytes on macOS, kilobytes elsewhere
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale
