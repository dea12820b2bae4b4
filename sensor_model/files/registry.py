"""Tables whose rows are named as text, "module:NAME", and loaded when they are asked for.

A table of objects would import every module of every row: the keys of results could not tell which code a result
depends on, and a list of names would take seconds.
"""

from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, TypeVar

Row = TypeVar("Row")


def loaded(reference: str) -> Any:
    """The object named "module:NAME".

    Raises:
        ValueError: If the text is not of this form.
        ImportError: If there is no such module.
        AttributeError: If the module has nothing of that name.
    """
    module, colon, name = reference.partition(":")
    if not (module and colon and name):
        raise ValueError(f'a row is named as "module:NAME", got {reference!r:.100}')
    return getattr(import_module(module), name)


@dataclass(frozen=True)
class Later:
    """A function that is named as text, and imported when it is called: `Later("package.module:function")`."""

    reference: str

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Call it."""
        return loaded(self.reference)(*args, **kwargs)


class Registry(MutableMapping[str, Row]):
    """Rows by name, in order. A row is given as text, "module:NAME", or as an object."""

    def __init__(self, rows: Mapping[str, str | Row]) -> None:
        self._rows: dict[str, str | Row] = dict(rows)
        self._texts = {name: row for name, row in rows.items() if isinstance(row, str)}

    def __getitem__(self, name: str) -> Row:
        """The row, loaded.

        Raises:
            KeyError: If there is none of that name.
        """
        row = self._rows[name]
        found: Row = loaded(row) if isinstance(row, str) else row
        return found

    def __setitem__(self, name: str, row: str | Row) -> None:  # text is loaded when read
        text = self._texts.get(name)
        self._rows[name] = text if text is not None and loaded(text) is row else row  # a row that is put back

    def __delitem__(self, name: str) -> None:
        del self._rows[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, name: object) -> bool:
        """Whether there is a row of that name; nothing is loaded."""
        return name in self._rows

    def module_of(self, name: str) -> str | None:
        """The module of a row; None of a row that was given as an object, or is not there."""
        row = self._rows.get(name)
        return row.partition(":")[0] if isinstance(row, str) else None
