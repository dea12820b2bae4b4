"""How many cores there are to work on."""

import math
import os
from pathlib import Path

GROUP = Path("/sys/fs/cgroup")
QUOTAS = (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us"))  # of versions 2 and 1: quota, then period


def cores_here() -> int:
    """Cores of this machine that this process may use, at most those whose time its control group has."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min([cores, *_of_group()])


def _of_group() -> list[int]:
    """The limit of this process's control group, of a container say, in whole cores, if it has one."""
    for names in QUOTAS:
        try:
            quota, period = (int(word) for name in names for word in (GROUP / name).read_text("ascii").split())
            return [math.ceil(quota / period)] if quota > 0 else []
        except (OSError, ValueError, ZeroDivisionError):  # no such file, or "max": no limit
            continue
    return []
