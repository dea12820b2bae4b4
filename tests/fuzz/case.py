"""A reader, and the cases made for it: number k of a seed is always the same damaged file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from random import Random
from typing import NamedTuple

from tests.fuzz.damage import places, texts
from tests.fuzz.damage.mutate import damaged
from tests.fuzz.damage.tree import Tree

DAMAGE = "damage"
PLACED, TEXTS = 0.15, 0.15  # of the cases that are drawn: what stands in a file's place, and odd texts


@dataclass(frozen=True)
class Reader:
    """Something that reads what people bring.

    Attributes:
        name: In the table.
        make: Writes a valid folder.
        read: (folder, the file that was damaged) -> reads it by the project's own functions, and returns what it read.
        damage: Patterns of the files that are damaged, relative to the folder.
        cut: Patterns of those that are also cut at every offset.
        also: Whole files to try, each (name, content), before any damage: each Mitsuba plugin bare, for example.
        share: Of the cases of a run, against other readers: 1 for the slow ones.
        prepare: Imports what it needs, without starting threads; children are forked after it.
        placed: Whether other things than files are put in a file's place; not where `read` opens it by itself.
        odd: Whether odd texts are tried.
    """

    name: str
    make: Callable[[Path], None]
    read: Callable[[Path, Path], object]
    damage: tuple[str, ...]
    cut: tuple[str, ...] = ()
    also: Callable[[], list[tuple[str, bytes]]] = list
    share: float = 1.0
    prepare: Callable[[], None] = lambda: None
    placed: bool = True
    odd: bool = True


class Case(NamedTuple):
    """A file that is not as it should be.

    Attributes:
        name: Of the file.
        content: What is written there, unless something else than a file is put there.
        kind: "damage", of `texts`, or of `places`.
    """

    name: str
    content: bytes
    kind: str = DAMAGE

    @property
    def rule(self) -> str:
        """What a reader may do with it: "same", "same or refused", "refused" or "any"."""
        if self.kind == "link outside, allowed" and self.name.endswith((".xml", ".gltf")):
            return "same or refused"  # a scene names files from where it lies itself, and there they do not lie
        return "same or refused" if self.kind in texts.SAME else places.RULE.get(self.kind, "any")

    def __str__(self) -> str:
        return self.name if self.kind == DAMAGE else f"{self.name} ({self.kind})"


@dataclass(frozen=True)
class Cases:
    """All cases of a reader for one seed."""

    reader: Reader
    files: dict[str, bytes]
    seed: int
    whole: list[tuple[str, bytes]]
    cuts: list[tuple[str, int]]
    tree: Tree

    @staticmethod
    def of(reader: Reader, folder: Path, seed: int) -> Cases:
        """The cases, from the valid files in `folder`."""
        tree = Tree.of(folder)
        files = {n: content for n, content in tree.files.items() if any(fnmatch(n, p) for p in reader.damage)}
        assert files, f"{reader.name}: no file matches {reader.damage}"
        cuts = [(n, at) for n in files for at in range(len(files[n])) if any(fnmatch(n, p) for p in reader.cut)]
        return Cases(reader, files, seed, reader.also(), cuts, tree)

    def case(self, k: int) -> Case:
        """The damaged file of case `k`."""
        if k < len(self.whole):
            return Case(*self.whole[k])
        if (at := k - len(self.whole)) < len(self.cuts):
            name, length = self.cuts[at]
            return Case(name, self.files[name][:length])
        if (found := self._new(k)) is not None:
            return found
        rng = Random(f"{self.seed} {self.reader.name} {k}")
        name = rng.choice(sorted(self.files))
        return Case(name, damaged(name, self.files[name], rng))

    def _new(self, k: int) -> Case | None:
        """What stands in a file's place, or an odd text; of random numbers of its own: damage stays as it was."""
        rng = Random(f"{self.seed} {self.reader.name} {k} new")
        share, name = rng.random(), rng.choice(sorted(self.files))
        if share < PLACED and self.reader.placed:
            return Case(name, b"", places.fitting(rng.choice(sorted(places.RULE)), name))
        kinds = [kind for kind in (*texts.SAME, *texts.OTHER) if texts.suits(kind, name)]
        if not PLACED <= share < PLACED + TEXTS or not self.reader.odd or not kinds:
            return None
        kind = rng.choice(kinds)
        return Case(name, texts.changed(kind, name, self.files[name], rng), kind)

    def chosen(self, count: int, offset: int = 0) -> list[int]:
        """`count` numbers of cases: all systematic ones, if they fit into half of it, else evenly spread ones."""
        fixed = len(self.whole) + len(self.cuts)
        part = min(fixed, count // 2)
        spread = [i * fixed // part for i in range(part)] if part else []
        return [*spread, *range(fixed + offset, fixed + offset + count - part)]
