"""Claims about where runs lie: alone, in tables of studies, or anywhere below a folder; none is lost or doubled."""

import json
from pathlib import Path

import pytest

from novags.testbed.folders import runs as module
from novags.testbed.folders.run import Run
from novags.testbed.folders.runs import runs_in


@pytest.fixture(autouse=True)
def opened(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run is a folder with a record, whatever is in it."""
    monkeypatch.setattr(module, "open_run", lambda path: Run(path, {"name": path.name}))


def run(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "run.json").write_text("{}")
    return folder


def study(folder: Path, **states: str) -> Path:
    for name in states:
        run(folder / name)
    rows = [{"state": state, "folder": name} for name, state in states.items()]
    (folder / "results.json").write_text(json.dumps({"axes": {"method": list(states)}, "rows": rows}))
    return folder


def test_all_runs_of_all_folders_are_found_in_their_order(tmp_path: Path) -> None:
    folders = [run(tmp_path / "one"), study(tmp_path / "s", b="done", a="failed", c="done"),
               run(tmp_path / "x" / "two"), study(tmp_path / "y" / "deep" / "t", d="done", e="done")]  # fmt: skip
    found = runs_in([folders[0], folders[1], tmp_path / "x", tmp_path / "y"])
    assert list(found) == ["one", "b", "c", "two", "d", "e"]
    assert [one.path for one in found.values()] == [
        folders[0], folders[1] / "b", folders[1] / "c", folders[2], folders[3] / "d", folders[3] / "e"
    ]  # fmt: skip


def test_hidden_folders_at_any_depth_are_passed_over(tmp_path: Path) -> None:
    for name in ("a", "b/c", ".d/e", "f/.g/h"):
        run(tmp_path / name)
    assert list(runs_in([tmp_path])) == ["a", "c"]


def test_runs_of_one_name_are_told_apart_by_as_many_folders_as_it_takes(tmp_path: Path) -> None:
    for name in ("u/x/naive", "v/x/naive", "v/y/naive", "v/y/nova"):
        run(tmp_path / name)
    assert list(runs_in([tmp_path])) == ["u/x/naive", "v/x/naive", "y/naive", "nova"]


def test_what_holds_no_finished_run_is_refused_wherever_it_stands(tmp_path: Path) -> None:
    good = run(tmp_path / "good")
    (tmp_path / "empty").mkdir()
    study(tmp_path / "failed", a="failed")
    for bad in ("empty", "failed", "nowhere"):
        with pytest.raises(ValueError, match="holds no finished run|no such folder"):
            runs_in([good, tmp_path / bad])
    with pytest.raises(ValueError, match="name at least one"):
        runs_in([])


def test_a_study_without_its_store_says_what_has_to_come_with_it(tmp_path: Path) -> None:
    (study(tmp_path / "s", a="done", b="done", c="failed") / "b").rename(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match="^1 of the 2 runs of .*s are not here, as .*b: .* lie in its store"):
        runs_in([tmp_path])


def test_what_was_made_again_beside_results_is_none_of_them(tmp_path: Path) -> None:
    """Rationale: `novags verify . --out again` a second time drew from what the first had made."""
    run(tmp_path / "x" / "mine")
    run(tmp_path / "x" / "again" / "mine" / "run")
    study(tmp_path / "x" / "again" / "tables" / "s", a="done").joinpath("a").rename(tmp_path / ".gone")
    (tmp_path / "x" / "again" / "verify.json").write_text("{}")
    for folder in (tmp_path, tmp_path / "x"):
        assert [one.path for one in runs_in([folder]).values()] == [tmp_path / "x" / "mine"]
    assert [one.path.name for one in runs_in([tmp_path / "x" / "again" / "mine"]).values()] == ["run"]
