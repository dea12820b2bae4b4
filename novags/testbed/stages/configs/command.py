"""A method that is a program: which one, and the changes that make it another one."""

import os
import re
import shlex
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from novags.methods import METHODS, VARIANTS
from novags.methods.variant import Variant
from novags.settings import converted
from novags.testbed.folders.set import for_photographs
from novags.testbed.importing.programs import output_of
from novags.testbed.ledger.code import Code, code_of
from novags.testbed.ledger.contents import folder_digest
from sensor_model.files.door import opened, resolved
from sensor_model.files.reading import brief

PLACE = re.compile(r"\{([A-Za-z_]+)\}")


PLACES = ("capture", "out", "seed")


Space = Literal["lit", "linear"]


@dataclass(frozen=True, kw_only=True)
class CommandConfig:
    """A method that is a program.

    Attributes:
        name: Of the method.
        command: The program and its arguments, split into words as a POSIX shell does; no shell runs. {capture} stands
            for the folder of the capture, {out} for an empty folder for pictures NAME.png or NAME.exr of the test
            views, {seed} for the seed of the run.
        folder: Where it runs; relative paths in it start here.
        timeout: Seconds after which it is ended and has failed; None: never.
        space: The kind of its pictures: "lit" (as in good light, sRGB-encoded) or "linear" (the light of the scene).
        files: Files and folders that the command does not name, relative to `folder`, that make it another program when
            they change.
        version: A command whose output tells one version of the program from another ("theirs --version"); "" for none.
        title: Its work, in a sentence.
        seed: Of the run.
        given: "noise": it is shown the exposures without noise, as `novags explain` asks; "": the capture.
    """

    name: str
    command: str
    folder: Path
    timeout: float | None = None
    space: Space = "lit"
    files: tuple[str, ...] = ()
    version: str = ""
    title: str = ""
    seed: int = 0
    given: Literal["", "noise"] = ""

    def __post_init__(self) -> None:
        _ = self.variant  # checks the name
        if self.name in (*METHODS, *VARIANTS):
            raise ValueError(f"the name {self.name} is taken by a method of the test bed: choose another one")
        if self.space not in get_args(Space):
            raise ValueError(f"space must be one of {', '.join(get_args(Space))}, got {self.space!r}")
        if self.timeout is not None and not (np.isfinite(self.timeout) and self.timeout > 0):
            raise ValueError(f"timeout must be > 0 s, got {self.timeout:g}")
        words = self._split()
        if self.version and self._program(self._split("version")[0]) is None:
            raise ValueError(f"version: the program {brief(self._split('version')[0], 100)} was not found")
        used = {name for word in words for name in PLACE.findall(word)}
        if unknown := sorted(used - set(PLACES)):
            raise ValueError(f"command: {{{unknown[0]}}} stands for nothing; there are {', '.join(PLACES)}")
        if missing := [name for name in ("capture", "out") if name not in used]:
            raise ValueError(f"command must say where {{{missing[0]}}} goes, got {brief(repr(self.command), 100)}")
        if self._program(words[0]) is None:
            raise ValueError(f"command: the program {brief(words[0], 100)} was not found")
        if lost := [name for name in self.files if not (self.folder / name).exists()]:
            raise ValueError(f"files: {self.folder / lost[0]} does not exist")

    def _split(self, setting: str = "command") -> list[str]:
        text = getattr(self, setting)
        try:
            words = shlex.split(text)
        except ValueError as error:
            raise ValueError(f"{setting}: {error}, in {brief(repr(text), 100)}") from error
        if not words:
            raise ValueError(f"{setting} must name a program, got nothing")
        return words

    def _program(self, word: str) -> str | None:
        return shutil.which(str(self.folder / word)) if "/" in word else shutil.which(word)

    @property
    def variant(self) -> Variant:
        """Its name, as a method of the test bed has one."""
        return Variant(name=self.name, method=self.name, title=self.title)

    def words(self, **places: str) -> list[str]:
        """The program and its arguments, with the values of `places`; each stays one word, with any content."""
        filled = [PLACE.sub(lambda found: places[found.group(1)], word) for word in self._split()]
        return [str(self._program(filled[0])), *filled[1:]]

    @property
    def code(self) -> Code:
        """The code that runs the program and keeps its pictures."""
        return code_of("novags.testbed.stages.command", *for_photographs())

    def resolved(self) -> dict[str, Any]:
        """The facts that determine the pictures: the command and the content of the files that it names, not where they
        lie.
        """
        told = {"version": self._told()} if self.version else {}
        truth = {"given": self.given} if self.given else {}
        return {"method": self.name, "command": self.command, "space": self.space, "seed": self.seed,
                "program": self._digest(), **told, **truth}  # fmt: skip

    def _told(self) -> str:
        """The version that the program states.

        Raises:
            ValueError: If it says nothing, or fails.
        """
        program, *rest = self._split("version")
        return output_of((str(self._program(program)), *rest), self.folder)

    def _digest(self) -> str:
        found: dict[str, Path] = {}
        for place, name in enumerate([*self.files, *self._named()]):
            path = self.folder / name
            parts = sorted(part for part in path.rglob("*") if part.is_file()) if path.is_dir() else [path]
            found |= {f"{place}/{part.relative_to(path.parent).as_posix()}": part for part in parts
                      if "__pycache__" not in part.parts}  # fmt: skip
        return folder_digest(self.folder, (), beside=found)

    def _named(self) -> list[str]:
        """The files that the command names."""
        return [part for part in self._parts() if (self.folder / part).is_file()]

    @property
    def uncounted(self) -> list[str]:
        """The folders that the command names and `files` does not: whether one is read or written, only its user knows.

        A change in one makes no other program. The folder where it runs is not among them, nor are folders above.
        """
        here, *counted = (Path(os.path.abspath(self.folder / name)) for name in (".", *self.files))
        named = {part: Path(os.path.abspath(self.folder / part)) for part in self._parts()
                 if part and (self.folder / part).is_dir()}  # fmt: skip
        return [part for part, place in named.items() if not here.is_relative_to(place)
                and not any(place.is_relative_to(other) for other in counted)]  # fmt: skip

    def _parts(self) -> list[str]:
        """The words of the command, and what stands behind their "=" (--config=a.yaml)."""
        program, *rest = self._split()
        words = rest if self._of_machine(program) else [program, *rest]
        return [part for word in words for part in (word, word.partition("=")[2])]

    def _of_machine(self, program: str) -> bool:
        """Whether it is an interpreter by its whole path: part of the machine, as one that is found by its name."""
        path = Path(program)
        if not path.is_absolute() or resolved(path).is_relative_to(resolved(self.folder)):
            return False
        with opened(path) as file:
            return file.read(2) != b"#!"


def read_commands(tables: Any, folder: Path) -> tuple[CommandConfig, ...]:
    """The tables [method.NAME] of a study file.

    Args:
        tables: The tables under `method`.
        folder: The file's folder, where commands run.

    Raises:
        ValueError: If a table is not a method; names it.
    """
    found = []
    for name, table in tables.items():
        try:
            found.append(_command(name, table, folder))
        except ValueError as error:
            raise ValueError(f"[method.{brief(name, 60)}]: {error}") from error
    return tuple(found)


def _command(name: str, table: Any, folder: Path) -> CommandConfig:
    hints = {"command": str, "timeout": float | None, "space": str, "files": tuple[str, ...], "version": str,
             "title": str}  # fmt: skip
    assert hints.keys() <= {field.name for field in fields(CommandConfig)}
    if not isinstance(table, Mapping) or "command" not in table:
        raise ValueError('it needs command = "PROGRAM {capture} {out}"')
    if unknown := [key for key in table if key not in hints]:
        raise ValueError(f"it has no setting {brief(repr(unknown[0]), 60)}; there are {', '.join(hints)}")
    values = {key: converted(value, hints[key], key) for key, value in table.items()}
    return CommandConfig(name=name, folder=resolved(folder), **values)
