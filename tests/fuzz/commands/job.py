"""The work on commands, for the engine: the project made once, and a case done."""

from __future__ import annotations

import argparse
import os
import shutil
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sensor_model.files.door import VARIABLE
from tests.fuzz.commands import doing, world
from tests.fuzz.commands.cases import MARK, Deed, Deeds, apply
from tests.fuzz.commands.lines import LINES, Line
from tests.fuzz.commands.verdict import seen, verdict
from tests.fuzz.damage.tree import Tree, remove
from tests.fuzz.judge import Finding, Limits, jsonable
from tests.fuzz.prepared import in_child, memory_folder
from tests.fuzz.records import opened, shares

VALID = Limits(seconds=100)
PATIENCE = 10.0  # times what a command may take: the engine's own limit, which its child keeps by itself


@dataclass
class Commands:
    """The cases of a command line."""

    deeds: Deeds
    within: Limits
    many = True

    @property
    def limits(self) -> Limits:
        """Of the child that runs the commands in children of its own."""
        return Limits(seconds=PATIENCE * self.within.seconds, bytes=self.within.bytes)

    def label(self, number: int) -> tuple[str, str]:
        """Command and change of a case."""
        return self.deeds.line.name, str(self.deeds.deed(number))

    def start(self, folder: Path) -> None:
        """Before the first case."""
        doing.adopt()

    def one(self, number: int, folder: Path) -> Finding | None:
        """Do a case."""
        deed = self.deeds.deed(number)
        fault, ended = tried(deed, self.deeds.tree, folder, self.within, self.deeds.line.code)
        if fault is None and ended.code == self.deeds.line.code and (without := deed.without()) is not None:
            other = tried(without, self.deeds.tree, folder, self.within)[1]
            if other.code != ended.code:
                fault = "wrong", f"read through a link that leads outside; without it: {other.err[-200:].strip()}", ""
        return None if fault is None else Finding(self.deeds.line.name, number, str(deed), *fault)


def tried(
    deed: Deed, tree: Tree, folder: Path, limits: Limits, code: int = 0
) -> tuple[tuple[str, str, str] | None, doing.Ended]:
    """What is wrong with a case, and how its command ended.

    Args:
        deed: The case.
        tree: The valid project.
        folder: Of the project; `beside` lies beside it.
        limits: Of the command.
        code: How the valid command ends.
    """
    beside, mark = folder.with_name("beside"), folder.with_name(MARK)
    os.environ.pop(VARIABLE, None)
    remove(mark)
    apply(deed, tree, folder, beside)
    before, around = seen(beside), set(os.listdir(folder.parent))
    ended = doing.do(deed.words, folder, limits)
    after, new = seen(beside), set(os.listdir(folder.parent)) - around - {MARK, "stdout", "stderr", "stack"}
    if mark.exists():
        return ("executed", f"in the working directory: {' '.join(mark.read_text().split())[:200]}", ""), ended
    changed = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
    if changed or new:
        return ("overwritten", f"outside the project: {', '.join([*changed, *new])[:200]}", ""), ended
    fault = verdict(ended, limits)
    if fault is None and deed.same and ended.code != code:
        fault = "wrong", f"must work as before, exit code {ended.code}: {ended.err.strip()[-200:]}", ""
    return fault, ended


def jobs(given: argparse.Namespace, stack: ExitStack) -> list[Any]:
    """The work on all command lines, the project being there as long as the stack is open."""
    if wrong := set(given.reader or ()) - set(LINES):
        raise SystemExit(f"no command {', '.join(wrong)}; there are {', '.join(LINES)}")
    lines = [LINES[name] for name in given.reader or LINES]
    folder, tree = _project(stack, any("study" in pattern for line in lines for pattern in line.reads))
    counts, limits = shares(given.cases, {line.name: line.weight for line in lines}), Limits(seconds=given.seconds)
    found = []
    for line in lines:
        note = given.out / f"command {line.name}.{given.seed}.json"
        record = opened(note, line.name, given.seed, counts[line.name])
        deeds = Deeds(line, tree, given.seed, _written(line, tree, folder, record))
        found.append((record, Commands(deeds, limits), list(range(record["of"])), folder, note))
    return found


def _project(stack: ExitStack, studied: bool = True) -> tuple[Path, Tree]:
    """Make it, in a place of its own where users' folders are as well."""
    place = stack.enter_context(memory_folder())
    folder = place / "world"
    for name in ("home", "tmp", "cache", "world"):
        (place / name).mkdir()
    os.environ |= {"HOME": str(place / "home"), "XDG_CACHE_HOME": str(place / "cache"), "TMPDIR": str(place / "tmp")}
    import tempfile

    tempfile.tempdir = None
    made = place / "made"  # not where cases run: what commands know of folders must not be known before
    made.mkdir()
    in_child(lambda: world.write_inputs(made))
    doing.load()
    first, *then = world.MADE
    for words in (first, *([world.MAKE_STUDY] if studied else [])):
        ended = doing.do(words, made, VALID)
        if ended.code:
            raise SystemExit(f"novags {' '.join(words)}: {ended.code} {ended.err}{ended.trace}")
    doing.warm(made, then)
    folder.rmdir()
    made.rename(folder)
    world.without_costly(folder)
    return folder, Tree.of(folder)


def _written(line: Line, tree: Tree, folder: Path, record: dict[str, Any]) -> list[str]:
    """What the valid command writes. If it does not end well, that is a finding, and there are no cases."""
    fault, ended = tried(Deed(line.words), tree, folder, VALID, line.code)
    if fault is not None or ended.code != line.code:
        kind, detail, at = fault or ("wrong", f"exit code {ended.code}: {ended.err.strip()[-300:]}", "")
        found = Finding(line.name, -1, "the valid project", kind, detail, at)
        print(f"{line.name}: {found}", flush=True)
        record |= {"findings": [jsonable(found)], "of": 0}
    after = Tree.of(folder)
    return [*(n for n, c in after.files.items() if tree.files.get(n) != c), *(set(after.folders) - set(tree.folders))]


def show(given: argparse.Namespace) -> None:
    """Run one case, say what it said, and keep its project."""
    given.cases = 1
    with ExitStack() as stack:
        ((_, work, _, folder, _),) = jobs(argparse.Namespace(**{**vars(given), "reader": given.reader[:1]}), stack)
        doing.adopt()
        deed = work.deeds.deed(given.case)
        fault, ended = tried(deed, work.deeds.tree, folder, work.within, work.deeds.line.code)
        kept = given.out / f"{work.deeds.line.name}.{given.case}"
        remove(kept)
        apply(deed, work.deeds.tree, folder, folder.with_name("beside"))
        kept.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(folder.rename(folder.with_name(kept.name)), kept)
        print(f"{kept}: novags {' '.join(map(repr, deed.words))}\n{deed}\n{fault or 'as documented'}; {ended.code}")
        print(ended.out[-2000:], ended.err[-3000:], ended.trace[-3000:], ended.stack[:2000], sep="\n")
