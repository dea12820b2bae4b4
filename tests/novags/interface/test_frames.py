"""Claims about tables of opened folders: the rows of views and scores, and the data frames of them."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.interface.frames import TABLES, frame
from novags.interface.opening import StudyResults
from novags.testbed.folders.run import Run
from novags.testbed.study.differences import DIFFERENCES
from simscenes import MultiviewSet


def scored(name: str, psnr: float) -> Any:
    """A run with one score of each of two views, and one of its geometry."""
    views: Any = {view: {"lit": {"psnr": psnr + k, "psnr_error": 0.5, "psnr_bias": 0.1, "gone": None, "of": {}}}
                  for k, view in enumerate(("0000", "0008"))}  # fmt: skip
    found = {"views": views, "geometry": {"views": {"0000": {"abs_rel": psnr / 100}}}}
    return SimpleNamespace(path=Path(name), scores=lambda: found)


def test_scores_of_a_study_are_of_all_its_runs_with_the_values_of_all_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    places = [{"scene": scene, "method": "naive", "seed": seed} for scene in ("busts", "hall") for seed in (3, 4)]
    runs = [({"run": k, "state": "done", **place}, scored(str(k), 20.0 + 10 * k)) for k, place in enumerate(places)]
    monkeypatch.setattr(StudyResults, "runs", lambda _: iter(runs))
    axes: dict[str, list[Any]] = {"scene": ["busts", "hall"], "method": ["naive"], "seed": [3, 4]}
    found = list(TABLES[StudyResults]["scores"](StudyResults(Path(), axes, ())))
    for k, place in enumerate(places):
        own = {"run": k, **place}
        light = {"reference": "lit", "score": "psnr", "error": 0.5, "bias": 0.1}
        depth = {"reference": "geometry", "score": "abs_rel", "error": None, "bias": None}
        assert found[3 * k : 3 * k + 3] == [
            {**own, "view": "0000", **light, "value": 20.0 + 10 * k},
            {**own, "view": "0008", **light, "value": 21.0 + 10 * k},
            {**own, "view": "0000", **depth, "value": pytest.approx(0.2 + 0.1 * k)},
        ]
    assert len(found) == 3 * len(places)


@pytest.mark.parametrize("geometry", [None, {}, {"views": None}])
def test_a_run_without_scores_of_geometry_has_only_scores_of_pictures(geometry: dict[str, Any] | None) -> None:
    run = scored("run", 20.0)
    run.scores()["geometry"] = geometry
    assert [row["reference"] for row in TABLES[Run]["scores"](run)] == ["lit", "lit"]


def test_a_score_of_ones_own_may_be_called_an_error_or_a_bias() -> None:
    run = SimpleNamespace(path=Path(), scores=lambda: {"views": {"0": {"lit": {"angular_error": 3.0, "a_bias": 2.0}}}})
    found = [(row["score"], row["value"], row["error"]) for row in TABLES[Run]["scores"](run)]
    assert found == [("angular_error", 3.0, None), ("a_bias", 2.0, None)]


def test_numbers_that_are_text_in_json_are_numbers_in_a_frame_and_names_stay_text(tmp_path: Path) -> None:
    """Rationale: a column with one infinite error was text, whose sum is more text."""
    pytest.importorskip("pandas")
    row = {"scene": "inf", "state": "done", "lit.psnr": 20.0, "lit.psnr_error": 0.5}
    study = StudyResults(tmp_path, {"scene": ["inf"]}, (row, row | {"lit.psnr": "nan", "lit.psnr_error": "inf"}))
    found = frame(study)
    assert found["lit.psnr_error"].tolist() == [0.5, float("inf")]
    assert found["lit.psnr"].mean() == 20.0
    assert found["scene"].tolist() == ["inf", "inf"]
    (tmp_path / DIFFERENCES).write_text("quality,method,error\nNone,nova,\n90,nova,inf\n")
    found = frame(study, "differences")
    assert found["quality"].tolist() == ["None", "90"]
    assert found["error"].isna().tolist() == [True, False]


def test_a_run_that_was_not_scored_names_the_command_that_scores_it() -> None:
    run = SimpleNamespace(path=Path("made"), scores=lambda: None)
    with pytest.raises(ValueError, match="made has not been scored: novags score made"):
        list(TABLES[Run]["scores"](run))


def test_scores_along_a_fit_are_of_every_place_where_it_was_looked_at() -> None:
    along = [{"iterations": n, "mean": {"lit": {"psnr": n / 10}, "enhanced": None}} for n in (100, 200)]
    run = SimpleNamespace(scores=lambda: {"along": along})
    found = [(row["iterations"], row["score"], row["value"]) for row in TABLES[Run]["along"](run)]
    assert found == [(100, "psnr", 10.0), (200, "psnr", 20.0)]
    assert not list(TABLES[Run]["along"](SimpleNamespace(scores=lambda: None)))


def test_a_view_stands_where_its_camera_does_and_has_its_lens() -> None:
    """The axes of the cameras are those of the world, in another order; the first looks along x."""
    turn = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]], float)
    centres = np.array([[1, 2, 4], [3, 5, 8]], float)
    viewmats = np.tile(np.eye(4), (2, 1, 1))
    viewmats[:, :3, :3] = turn, turn.T
    viewmats[:, :3, 3] = [-pose[:3, :3] @ centre for pose, centre in zip(viewmats, centres, strict=True)]
    Ks = np.array([[[30, 0, 7], [0, 40, 9], [0, 0, 1]]] * 2, float)
    rig = SimpleNamespace(viewmats=viewmats, Ks=Ks, width=16, height=20)
    views = SimpleNamespace(names=("0000", "0001"), rig=rig, test_indices=[1])
    lens = {"fx": 30, "fy": 40, "cx": 7, "cy": 9, "width": 16, "height": 20}
    assert list(TABLES[MultiviewSet]["views"](views)) == [
        {"view": "0000", "held_out": False, "x": 1, "y": 2, "z": 4, **lens},
        {"view": "0001", "held_out": True, "x": 3, "y": 5, "z": 8, **lens},
    ]


def test_the_first_table_is_the_one_that_is_meant_where_none_is_named(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    study = StudyResults(tmp_path, {}, ({"run": 0, "state": "done"}, {"run": 1, "state": "failed"}))
    (tmp_path / DIFFERENCES).write_text("method,than,difference\nnova,naive,1.5\n")
    assert frame(study).to_dict("records") == [dict(row) for row in study.rows]
    (difference,) = frame(study, "differences").to_dict("records")
    assert difference == {"method": "nova", "than": "naive", "difference": 1.5}
    with pytest.raises(ValueError, match="a StudyResults has no table 'losses', it has: runs, scores, differences"):
        frame(study, "losses")
