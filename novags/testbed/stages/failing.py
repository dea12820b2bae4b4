"""Which stage an exception comes from."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def failing_in(stage: str) -> Iterator[None]:
    """Say in an exception which stage raised it; of stages within each other it is the innermost."""
    try:
        yield
    except BaseException as error:
        if not getattr(error, "stage", ""):
            error.stage = stage  # type: ignore[attr-defined]
        raise
