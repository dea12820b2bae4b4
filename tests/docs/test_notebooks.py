"""The notebooks of the pages run as they stand, and what they show is what the pages hold."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

nbformat = pytest.importorskip("nbformat")
pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
LARGEST = 250_000  # bytes


@pytest.fixture(scope="module")
def notebooks(script: Callable[[str], ModuleType]) -> ModuleType:
    return script("files/notebooks.py")


def kinds(notebook: Any) -> list[list[str]]:
    """What each cell of code shows: kinds of outputs, and of data."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return [[f"{output.output_type} {' '.join(sorted(output.get('data', {})))}" for output in cell.outputs
             if output.output_type != "stream" or output.name == "stdout"] for cell in cells]  # fmt: skip


def test_there_are_two() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["light-levels", "own-camera"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_whole_small_and_of_no_machine(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    text = path.read_text(encoding="utf-8")
    assert len(text) < LARGEST
    assert not any(place in text for place in (str(ROOT), str(Path.home()), "/tmp/", "Traceback"))
    counts = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1))
    assert sum("image/png" in output.get("data", {}) for cell in notebook.cells if cell.cell_type == "code"
               for output in cell.outputs) == 2  # fmt: skip
    assert set(notebook.metadata) == {"kernelspec"}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning", "ignore::RuntimeWarning")
def test_a_notebook_runs_and_shows_the_same_kinds_of_things(
    path: Path, notebooks: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """Its own assertions hold, too."""
    if path.stem == "light-levels":  # it is a study
        request.getfixturevalue("one_core")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    found = notebooks.executed(path, tmp_path)
    assert kinds(found) == kinds(nbformat.read(path, as_version=4))


def test_a_cell_that_fails_is_named(notebooks: ModuleType, tmp_path: Path) -> None:
    from nbclient.exceptions import CellExecutionError

    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("assert 1 == 2, 'no'")])
    nbformat.write(notebook, tmp_path / "wrong.ipynb")
    with pytest.raises(CellExecutionError, match=r"AssertionError.*: no"):
        notebooks.executed(tmp_path / "wrong.ipynb", tmp_path)
