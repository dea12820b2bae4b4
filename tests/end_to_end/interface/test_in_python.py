"""Claims about novags in Python: folders opened by what they hold, their tables, and commands in the background."""

import shutil
import time
from pathlib import Path

import numpy as np
import pytest

import novags
from novags.interface import commanding
from novags.testbed.ledger.contents import read_json, write_json
from simscenes import MultiviewSet

pd = pytest.importorskip("pandas")


def test_a_folder_is_opened_by_what_it_holds(experiment: Path) -> None:
    study = novags.open(experiment, novags.StudyResults)
    assert study.axes["method"] == ["nova-fast", "naive", "oracle"]
    assert [run.name for _, run in study.runs()] == ["nova-fast", "naive", "oracle"]
    ((row, run),) = study.runs(method="naive")
    assert row["enhanced.psnr"] == run.scores()["mean"]["enhanced"]["psnr"]
    assert novags.open(experiment / "naive", novags.Run).record == run.record
    capture = novags.open(str(experiment / "capture"), novags.Capture)
    assert capture.raw(0).dtype == np.uint16
    views = novags.open(experiment / "set", MultiviewSet)
    assert views.radiance(0).shape == (24, 24, 3)
    with pytest.raises(ValueError, match=r"has no axis light; its axes: .*method"):
        next(study.runs(light=3))
    with pytest.raises(ValueError, match="is a Run, not a Capture"):
        novags.open(experiment / "naive", novags.Capture)
    with pytest.raises(ValueError, match="no such folder"):
        novags.open(experiment / "nothing")


def test_what_is_not_finished_or_was_changed_is_refused(experiment: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="is neither a run, a capture nor a study, and no set either"):
        novags.open(tmp_path)
    shutil.copytree(experiment / "naive", run := tmp_path / "naive")
    shutil.copytree(experiment / "set", set_ := tmp_path / "set")
    (run / "renders" / "0000.png").write_bytes(b"another picture")
    with pytest.raises(ValueError, match=r"renders/0000\.png .*put back the original"):
        novags.open(run)
    (set_ / "images" / "0001.png").unlink()
    with pytest.raises(ValueError, match=r"images/0001\.png"):
        novags.open(set_)
    shutil.copytree(experiment / "oracle", tmp_path / "oracle")
    table = {"axes": {"method": ["naive", "oracle"]}, "columns": [],
             "rows": [{"run": k, "method": name, "state": "done", "folder": name}
                      for k, name in enumerate(("oracle", "naive"))]}  # fmt: skip
    write_json(tmp_path / "results.json", table)
    runs = novags.open(tmp_path, novags.StudyResults).runs()
    assert next(runs)[1].name == "oracle"
    with pytest.raises(ValueError, match="put back the original"):
        next(runs)


def test_scores_are_one_row_each_and_those_of_the_record(experiment: Path) -> None:
    run = novags.open(experiment / "naive", novags.Run)
    found = novags.frame(run)
    assert list(found.columns) == ["view", "reference", "score", "value", "error", "bias"]
    views = read_json(experiment / "naive" / "metrics.json")["methods"]["naive"]["views"]
    assert set(found["view"]) == set(views)
    for view, references in views.items():
        for reference, scores in references.items():
            mine = found[(found["view"] == view) & (found["reference"] == reference)].set_index("score")
            assert mine.loc["psnr", "value"] == scores["psnr"]
            assert mine.loc["psnr", "error"] == scores.get("psnr_error")
            assert mine.loc["ssim", "bias"] == scores.get("ssim_bias")
    assert not found["score"].str.endswith(("_error", "_bias")).any()
    assert {"abs_rel", "coverage"} <= set(found[found["reference"] == "geometry"]["score"])
    means = novags.frame(run, "scores").query("reference == 'enhanced' and score == 'aligned_psnr'")["value"].mean()
    assert means == pytest.approx(run.scores()["mean"]["enhanced"]["aligned_psnr"])
    losses = novags.frame(run, "losses")
    assert losses["iteration"].is_monotonic_increasing
    assert losses["photometric"].iloc[-1] == run.events()[-1]["photometric"]


def test_a_study_is_a_row_a_run_and_its_scores_carry_the_axes(experiment: Path) -> None:
    study = novags.open(experiment)
    runs = novags.frame(study)
    assert runs["method"].tolist() == ["nova-fast", "naive", "oracle"]
    scores = novags.frame(study, "scores")
    assert list(scores.columns[:2]) == ["run", *study.axes][:2]
    for _, run in study.runs():
        own = scores[scores["method"] == run.name]
        assert own["value"].tolist() == novags.frame(run)["value"].tolist()
    differences = novags.frame(study, "differences")
    assert {"method", "than", "difference", "error", "seen"} <= set(differences.columns)
    assert len(differences) == len((experiment / "differences.csv").read_text().splitlines()) - 1


def test_cameras_are_a_row_a_view_in_sets_and_captures(experiment: Path) -> None:
    views = novags.open(experiment / "set", MultiviewSet)
    found = novags.frame(views)
    assert found["view"].tolist() == list(views.names)
    assert found.index[found["held_out"]].tolist() == views.test_indices
    back = views.rig.viewmats[3][:3, :3] @ found.loc[3, ["x", "y", "z"]].to_numpy(float) + views.rig.viewmats[3][:3, 3]
    assert np.abs(back).max() < 1e-9  # the centre of a camera is its own origin
    assert novags.frame(novags.open(experiment / "capture"), "views")["fx"].tolist() == found["fx"].tolist()
    with pytest.raises(ValueError, match="a MultiviewSet has no table 'scores', it has: views"):
        novags.frame(views, "scores")


def test_a_run_that_was_not_scored_says_so(experiment: Path, tmp_path: Path) -> None:
    shutil.copytree(experiment / "naive", tmp_path / "naive")
    (tmp_path / "naive" / "metrics.json").unlink()
    with pytest.raises(ValueError, match="has not been scored: novags score"):
        novags.frame(novags.open(tmp_path / "naive"))
    assert novags.frame(novags.open(tmp_path / "naive"), "along").empty


SMALL = {"scene": "cornell", "views": 9, "width": 24, "height": 24, "spp": 4, "points": 200, "iterations": 10,
         "methods": ["naive"], "variant": ["low=naive:init_scale=2"], "electrons": 50}  # fmt: skip


def test_an_experiment_is_run_waited_for_and_opened(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    job = novags.run(out=tmp_path / "made", background=True, show=False, **SMALL)
    assert isinstance(job, novags.BackgroundCommand)
    with pytest.raises(TimeoutError, match=r"novags run is not done after 0\.01 s"):
        job.wait(0.01)
    assert job.running
    study = job.wait()
    assert not job.running
    assert [run.name for _, run in study.runs()] == ["naive", "low"]
    assert any("reconstruct" in line for line in job.said)
    assert capfd.readouterr().err == ""
    again = novags.run(out=tmp_path / "made", **SMALL)  # finished work is kept
    assert [row["folder"] for row in again.rows] == [row["folder"] for row in study.rows]
    assert "report: " in capfd.readouterr().err


def test_what_a_command_refuses_is_the_message(tmp_path: Path) -> None:
    with pytest.raises(novags.CommandError, match=r"novags run ended with 2: .*views"):
        novags.run(out=tmp_path / "made", views=1, show=False)
    with pytest.raises(novags.CommandError, match=r"novags study ended with 2: .*absent\.toml"):
        novags.study(tmp_path / "absent.toml", out=tmp_path / "made", show=False)
    for wrong in ("sceen", "cluster", "dry_run"):
        with pytest.raises(ValueError, match=f"novags run has no option {wrong} here"):
            novags.run(out=tmp_path / "made", **{wrong: "cornell"})
    assert not (tmp_path / "made").exists()


def test_a_command_that_is_stopped_ends_as_by_ctrl_c(tmp_path: Path) -> None:
    job = novags.run(out=tmp_path / "made", background=True, show=False, **{**SMALL, "iterations": 100_000})
    while not any("reconstruct" in line for line in job.said):
        assert job.running, job.said
        time.sleep(0.1)
    job.stop()
    assert not job.running
    with pytest.raises(novags.CommandError, match="ended with 130: .*the same command again continues"):
        job.wait()


@pytest.mark.parametrize(
    ("setting", "value", "words"),
    [("electrons", 20, ["--electrons", "20"]), ("methods", ("naive", "oracle"), ["--methods", "naive", "oracle"]),
     ("variant", ["a=naive:x=1", "b=naive:x=2"], ["--variant", "a=naive:x=1", "--variant", "b=naive:x=2"]),
     ("overwrite", True, ["--overwrite"]), ("overwrite", False, []), ("max_size", 96, ["--max-size", "96"]),
     ("seed", 0, ["--seed", "0"]), ("seed", None, []), ("define", "n=3", ["--define", "n=3"])],
)  # fmt: skip
def test_options_are_typed_as_the_command_line_reads_them(
    setting: str, value: object, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[list[str]]()
    monkeypatch.setattr(commanding, "BackgroundCommand", lambda command, out, show: asked.append(command))
    novags.run(out=tmp_path, background=True, **{setting: value})
    novags.study("grid.toml", out=tmp_path, background=True, workers=2)
    assert asked == [["run", "--out", str(tmp_path), *words],
                     ["study", "grid.toml", "--out", str(tmp_path), "--workers", "2"]]  # fmt: skip
