"""Results that are expensive to make and cheap to keep, within a memory limit."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

Result = TypeVar("Result")

LIMIT = 100_000_000  # bytes; beyond it the least recently used results are dropped and made again
SMALL = 1e-4  # of the limit: a result that is not worth dropping


class Memo:
    """Keeps results by key, the most recently used ones where they do not all fit."""

    def __init__(self, limit: int = LIMIT) -> None:
        self.limit, self.size = limit, 0
        self.kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()

    def once(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """The result kept under `key`, or the result of `make`, which is kept from now on."""
        if key in self.kept:
            self.kept.move_to_end(key)
            found: Result = self.kept[key][0]
            return found
        made = make()
        self.kept[key] = made, (size := bytes_of(made))
        self.size += size
        if self.size > self.limit:
            large = [other for other, (_, size) in self.kept.items() if size > SMALL * self.limit]
            for other in large[:-1]:
                self.size -= self.kept.pop(other)[1]
                if self.size <= self.limit:
                    break
        return made


def bytes_of(value: Any) -> int:
    """Bytes of the arrays and tensors in a result."""
    if isinstance(value, tuple | list):
        return sum(bytes_of(part) for part in value)
    return int(getattr(value, "nbytes", 0))
