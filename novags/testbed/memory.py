"""Too little memory, said in one line."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# How those that have no class for it put it. The system's own words, whatever error they are passed on in; and those of
# torch, OpenCV and Dr.Jit, which are taken for that only in an error that a library raises.
_SYSTEM = re.compile(r"cannot allocate memory|can't allocate memory|failed to map segment", re.I)
_LIBRARIES = re.compile(r"not enough memory|out of memory|insufficient memory", re.I)


@contextmanager
def memory_shortage_said(what: str) -> Iterator[None]:
    """Turn every library's way to report that there is too little memory into one that says what to do.

    Args:
        what: What needs the memory.

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
            f"{what}: {where} is not enough ({first[:200]}): what is finished is kept; free some and run the same "
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
