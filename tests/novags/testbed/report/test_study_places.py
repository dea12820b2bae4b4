"""Claims about what is read of a study: every row, every score and every held-out view."""

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.report import study as module
from novags.testbed.report.grid import Line
from novags.testbed.report.study import _place, chosen, read_made, read_rows, study_material

SCORES = ("enhanced.aligned_psnr", "lit.tone_aligned_psnr", "recovered", "cameras.registered_share", "geometry.abs_rel",
          "lit.flip")  # fmt: skip


@pytest.mark.parametrize("column", SCORES)
@pytest.mark.parametrize("k", [0, 2])
def test_a_row_without_a_number_where_a_score_belongs_is_refused(tmp_path: Path, column: str, k: int) -> None:
    rows = [{"run": i, "scene": "a", "method": "naive", "state": "done", "folder": "x", "reason": None, "stage": None,
             column: 1.0} for i in range(3)]  # fmt: skip
    path = tmp_path / "results.json"
    content = {"axes": {"scene": ["a"], "method": ["naive"]}, "columns": [], "rows": rows}
    path.write_text(json.dumps(content))
    assert read_rows(path)[0] == rows
    rows[k][column] = [1.0]
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=re.escape(column)):
        read_rows(path)


def test_every_finished_run_that_is_here_is_read_and_every_other_one_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(path: Path) -> Any:
        if "gone" in path.name:
            raise ValueError("not here")
        return SimpleNamespace(name=path.name)

    monkeypatch.setattr(module, "open_run", opened)
    monkeypatch.setattr(module, "made_of", lambda run, name, known: name)
    folders = [("failed", "a"), ("done", "gone1"), ("done", "b"), ("done", "gone2"), ("done", "c")]
    rows = [{"run": k, "state": state, "folder": folder} for k, (state, folder) in enumerate(folders)]
    assert read_made(tmp_path, rows) == ({2: "b-2", 4: "c-4"}, [1, 3])


def test_the_capture_is_the_one_that_most_methods_have_a_run_of() -> None:
    made = {"a": ["x", "x", "x", "y"], "b": ["z", "y"], "c": ["z", "y"]}
    lines = {name: Line({}, name, []) for name in made}
    of = {id(lines[name]): [SimpleNamespace(capture=Path(c), run=f"{name}{k}") for k, c in enumerate(captures)]
          for name, captures in made.items()}  # fmt: skip
    material: Any = SimpleNamespace(of=lambda line: of[id(line)])
    assert chosen(list(lines.values()), material) == (Path("y"), {"a": "a3", "b": "b1", "c": "c1"})


METHODS = ("oracle", "nova", "naive")  # best first by their scores


@pytest.mark.parametrize("away", METHODS)
def test_a_method_is_in_a_study_with_its_look_and_if_its_run_is_of_another_capture_that_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, away: str
) -> None:
    rows = [{"run": k, "scene": "a", "method": name, "state": "done", "enhanced.aligned_psnr": 30.0 - k}
            for k, name in enumerate(METHODS)]  # fmt: skip
    axes = {"scene": ["a"], "method": METHODS}
    (tmp_path / "results.json").write_text(json.dumps({"axes": axes, "columns": [], "rows": rows}))
    (tmp_path / "study.json").write_text(json.dumps({"file": "l.toml", "table": {}}))
    runs = [SimpleNamespace(name=name, record={}, scores=lambda: None) for name in METHODS]
    made = {k: SimpleNamespace(run=run, capture=Path("other" if run.name == away else "same"))
            for k, run in enumerate(runs)}  # fmt: skip
    monkeypatch.setattr(module, "read_made", lambda *_: (made, []))
    found = study_material(tmp_path, tmp_path / "report.html")
    assert {name: look.competes for name, look in found.looks.items()} == {"oracle": False, "nova": True, "naive": True}
    assert [line.method for line in found.lines] == [*METHODS]
    assert list(found.unseen) == [f"scene a, {away}"]
    assert list(found.places) == ["scene a"]


def test_the_view_is_the_first_held_out_one_that_any_run_has_rendered(tmp_path: Path) -> None:
    def run(name: str, *views: str) -> Any:
        (tmp_path / name / "renders").mkdir(parents=True)
        for view in views:
            (tmp_path / name / "renders" / f"{view}.png").touch()
        return SimpleNamespace(path=tmp_path / name, capture=lambda: None, scores=lambda: {"views": name})

    capture: Any = SimpleNamespace(names=tuple("uvw"), cameras=SimpleNamespace(test_indices=[0, 1, 2]))
    runs = {"a": run("a", "w"), "b": run("b", "v", "w"), "c": run("c", "v")}
    place = _place(lambda: (capture, None), runs)  # type: ignore[arg-type, return-value]
    assert place is not None
    assert (place.views, list(place.runs)) == ([1], ["b", "c"])
    assert list(place.metrics["methods"]) == ["b", "c"]
    assert _place(lambda: (capture, None), {"none": run("none")}) is None  # type: ignore[arg-type, return-value]
