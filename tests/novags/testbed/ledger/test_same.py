"""Claims about equal results of a store under different entries."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.ledger.code import Code
from novags.testbed.ledger.made import MadeWith, made_with
from novags.testbed.ledger.same import SAME, remember, sharing
from novags.testbed.ledger.stage import run_stage

Make = Callable[..., list[str]]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Make an entry of a store, or take it over; returns the names of the entries that it was taken from."""

    def of(name: str, *, kind: str = "run", source: str = "1", shares: bool = True) -> list[str]:
        entry = tmp_path / kind / name

        def work(_: None) -> dict[str, str]:
            (entry / "parts").mkdir(parents=True, exist_ok=True)
            (entry / "parts" / "a.txt").write_text(f"made of {source}")
            with (tmp_path / "made").open("a") as file:
                file.write(name)
            return {"by": "toy"}

        def stage() -> None:
            run_stage(
                "toy", entry, "run.json", code=Code({"a.py": "1"}, {"a.py": "whole"}), inputs=lambda: {"in": source},
                config={}, owns=("run.json", "parts"), prepare=lambda: None, work=work, console=Console(quiet=True),
            )  # fmt: skip

        if not shares:
            stage()
            return []
        with sharing(tmp_path) as taken:
            stage()
        remember(entry, ["run.json"])
        return taken

    return of


def test_an_equal_result_is_taken_with_all_its_files_and_says_with_which_code_it_was_made(
    make: Make, tmp_path: Path
) -> None:
    assert [make("a"), make("b"), make("c")] == [[], ["a"], ["b"]]
    assert (tmp_path / "made").read_text() == "a"
    for name in ("parts/a.txt", "run.json"):
        assert (tmp_path / "run" / "c" / name).read_bytes() == (tmp_path / "run" / "a" / name).read_bytes()
    assert made_with(tmp_path / "run" / "c", "run.json").files == {"a.py": "1"}


@pytest.mark.parametrize("why", ["other inputs", "another kind", "no store", "damaged", "gone", "a strange note"])
def test_what_is_not_equal_or_not_as_it_was_written_is_made(make: Make, tmp_path: Path, why: str) -> None:
    make("a")
    first = tmp_path / "run" / "a"
    if why == "damaged":
        (first / "parts" / "a.txt").write_text("edited")
    elif why == "gone":
        shutil.rmtree(first)
    elif why == "a strange note":
        (note,) = (tmp_path / SAME).iterdir()
        (tmp_path / "outside").mkdir()
        shutil.copytree(first, tmp_path / "outside" / "a")
        note.write_text("run/../outside/a")
        shutil.rmtree(first)
    how = {"other inputs": {"source": "2"}, "another kind": {"kind": "other"}, "no store": {"shares": False}}.get(
        why, {}
    )
    assert make("b", **how) == []
    assert (tmp_path / "made").read_text() == "ab"


def test_a_folder_that_holds_something_is_not_filled(make: Make, tmp_path: Path) -> None:
    make("a")
    (tmp_path / "run" / "b" / "parts").mkdir(parents=True)
    with pytest.raises(ValueError, match="already holds parts"):
        make("b")
    assert (tmp_path / "made").read_text() == "a"


def test_the_result_of_every_stage_of_an_entry_is_remembered(tmp_path: Path) -> None:
    entry = tmp_path / "run" / "a"
    entry.mkdir(parents=True)
    for record in ("run.json", "metrics.json"):
        (entry / record).write_text(json.dumps({"stage": {"key": f"key of {record}", "files": {}}}))
    remember(entry, ("run.json", "metrics.json"))
    notes = {path.name: path.read_text() for path in (tmp_path / SAME).iterdir()}
    assert notes == {"key of run.json": "run/a", "key of metrics.json": "run/a"}


@pytest.mark.parametrize("changed", ["a.py", "b.py", "c.py"])
def test_every_file_whose_code_or_text_changed_is_named(changed: str) -> None:
    files = {"a.py": "1", "b.py": "2", "c.py": "3"}
    made = MadeWith("2020-05-04T03:02:01", files, files)
    other = Code(files | {changed: "9"}, files | {changed: "9"})
    assert made.changed_in(Code(files, files)) == made.kept_though(Code(files, files)) == ""
    assert made.changed_in(other).startswith(f"{changed} has changed since")
    assert made.kept_though(other).endswith(f"changed in {changed}")
    assert made.changed_in(Code({name: "1" for name in files if name != changed}, {})) != ""
    assert "d.py" in made.changed_in(Code(files | {"d.py": "4"}, {}))
