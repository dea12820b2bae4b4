"""Claims about Python processes of our own: nothing beside a stranger's files is imported."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sensor_model.files.python import import_path, python

ROOT = Path(__file__).resolve().parents[3]
HOSTILE = "json", "signal", "sitecustomize", "torch", "drjit", "multiprocessing"
# What our processes do: import what they need, and start processes of their own, which Python starts as it likes.
PROGRAM = """
import json, signal, multiprocessing
from multiprocessing import resource_tracker
if __name__ == "__main__":
    resource_tracker.ensure_running()
    child = multiprocessing.get_context("spawn").Process(target=print)
    child.start()
    child.join()
    resource_tracker._resource_tracker._stop()
    print(child.exitcode)
"""


@pytest.fixture
def strange(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory full of modules that say when they are imported, which this process would import from."""
    for name in HOSTILE:
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'a').write('{name} ')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", f"{os.pathsep}.{os.pathsep}{tmp_path}")
    monkeypatch.setattr(sys, "path", ["", ".", str(tmp_path), str(tmp_path / "sub" / ".."), *sys.path])
    return tmp_path


def test_neither_a_child_nor_its_children_import_from_the_working_directory(strange: Path) -> None:
    done = subprocess.run(python(PROGRAM), capture_output=True, text=True, check=False)
    assert (done.stdout.split(), done.stderr) == (["0"], "")
    assert not (strange / "ran").exists()


def test_a_child_can_import_what_its_parent_can_and_the_packages(
    strange: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (strange / "mine: with a colon").mkdir()
    (strange / "mine: with a colon" / "known_to_the_parent.py").write_text("")
    monkeypatch.setattr(sys, "path", [str(strange / "mine: with a colon"), *sys.path])
    program = "import sys, known_to_the_parent, novags, simscenes; print(sys.argv[1:])"
    done = subprocess.run(python(program, "a b", "c"), capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("['a b', 'c']\n", "")


def test_a_folder_that_is_gone_hides_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = import_path()
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert set(before) <= set(import_path())


def test_every_python_is_started_in_one_place() -> None:
    """Rationale: `python -c` and `python -m` put the working directory first, which is easily forgotten."""
    found = []
    for package in ("sensor_model", "simscenes", "novags"):
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                named = {alias.name for alias in node.names} if isinstance(node, ast.ImportFrom) else set()
                if (isinstance(node, ast.Attribute) and node.attr == "executable") or "executable" in named:
                    found.append(f"{path.relative_to(ROOT).as_posix()}:{node.lineno}")
    assert [place for place in found if not place.startswith("sensor_model/files/python.py")] == []
    assert found
