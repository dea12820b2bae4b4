"""What runs while a stage is at work is what its key counts: watched, function by function, on small stages."""

import ast
import shutil
import sys
import threading
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.ledger import stage
from novags.testbed.ledger.reach import PACKAGES, is_outside, reached, source_of
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.scores import scoring
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from simscenes.sets.writers.layouts import EXPORTS

ROOT = Path(stage.__file__).resolve().parents[3]
QUIET = Console(quiet=True)
METHODS = ("naive", "nova-fast", "denoise-gs", "nerf")
SMALL = {"scene": "cornell", "n_views": 9, "width": 24, "height": 24, "spp": 4, "points": 300, "iterations": 8,
         "denoiser_steps": 2, "sensor": "a7s2-iso6400"}  # fmt: skip


def module_of(path: Path) -> str:
    """The name of a module of ours."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


@cache
def statements(path: Path) -> list[ast.stmt]:
    """The top statements of a file, read once."""
    return ast.parse(path.read_bytes()).body


def defined_in(code: CodeType) -> tuple[str, str] | None:
    """The module and the top definition of a function; None of other people's, and of modules as they are imported."""
    path = Path(code.co_filename)
    if code.co_name == "<module>" or not path.is_relative_to(ROOT) or path.relative_to(ROOT).parts[0] not in PACKAGES:
        return None
    for statement in statements(path):
        first = min(node.lineno for node in (statement, *getattr(statement, "decorator_list", ())))
        if first <= code.co_firstlineno <= (statement.end_lineno or 0):
            names = [node.id for node in ast.walk(statement) if isinstance(node, ast.Name)]  # of an assignment
            return module_of(path), getattr(statement, "name", names[0] if names else "")
    return None


def kernels() -> dict[CodeType, int]:
    """How often each function of ours was compiled or read as a kernel."""
    values = [value for name, module in list(sys.modules.items()) if name.partition(".")[0] in PACKAGES
              for value in vars(module).values()]  # fmt: skip
    return {value.py_func.__code__: len(value.overloads) for value in values if isinstance(value, Dispatcher)}


def of_the_ledger(frame: FrameType) -> bool:
    """Whether a file is read or written for the ledger itself or for a lock, which no key counts."""
    path, above = Path(frame.f_code.co_filename), frame.f_back
    while above is not None and not (ours := path.is_relative_to(ROOT) and is_outside(module_of(path))):
        if not (path.is_relative_to(ROOT / "sensor_model" / "files") or path.name == "contextlib.py"):
            return False
        path, above = Path(above.f_code.co_filename), above.f_back
    return above is not None and ours


@contextmanager
def watched() -> Iterator[set[CodeType]]:
    """Every function that is called, in all threads that start meanwhile too; kernels where they are first used."""
    found, before = set[CodeType](), kernels()

    def seen(frame: FrameType, event: str, argument: Any) -> None:
        if event == "call" and frame.f_code not in found and not of_the_ledger(frame):
            found.add(frame.f_code)

    threading.setprofile(seen)
    sys.setprofile(seen)
    try:
        yield found
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
        found |= {code for code, count in kernels().items() if count > before.get(code, 0)}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, ...], set[CodeType]]:
    """What ran, by what the key of the stage counts from."""
    folder, found = tmp_path_factory.mktemp("watched"), defaultdict[tuple[str, ...], set[CodeType]](set)
    original = stage._Stage.make

    def make_watched(self: Any, *how: Any) -> Any:
        with watched() as called:
            record = original(self, *how)
        found[self.code.roots] |= called
        return record

    preset = adapted(EXPERIMENTS["demo"], **SMALL, methods=METHODS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stage._Stage, "make", make_watched)
        patch.setattr(scoring, "frames_per_second", lambda *_: None)  # drawn to be timed: no result depends on it
        stages.render(folder / "set", replace(preset.render, export=("llff",)), QUIET)
        stages.capture(folder / "set", folder / "capture", preset.capture, QUIET)
        for name in METHODS:
            stages.reconstruct(folder / "capture", folder / name, preset.reconstruct(name), QUIET)
            stages.score(folder / name, QUIET)
        # The same pictures as photographs: of a foreign layout, and dark ones of an unknown camera.
        stages.capture(folder / "set" / "llff", folder / "foreign", CaptureConfig(), QUIET)
        shutil.copytree(folder / "foreign" / "images", folder / "dark" / "images")
        shutil.copy(folder / "foreign" / "transforms.json", folder / "dark")
        stages.import_photographs(folder / "dark", folder / "imported", ImportConfig(), QUIET)
        for capture in ("foreign", "imported"):
            stages.reconstruct(folder / capture, folder / f"of {capture}", preset.reconstruct("naive"), QUIET)
            stages.score(folder / f"of {capture}", QUIET)
    return dict(found)


def test_everything_that_runs_counts(runs: dict[tuple[str, ...], set[CodeType]]) -> None:
    assert len(runs) == 2 + len(METHODS) + 1 + 4  # the set, the capture, each method, the scores; of photographs 4 more
    missed = set[str]()
    layouts = set(map(EXPORTS.module_of, EXPORTS))  # a stage asks them only to refuse; each command writes them anew
    for roots, called in runs.items():
        counted = reached(roots)
        ours = {found for code in called if (found := defined_in(code))
                and found[0] not in layouts and not is_outside(found[0])}  # fmt: skip
        missed |= {f"{roots[-1]} runs {module}:{name}" for module, name in ours
                   if module not in counted or not any(name in source_of(module).definitions[number].names
                                                       for number in counted[module].definitions)}  # fmt: skip
        assert len(ours) > 50, roots
    assert sorted(missed) == []
