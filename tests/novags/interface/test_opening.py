"""Claims about opened folders: every finished run of a study is given, with its row, and a folder says what it is."""

from pathlib import Path
from typing import Any, get_args

import pytest

from novags.interface import opening
from novags.interface.frames import TABLES
from novags.interface.opening import StudyResults, results_of
from novags.testbed.ledger.contents import write_json

AXES = {"method": ["naive", "nova"], "seed": [0, 1]}
ROWS = [
    {"run": 0, "method": "naive", "seed": 0, "state": "done", "folder": "a"},
    {"run": 1, "method": "naive", "seed": 1, "state": "failed", "folder": "b"},
    {"run": 2, "method": "nova", "seed": 0, "state": "done", "folder": "c"},
    {"run": 3, "method": "nova", "seed": 1, "state": "done", "folder": "d"},
]


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> StudyResults:
    """A study of four runs, one of which failed; a run is told by the name of its folder."""
    monkeypatch.setattr(opening, "_run", lambda path: str(path.relative_to(tmp_path)))
    write_json(tmp_path / "results.json", {"axes": AXES, "columns": [], "rows": ROWS})
    return results_of(tmp_path)


@pytest.mark.parametrize(
    ("values", "folders"),
    [({}, "acd"), ({"method": "nova"}, "cd"), ({"seed": 0}, "ac"), ({"method": "naive", "seed": 0}, "a"),
     ({"method": "naive", "seed": 1}, "")],
)  # fmt: skip
def test_all_finished_runs_that_have_the_values_are_given_in_the_order_of_the_table(
    study: StudyResults, values: dict[str, Any], folders: str
) -> None:
    found = list(study.runs(**values))
    assert [run for _, run in found] == [row["folder"] for row, _ in found] == list(folders)


def test_an_axis_that_a_study_does_not_have_is_refused_with_the_axes_that_it_has(study: StudyResults) -> None:
    with pytest.raises(ValueError, match="has no axis light; its axes: method, seed"):
        next(study.runs(light=3))


def test_a_folder_of_results_is_a_study_and_a_file_or_an_empty_folder_is_nothing(
    study: StudyResults, tmp_path: Path
) -> None:
    assert opening.open(tmp_path, StudyResults) == study
    assert "rows" not in repr(study)  # a notebook shows no thousand numbers
    with pytest.raises(ValueError, match="no such folder"):
        opening.open(tmp_path / "results.json")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="is neither a run, a capture nor a study, and no set either"):
        opening.open(tmp_path / "empty")


def test_every_kind_of_folder_that_can_be_opened_has_tables() -> None:
    assert set(get_args(opening.Opened)) == set(TABLES)


@pytest.mark.parametrize(("record", "given"), [("run.json", "run"), ("capture.json", "capture"), ("results.json", "")])
def test_a_folder_is_opened_by_its_record_and_its_links_stay_inside(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, record: str, given: str
) -> None:
    """A table without axes is another program's, and its folder is looked at as a set."""
    entered, compared = list[Path](), list[Path]()
    monkeypatch.setattr(opening, "enter", entered.append)
    monkeypatch.setattr(opening, "refuse_exchanged", compared.append)
    monkeypatch.setattr(opening, "open_run", lambda _: "run")
    monkeypatch.setattr(opening, "open_capture", lambda _: "capture")
    (tmp_path / record).write_text("{}")
    if given:
        assert opening.open(tmp_path) == given
    else:
        with pytest.raises(ValueError, match="and no set either"):
            opening.open(tmp_path)
    assert entered == [tmp_path]
    assert compared == ([tmp_path] if given == "run" else [])
