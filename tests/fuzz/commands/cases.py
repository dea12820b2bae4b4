"""The cases of commands: number k of a seed is always the same project and the same command line."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path
from random import Random

from tests.fuzz.case import DAMAGE, Case
from tests.fuzz.commands.lines import Line
from tests.fuzz.damage import places, texts
from tests.fuzz.damage.mutate import damaged
from tests.fuzz.damage.structure import arguments
from tests.fuzz.damage.tree import Tree, remove

# Written under these names by most commands, or for a while.
OWN = (".novags.lock", "unfinished.json", ".sealed.json", "events.jsonl", "report.html", "metrics.json")
AT_OUTPUTS = ("link to a file", "link to a folder", "link to nothing outside", "FIFO", "device null", "folder",
              "hard link", "link to itself", "read-only")  # fmt: skip
MODULES = ("drjit", "torch", "mitsuba", "numba", "signal", "numpy", "sitecustomize", "usercustomize", "pickle", "json")
MARK = "executed"


@dataclass(frozen=True)
class Deed:
    """What is changed, and the words of the command."""

    words: tuple[str, ...]
    changes: tuple[Case, ...] = ()  # of files that are there
    outputs: tuple[tuple[str, str], ...] = ()  # (name, what is put where the command writes)
    modules: bool = False

    @property
    def same(self) -> bool:
        """Whether the command must end as it does on the valid project."""
        return bool(self.changes) and not self.outputs and all(case.rule == "same" for case in self.changes)

    def without(self) -> Deed | None:
        """The same without the one file or folder that is a link outside; None where that is not all."""
        if len(self.changes) != 1 or self.changes[0].rule != "refused" or self.changes[0].name in self.words:
            return None
        kind = "file for folder" if self.changes[0].kind in places.OF_FOLDERS else "missing"
        return Deed(self.words, (Case(self.changes[0].name, b"", kind),))

    def __str__(self) -> str:
        said = [*map(str, self.changes), *(f"{name} ({kind} at an output)" for name, kind in self.outputs)]
        return "; ".join(said) or json.dumps(self.words)[:300]


@dataclass(frozen=True)
class Deeds:
    """All cases of a command line for one seed.

    Attributes:
        line: The command line.
        tree: The valid project.
        seed: Of the cases.
        written: Files and folders that the valid command makes or changes.
    """

    line: Line
    tree: Tree
    seed: int
    written: Sequence[str] = field(default_factory=list)

    def deed(self, k: int) -> Deed:
        """Case `k`."""
        rng = Random(f"{self.seed} command {self.line.name} {k}")
        modules, share = rng.random() < 0.15, rng.random()
        files = sorted(n for n in self.tree.files if any(fnmatch(n, p) for p in self.line.reads))
        if share < 0.15 or not files:
            return Deed(self._words(rng), modules=modules)
        if share < 0.35 and (names := self._output_names()):
            return Deed(self.line.words, outputs=((rng.choice(names), rng.choice(AT_OUTPUTS)),), modules=modules)
        chosen = rng.sample(files, min(len(files), rng.choice((1, 1, 2))))
        return Deed(self.line.words, tuple(self._changed(name, rng) for name in chosen), modules=modules)

    def _changed(self, name: str, rng: Random) -> Case:
        share, content = rng.random(), self.tree.files[name]
        kinds = [kind for kind in (*texts.SAME, *texts.OTHER) if texts.suits(kind, name)]
        if share < 0.45:
            kind = places.fitting(rng.choice(sorted(places.RULE)), name, _level(name, self.line.words))
            foreign = "/" in name and not _given(name, self.line.words)  # a folder that another one's record names
            return Case(name, b"", "missing" if foreign and places.RULE[kind] == "refused" else kind)
        if share < 0.75 and kinds:
            kind = rng.choice(kinds)
            return Case(name, texts.changed(kind, name, content, rng), kind)
        return Case(name, damaged(name, content, rng), DAMAGE)

    def _words(self, rng: Random) -> tuple[str, ...]:
        """Hostile words; none that names a place outside the project, since commands write where they are told."""
        for _ in range(20):
            if rng.random() < 0.5:
                words = json.loads(arguments(json.dumps(self.line.words).encode(), rng))
            else:
                words = list(self.line.words)
                words[rng.randrange(len(words))] = rng.choice((*texts.NAMES, *texts.NUMBERS, "", "\x1b[2J", "-1"))
            words = [str(word).encode("utf-8", "replace").decode() for word in words]
            harmless = not any(word.startswith("/") or ".." in word or "\0" in word for word in words)
            if words != list(self.line.words) and harmless:
                return tuple(words)
        return self.line.words

    def _output_names(self) -> list[str]:
        folders = {str(Path(name).parent) for name in self.written} | {"."}
        return sorted({*self.written, *(f"{folder}/{name}" for folder in folders for name in OWN)})


def _given(name: str, words: Sequence[str]) -> list[str]:
    """The words that name a folder in which a file lies; the first names the command."""
    return [word for word in words[1:] if word and name.startswith(f"{word}/")]


def _level(name: str, words: Sequence[str]) -> int:
    """The outermost folder of a file that the command line does not name: what that names may be a link."""
    return 1 + max((word.count("/") + 1 for word in _given(name, words)), default=0)


def apply(deed: Deed, tree: Tree, world: Path, beside: Path) -> None:
    """Make the project of a case; canaries lie beside it."""
    tree.restore(world)
    remove(beside)
    (beside / "folder").mkdir(parents=True)
    for name in ("victim", "folder/victim"):
        (beside / name).write_text("untouched")
    for case in deed.changes:
        if not (world / case.name).is_file():
            continue  # an earlier change has taken its folder away
        if case.kind in places.RULE:
            places.replace(case.kind, world, case.name, beside, _level(case.name, deed.words))
        else:
            (world / case.name).write_bytes(case.content)
    for name, kind in deed.outputs:
        _obstruct(world / name, kind, beside)
    for module in MODULES if deed.modules else ():
        (world / f"{module}.py").write_text(f"open({str(beside.parent / MARK)!r}, 'a').write(__name__ + '\\n')\n")


def _obstruct(path: Path, kind: str, beside: Path) -> None:
    """Put something where the command will write."""
    for part in [*path.parents][::-1]:
        if part.is_file() or part.is_symlink():
            return
    path.parent.mkdir(parents=True, exist_ok=True)
    remove(path)
    if kind == "link to a file":
        path.symlink_to(beside / "victim")
    elif kind == "link to a folder":
        path.symlink_to(beside / "folder")
    elif kind == "link to nothing outside":
        path.symlink_to(beside / "folder" / "new")
    elif kind == "hard link":
        path.hardlink_to(beside / "victim")
    elif kind == "folder":
        (path / "a").mkdir(parents=True)
    elif kind == "read-only":
        path.write_text("{}")
        path.chmod(0o400)
    else:
        places.put(kind, path, beside / "victim", path.parent, beside)
