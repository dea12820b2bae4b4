"""A reader, and the cases made for it: number k of a seed is always the same damaged file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from random import Random

from tests.fuzz.mutate import damaged


@dataclass(frozen=True)
class Reader:
    """Something that reads what people bring.

    Attributes:
        name: In the table.
        make: Writes a valid folder.
        read: (folder, the file that was damaged) -> reads it by the project's own functions.
        damage: Patterns of the files that are damaged, relative to the folder.
        cut: Patterns of those that are also cut at every offset.
        also: Whole files to try, each (name, content), before any damage: each Mitsuba plugin bare, for example.
        share: Of the cases of a run, against other readers: 1 for the slow ones.
        prepare: Imports what it needs, without starting threads; children are forked after it.
    """

    name: str
    make: Callable[[Path], None]
    read: Callable[[Path, Path], object]
    damage: tuple[str, ...]
    cut: tuple[str, ...] = ()
    also: Callable[[], list[tuple[str, bytes]]] = list
    share: float = 1.0
    prepare: Callable[[], None] = lambda: None


@dataclass(frozen=True)
class Cases:
    """All cases of a reader for one seed."""

    reader: Reader
    files: dict[str, bytes]
    seed: int
    whole: list[tuple[str, bytes]]
    cuts: list[tuple[str, int]]

    @staticmethod
    def of(reader: Reader, folder: Path, seed: int) -> Cases:
        """The cases, from the valid files in `folder`."""
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        names = [path.relative_to(folder).as_posix() for path in paths]
        files = {n: (folder / n).read_bytes() for n in names if any(fnmatch(n, p) for p in reader.damage)}
        assert files, f"{reader.name}: no file matches {reader.damage}"
        cuts = [(n, at) for n in files for at in range(len(files[n])) if any(fnmatch(n, p) for p in reader.cut)]
        return Cases(reader, files, seed, reader.also(), cuts)

    def case(self, k: int) -> tuple[str, bytes]:
        """Name and content of the damaged file of case `k`."""
        if k < len(self.whole):
            return self.whole[k]
        if (at := k - len(self.whole)) < len(self.cuts):
            name, length = self.cuts[at]
            return name, self.files[name][:length]
        rng = Random(f"{self.seed} {self.reader.name} {k}")
        name = rng.choice(sorted(self.files))
        return name, damaged(name, self.files[name], rng)

    def chosen(self, count: int, offset: int = 0) -> list[int]:
        """`count` numbers of cases: all systematic ones, if they fit into half of it, else evenly spread ones."""
        fixed = len(self.whole) + len(self.cuts)
        part = min(fixed, count // 2)
        spread = [i * fixed // part for i in range(part)] if part else []
        return [*spread, *range(fixed + offset, fixed + offset + count - part)]
