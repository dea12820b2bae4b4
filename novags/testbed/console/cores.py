"""How many cores there are to work on."""

import math
import os
from collections.abc import Iterator

from novags.testbed.console.groups import levels

QUOTAS = (("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us"))  # of versions 2 and 1: quota, then period


def cores_here() -> int:
    """Cores of this machine that this process may use, at most the number whose time its control groups have."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min([cores, *_of_groups()])


def _of_groups() -> Iterator[int]:
    """The limits of this process's control groups, of a container say, in whole cores, where they have one."""
    for group in levels("cpu"):
        for names in QUOTAS:
            try:
                quota, period = (int(word) for name in names for word in (group / name).read_text("ascii").split())
                cores = math.ceil(quota / period)
            except (OSError, ValueError, ZeroDivisionError):  # no such file, or "max": no limit
                continue
            if quota > 0:
                yield cores
