"""Tables whose rows are named as text, "module:NAME", and loaded when they are asked for.

A table of objects would import every module of every row: the keys of results could not tell which code a result
depends on, and a list of names would take seconds.
"""

from __future__ import annotations

from collections.abc import ItemsView, Iterator, Mapping, MutableMapping, ValuesView
from dataclasses import dataclass
from importlib import import_module
from typing import Any, TypeVar

from sensor_model.files import outside
from sensor_model.files.outside import BrokenRow, Origin, Outside, once

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
    """Rows by name, in order: ours, given as text, "module:NAME", or as objects, then rows from outside.

    Args:
        rows: Ours.
        group: Where rows from outside are entered, see `outside`; None: nowhere.
        kind: The class of every row from outside.
    """

    def __init__(self, rows: Mapping[str, str | Row], group: str | None = None, kind: type[Row] | None = None) -> None:
        self._rows: dict[str, str | Row] = dict(rows)
        self._texts = {name: row for name, row in rows.items() if isinstance(row, str)}
        self._group, self._kind = group, kind

    def __getitem__(self, name: str) -> Row:
        """The row, loaded.

        Raises:
            KeyError: If there is none of that name; `BrokenRow` for one from outside that cannot be used.
        """
        found: Row
        if name not in self._rows and name in (more := self._outside()):
            found = more[name].load(self._kind)
        else:
            row = self._rows[name]
            found = loaded(row) if isinstance(row, str) else row
        return found

    def __setitem__(self, name: str, row: str | Row) -> None:  # text is loaded when read
        text = self._texts.get(name)
        self._rows[name] = text if text is not None and loaded(text) is row else row  # a row that is put back

    def __delitem__(self, name: str) -> None:
        del self._rows[name]

    def __iter__(self) -> Iterator[str]:
        return iter([*self._rows, *self._outside()])

    def __len__(self) -> int:
        return len(self._rows) + len(self._outside())

    def __contains__(self, name: object) -> bool:
        """Whether there is a row of that name; nothing is loaded."""
        return name in self._rows or name in self._outside()

    def items(self) -> ItemsView[str, Row]:
        """Names and rows. Rows from outside that cannot be used are left out, with a warning."""
        return _Usable(self)

    def values(self) -> ValuesView[Row]:
        """The rows, as of `items`."""
        return _UsableRows(self)

    def module_of(self, name: str) -> str | None:
        """The module of a row; None of a row that was given as an object, or is not there."""
        row = self._rows.get(name)
        if row is None and name in (more := self._outside()):
            return more[name].module
        return row.partition(":")[0] if isinstance(row, str) else None

    def origin_of(self, name: str) -> Origin | None:
        """Where a row from outside comes from; None of ours."""
        return None if name in self._rows or name not in (found := self._outside()) else found[name].origin

    def _outside(self) -> dict[str, Outside]:
        """The rows from outside whose names are not taken."""
        if self._group is None:
            return {}
        found = outside.rows(self._group)
        for name in found.keys() & self._rows.keys():
            once(f"{found[name].origin} has a row {name!r} in {self._group}, as novags has: that one is used")
            del found[name]
        return found


class _Usable(ItemsView[str, Row]):
    def __init__(self, rows: Registry[Row]) -> None:
        super().__init__(rows)
        self._all = rows

    def __iter__(self) -> Iterator[tuple[str, Row]]:
        for name in self._all:
            try:
                row = self._all[name]
            except BrokenRow as error:
                once(f"{error}; everything else works")
            else:
                yield name, row


class _UsableRows(ValuesView[Row]):
    def __init__(self, rows: Registry[Row]) -> None:
        super().__init__(rows)
        self._all = rows

    def __iter__(self) -> Iterator[Row]:
        return (row for _, row in self._all.items())
