"""Too little memory, said in one line; how much there is."""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from novags.testbed.console.groups import levels

MEMINFO = Path("/proc/meminfo")
# Messages of libraries without an exception class for lack of memory. The system's own words count in any error; the
# words of torch, OpenCV and Dr.Jit count only in an error that a library raises.
_SYSTEM = re.compile(r"cannot allocate memory|can't allocate memory|failed to map segment", re.I)
_LIBRARIES = re.compile(r"not enough memory|out of memory|insufficient memory", re.I)


@contextmanager
def memory_shortage_said(what: str) -> Iterator[None]:
    """Turn every library's way to report that there is too little memory into one that says what to do.

    Args:
        what: The work that needs the memory.

    Raises:
        MemoryError: For such an error; others pass.
    """
    try:
        yield
    except Exception as error:
        if not is_memory_shortage(error):
            raise
        where = "the GPU's memory" if _of_gpu(error) else "memory"
        first = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise MemoryError(
            f"{what}: {where} is not enough ({first[:200]}): finished work is kept; free some and run the same "
            "again, or choose fewer points, smaller images or fewer views"
        ) from error


def is_memory_shortage(error: BaseException) -> bool:
    """Whether an exception says that there is too little memory."""
    if isinstance(error, MemoryError) or _of_gpu(error):
        return True
    by_library = isinstance(error, RuntimeError) or type(error).__module__.startswith("cv2")
    return bool(_SYSTEM.search(str(error)) or (by_library and _LIBRARIES.search(str(error))))


def _of_gpu(error: BaseException) -> bool:
    torch = sys.modules.get("torch")  # if it is not loaded, the error is not its
    return torch is not None and isinstance(error, torch.cuda.OutOfMemoryError)


def available_bytes() -> int:
    """Main memory that a further process can take: the system's free memory, less where a group of processes has less.

    Linux says both; elsewhere it is the whole memory, which is an upper bound.
    """
    try:
        lines = MEMINFO.read_text(encoding="ascii").splitlines()
        free = next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min([free, *_left_to_groups()])


def _left_to_groups() -> Iterator[int]:
    """The rest within the limits of this process's control groups, where they have one (version 2, then 1)."""
    for group in levels("memory"):
        for limit, used, cached in (
            ("memory.max", "memory.current", "inactive_file"),
            ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
        ):
            try:
                most, now = (int((group / name).read_text(encoding="ascii")) for name in (limit, used))
                lines = (group / "memory.stat").read_text(encoding="ascii").splitlines()
                spare = next((int(line.split()[1]) for line in lines if line.split()[0] == cached), 0)  # on demand
            except (OSError, ValueError, IndexError):  # no such file, or "max": no limit
                continue
            yield max(0, most - now + spare)


def resident_bytes(process: int) -> int:
    """Main memory that a process holds; 0 where that is not known."""
    try:
        return int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0
