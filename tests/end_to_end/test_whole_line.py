"""The whole line at a tiny size: what the folders hold, what is not done twice, what an interruption costs."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from novags.splats import read_ply
from novags.testbed import stages
from novags.testbed.console.terminal import Console, Update
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.runs import runs_in
from novags.testbed.ledger.contents import read_json
from novags.testbed.metrics import METRICS
from novags.testbed.report.page import write_report
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.study.cells.presets import Preset, adapted
from novags.testbed.study.place import run, score_all, together
from novags.testing import DarkCapture, assert_noise, assert_scores
from simscenes import load_set, read_exr


class Interrupting(Console):
    """Presses Ctrl-C when a stage has come so far."""

    def __init__(self, stage: str, after: int) -> None:
        super().__init__(quiet=True)
        self.stage, self.after = stage, after

    @contextmanager
    def progress(self, stage: str, parts: Mapping[str, int] | None = None) -> Iterator[Update]:
        def update(done: int, total: int, what: str) -> None:
            if stage == self.stage and done >= self.after:
                raise KeyboardInterrupt

        yield update


def naive(tiny: Preset) -> ReconstructConfig:
    return tiny.reconstruct("naive")


def modified(folder: Path) -> dict[str, int]:
    return {str(p.relative_to(folder)): p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()}


def copy(experiment: Path, tmp_path: Path, *parts: str) -> Path:
    for part in parts:
        shutil.copytree(experiment / part, tmp_path / part)
    return tmp_path


def test_every_folder_is_complete(experiment: Path, tiny: Preset) -> None:
    names = [f"{i:04d}" for i in range(9)]
    for folder, suffix in (("set/gt", "exr"), ("set/images", "png"), ("capture/raw", "dng"), ("capture/images", "png"),
                           ("capture/images16", "png"), ("capture/truth", "exr")):  # fmt: skip
        assert sorted(p.name for p in (experiment / folder).iterdir()) == [f"{n}.{suffix}" for n in names]
    for method in tiny.methods:
        held_out = sorted(p.stem for p in (experiment / method / "renders").iterdir())
        assert held_out == ["0000", "0008"]
        assert len(list((experiment / method / "enhanced").iterdir())) == 7
        assert (experiment / method / "denoised").is_dir() == (method == "nova-fast")
        assert (
            len(read_ply(experiment / method / "point_cloud.ply"))
            == read_json(experiment / method / "run.json")["gaussians"]
        )
        assert not list((experiment / method).glob("checkpoint*"))
    assert not list(experiment.rglob("unfinished.json"))
    assert not list(experiment.rglob("*.partial*"))


def test_the_capture_has_the_cameras_of_the_set(experiment: Path) -> None:
    made_of, capture = load_set(experiment / "set"), load_set(experiment / "capture")
    assert capture.names == made_of.names
    assert capture.test_indices == made_of.test_indices == [0, 8]
    assert np.allclose(capture.rig.viewmats, made_of.rig.viewmats, atol=1e-9)
    assert np.allclose(capture.rig.Ks, made_of.rig.Ks, atol=1e-9)


def test_the_capture_collects_the_electrons_it_was_asked_for(experiment: Path, tiny: Preset) -> None:
    capture = open_capture(experiment / "capture")
    sensor, green = capture.sensor, []
    for name in capture.names:
        clean = read_exr(experiment / "capture" / "truth" / f"{name}.exr")[0]["clean.G"]
        green.append((clean - sensor.black_level) / sensor.gain)
    assert np.mean(green) == pytest.approx(tiny.capture.electrons, rel=1e-3)


def test_noise_in_the_capture_has_the_variance_the_truth_states(experiment: Path, quiet: Console) -> None:
    capture = open_capture(experiment / "capture")
    known = DarkCapture.of(capture, capture.source(quiet))
    for views in (known.train, known.test):
        assert_noise(views, views.raw)


def test_renders_of_a_run_score_from_their_folder_as_the_run_does(experiment: Path, quiet: Console) -> None:
    capture = open_capture(experiment / "capture")
    known = DarkCapture.of(capture, capture.source(quiet)).test
    of_run = scores_of(experiment)["oracle"]["mean"]["lit"]["psnr"]
    found = assert_scores(known, experiment / "oracle" / "renders", psnr=of_run - 0.1)["psnr"]
    assert found == pytest.approx(of_run, abs=0.1)  # the run keeps floats beside its 8-bit pictures


def scores_of(experiment: Path) -> dict[str, Any]:
    """The scores of each run of an experiment, by its name."""
    return {name: run.scores() for name, run in runs_in([experiment]).items()}


def test_metrics_have_the_documented_shape(experiment: Path, tiny: Preset) -> None:
    assert read_json(experiment / "naive" / "metrics.json").keys() == {"methods", "unavailable", "stage"}
    assert tuple(scores_of(experiment)) == tiny.methods
    for method in scores_of(experiment).values():
        assert {"mean", "views", "seconds", "peak_bytes"} <= method.keys()
        assert method["views"].keys() == {"0000", "0008"}
        for scores in (method["mean"], *method["views"].values()):
            assert scores.keys() == {"enhanced", "lit"}
            corrected = {name for name, metric in METRICS.items() if metric.squared}
            known = {name for name, metric in METRICS.items() if not metric.protocol}  # others are of other data
            moved = {name for name in known if METRICS[name].missing is None} - corrected
            about = {f"{name}_error" for name in corrected} | {f"{name}_bias" for name in moved} | {"truth_variance"}
            assert scores["enhanced"].keys() == scores["lit"].keys() == known | about
        assert {"render", "capture", "reconstruct"} <= method["seconds"].keys()
        assert method["peak_bytes"] > 0
    rows = {row["method"]: row for row in read_json(experiment / "results.json")["rows"]}
    assert {name for name, row in rows.items() if "recovered" in row} <= {"nova-fast"}
    for name, method in scores_of(experiment).items():
        assert rows[name]["lit.psnr"] == method["mean"]["lit"]["psnr"]


def test_only_the_oracle_was_shown_the_noise_free_exposures(experiment: Path) -> None:
    methods = scores_of(experiment)
    training = {name: method["training_2d"]["enhanced"]["psnr"] for name, method in methods.items()}
    assert training["oracle"] > 55  # what is left is rounding to 8 bits
    assert training["naive"] == training["nova-fast"] < 35


def test_records_say_what_was_done_with_what(experiment: Path, tiny: Preset) -> None:
    for folder, record in (
        ("set", "set.json"),
        ("capture", "capture.json"),
        ("nova-fast", "run.json"),
        ("nova-fast", "metrics.json"),
    ):
        stage = read_json(experiment / folder / record)["stage"]
        assert stage["seconds"] > 0
        assert stage["peak_bytes"] > 0
        assert stage["inputs"]
        assert {"versions", "hardware", "config"} <= stage.keys()
    assert read_json(experiment / "nova-fast" / "run.json")["config"]["fit"]["iterations"] == 30


def test_the_commands_that_the_report_gives_make_equal_files(
    experiment: Path, tmp_path: Path, call: Callable[..., int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each as a user copies it from the page, run where the page lies: one by a shell, the others in this process."""
    folder = copy(experiment, tmp_path, "set", "capture", "nova-fast", "naive", "oracle")
    shutil.copy(experiment / "report.html", folder)
    found = re.findall(r'data-command="([^"]+)"', (folder / "report.html").read_text("utf-8"))
    first, *others = sorted({unescape(text) for text in found})
    assert len(others) == 2
    done = subprocess.run(["sh", "-c", first], cwd=folder, env=_with_ours(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    monkeypatch.chdir(folder)
    for command in " && ".join(others).split(" && "):
        program, *words = shlex.split(command)
        assert program == "novags"
        assert call(*words) == 0
    for name in ("nova-fast", "naive", "oracle"):
        made, before = pictures(folder / f"{name}-again"), pictures(folder / name)
        assert len(made) > 20
        assert made == before


def pictures(folder: Path) -> dict[str, bytes]:
    """Everything that a run holds but its records, which tell times."""
    found = (path for path in folder.rglob("*") if path.suffix in (".png", ".exr", ".ply"))
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def _with_ours() -> dict[str, str]:
    """An environment in which `novags` is the one that is tested."""
    return {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def test_a_second_run_does_nothing_but_the_report(experiment: Path, tiny: Preset, quiet: Console) -> None:
    before = modified(experiment)
    run(tiny, experiment, quiet, report=write_report, command="novags run")
    changed = {name for name, when in modified(experiment).items() if before.get(name) != when}
    assert changed == {"experiment.json", "report.html", "results.csv", "differences.csv", "results.json"}


def test_pictures_too_small_for_raw_files_are_refused_before_the_capture(
    experiment: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    small = adapted(tiny, scene=str(experiment / "set"), max_size=21)
    with pytest.raises(ValueError, match=r"images of 21 x .* LibRaw refuses: it takes 22 px .*take larger images"):
        run(small, tmp_path / "out", quiet, report=write_report)
    assert not (tmp_path / "out" / "capture").exists()


def test_another_request_on_the_same_folder_is_refused_before_any_work(
    experiment: Path, tiny: Preset, quiet: Console
) -> None:
    before = modified(experiment)
    for other, said in (
        (replace(tiny, capture=replace(tiny.capture, electrons=5.0)), r"capture holds .*electrons was 20.0, is 5.0"),
        (
            replace(tiny, methods=("naive", "naive-l1", "oracle")),
            "comparison with nova-fast, which this request leaves",
        ),
        # The last of them: what comes before it must not be computed first.
        (replace(tiny, methods=("naive-l1", *tiny.methods), points=400), "nova-fast holds .*points was 300, is 400"),
    ):
        with pytest.raises(ValueError, match=said):
            run(other, experiment, quiet, report=write_report)
    assert modified(experiment) == before


def test_a_changed_light_captures_again_but_does_not_render_again(
    experiment: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    folder = copy(experiment, tmp_path, "set", "capture")
    before = modified(folder)
    brighter = replace(tiny, capture=replace(tiny.capture, electrons=80.0), methods=("naive",))
    run(brighter, folder, quiet, report=write_report, overwrite=True)
    after = modified(folder)
    assert all(after[name] == when for name, when in before.items() if name.startswith("set/"))
    assert all(after[name] != when for name, when in before.items() if name.startswith("capture/images/"))


def test_a_changed_capture_is_reconstructed_and_scored_again_and_until_then_refused(
    experiment: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    folder = copy(experiment, tmp_path, "set", "capture", "naive")
    before = (folder / "naive" / "point_cloud.ply").read_bytes(), stages.score(folder / "naive", quiet)
    stages.capture(folder / "set", folder / "capture", replace(tiny.capture, electrons=5.0), quiet, overwrite=True)
    for use in (stages.score, write_report):
        with pytest.raises(ValueError, match=r"capture has changed since .*naive was made .* reconstruct again"):
            use(folder / "naive", quiet)
    stages.reconstruct(folder / "capture", folder / "naive", tiny.reconstruct("naive"), quiet, overwrite=True)
    assert (folder / "naive" / "point_cloud.ply").read_bytes() != before[0]
    assert not (folder / "naive" / "metrics.json").exists()
    assert stages.score(folder / "naive", quiet)["methods"]["naive"]["mean"] != before[1]["methods"]["naive"]["mean"]


def test_a_capture_of_a_set_that_has_changed_is_refused(
    experiment: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    folder = copy(experiment, tmp_path, "set", "capture", "naive")
    stages.render(folder / "set", replace(tiny.render, seed=1), quiet, overwrite=True)
    for use in (
        lambda: stages.reconstruct(folder / "capture", tmp_path / "run", tiny.reconstruct("naive"), quiet),
        lambda: stages.score(folder / "naive", quiet),
    ):
        with pytest.raises(ValueError, match=r"set has changed since .*capture was made .* capture again"):
            use()


def test_an_interrupted_second_configuration_leaves_no_report_that_mixes_both(
    experiment: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(experiment, folder)
    other = replace(tiny, settings={**tiny.settings, "fit.iterations": 20})
    with pytest.raises(KeyboardInterrupt):
        run(other, folder, Interrupting("reconstruct oracle", 10), report=write_report, overwrite=True)
    assert not {"experiment.json", "report.html"} & {path.name for path in folder.iterdir()}
    (done,) = runs_in([folder]).values()  # of this configuration, though the oracle of the other is there
    assert (done.name, done.record["config"]["fit"]["iterations"]) == ("naive", 20)
    assert "Rendered by oracle" not in write_report(folder, quiet).read_text(encoding="utf-8")
    run(other, folder, quiet, report=write_report, overwrite=True)
    assert "Rendered by oracle" in (folder / "report.html").read_text(encoding="utf-8")


def test_scores_of_an_earlier_run_are_not_reported(
    experiment: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(experiment, folder)
    config = replace(tiny.reconstruct("naive"), seed=1)
    stages.reconstruct(folder / "capture", folder / "naive", config, quiet, overwrite=True)
    with pytest.raises(ValueError, match="naive is not scored: run novags score .*naive"):
        write_report(folder, quiet)
    before = read_json(folder / "results.json")["rows"]
    for place, runs in together([folder / "naive"]).items():
        assert place == folder
        score_all(place, runs, quiet)
    write_report(folder, quiet)
    shares = ("recovered", "recovered_lit")  # they change with the floor
    for was, row in zip(before, read_json(folder / "results.json")["rows"], strict=True):
        if row["method"] == "naive":
            assert row["lit.psnr"] == scores_of(folder)["naive"]["mean"]["lit"]["psnr"] != was["lit.psnr"]
        else:
            assert {name: row[name] for name in row if name not in shares} == {
                name: was[name] for name in was if name not in shares}  # fmt: skip


def test_a_method_that_was_never_scored_is_not_reported(experiment: Path, quiet: Console, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(experiment, folder)
    (folder / "naive" / "metrics.json").unlink()
    with pytest.raises(ValueError, match="naive is not scored"):
        write_report(folder, quiet)


def test_the_16_bit_pictures_can_be_reconstructed_too(
    experiment: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    config = replace(tiny, settings={**tiny.settings, "pictures": "16bit"}).reconstruct("naive")
    record = stages.reconstruct(experiment / "capture", tmp_path / "run", config, quiet)
    assert record["enhancement"]["pictures"] == "16bit"
    assert stages.score(tmp_path / "run", quiet)["methods"]["naive"]["mean"]["enhanced"]["psnr"] > 5


def test_a_damaged_picture_gives_one_clear_error(
    experiment: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    folder = copy(experiment, tmp_path, "set", "capture")
    picture = folder / "capture" / "images" / "0003.png"
    picture.write_bytes(picture.read_bytes()[:50])
    with pytest.raises(ValueError, match=r"images/0003\.png not as written"):
        stages.reconstruct(folder / "capture", folder / "naive", naive(tiny), quiet)


def test_missing_truth_gives_one_clear_error(experiment: Path, quiet: Console, tmp_path: Path) -> None:
    folder = copy(experiment, tmp_path, "set", "capture", "naive")
    (folder / "capture" / "truth" / "0008.exr").unlink()
    with pytest.raises(ValueError, match=r"capture: truth/0008\.exr not as written"):
        stages.score(folder / "naive", quiet)
    with pytest.raises(ValueError, match=r"0008\.exr"):
        open_capture(folder / "capture")


def test_a_moved_set_gives_one_clear_error(experiment: Path, quiet: Console, tmp_path: Path) -> None:
    folder = copy(experiment, tmp_path, "capture", "naive")
    with pytest.raises(ValueError, match=r"made from the set \.\./set .* not there"):
        stages.score(folder / "naive", quiet)


def test_an_experiment_folder_can_be_moved(experiment: Path, quiet: Console, tmp_path: Path) -> None:
    folder = copy(experiment, tmp_path, "set", "capture", "naive")
    before = modified(folder)
    stages.score(folder / "naive", quiet)
    assert modified(folder) == before


@pytest.mark.parametrize("content", ["", "{", '{"sensor": 1}'])
def test_a_damaged_record_gives_one_clear_error(experiment: Path, tmp_path: Path, content: str) -> None:
    folder = copy(experiment, tmp_path, "capture")
    (folder / "capture" / "capture.json").write_text(content)
    with pytest.raises(ValueError, match=r"capture\.json"):
        open_capture(folder / "capture")


def test_the_report_is_one_self_contained_file(experiment: Path) -> None:
    page = (experiment / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://", page)
    assert 'data-block="absent"' not in page  # all rows are here
    assert "<link" not in page
    assert "@import" not in page
    sources = re.findall(r"<img[^>]*\ssrc=\"([^\"]{0,20})", page)
    assert sources
    assert all(source.startswith("data:image/") for source in sources)
    assert all(alt.strip() for alt in re.findall(r"<figure[^>]*><img[^>]*\salt=\"([^\"]*)\"", page))


def test_the_report_states_the_scores_that_were_measured(experiment: Path, tiny: Preset) -> None:
    page = (experiment / "report.html").read_text(encoding="utf-8")
    methods = scores_of(experiment)
    for method in tiny.methods:
        for kind in ("enhanced", "lit"):
            assert f"{methods[method]['mean'][kind]['aligned_psnr']:.2f}" in page
    assert "unavailable" in page  # LPIPS has no weights here
