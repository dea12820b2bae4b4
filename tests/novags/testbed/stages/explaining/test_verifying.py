"""Claims about `novags verify`: equal results are said to be equal, and every difference is named with its stage."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.run import open_run
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.stages.explaining import verifying as module
from novags.testbed.stages.explaining.recorded import taking_of
from novags.testbed.stages.explaining.verifying import RECORD, Verified, chosen_runs, verify
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.study.results import rescored

QUIET = Console(quiet=True)
STAGES = ["set", "capture", "run", "scores"]


def fitted(capture: Path, out: Path, *methods: str) -> None:
    preset = adapted(EXPERIMENTS["demo"], methods=methods, iterations=4, points=60, device="cpu")
    for name in methods:
        stages.reconstruct(capture, out / name, preset.reconstruct(name), QUIET)
        stages.score(out / name, QUIET)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rendered set, a capture behind a mosaic through JPEG, and three runs, one of them the mean of two fits."""
    folder = tmp_path_factory.mktemp("made")
    scene = RenderConfig(scene="cornell:2", n_views=4, width=32, height=24, spp=4, truth_samples=2.0, seed=3)
    stages.render(folder / "set", scene, QUIET)
    dark = CaptureConfig(sensor="a7s2-iso6400", electrons=50.0, seed=4, demosaic="bilinear", jpeg_quality=90)
    stages.capture(folder / "set", folder / "capture", dark, QUIET)
    fitted(folder / "capture", folder / "runs", "naive", "raw-gs", "naive*2")
    return folder


@pytest.fixture
def place(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "made")


def found(place: Path, *names: str) -> list[Verified]:
    return verify(chosen_runs([place / "runs" / name for name in names], 9, 0), place.parent / "again", QUIET)


def test_all_files_and_scores_are_what_they_were(place: Path) -> None:
    parts = found(place, "naive", "raw-gs", "naive*2")
    assert [part.stage for part in parts] == 3 * STAGES
    assert all(part.same for part in parts), [part.line() for part in parts]
    assert all(part.parts > 4 for part in parts)
    assert parts[2].line() == f"naive: run: all {parts[2].parts} files are the same"
    assert parts[3].line() == f"naive: scores: all {parts[3].parts} scores are the same"
    again = place.parent / "again"
    assert {path.name for path in again.iterdir() if path.is_dir()} == {"naive", "raw-gs", "naive-x2"}
    assert len(json.loads((again / RECORD).read_text())["parts"]) == 12
    wanted, have = ((folder / "renders" / "0000.png").read_bytes()
                    for folder in (place / "runs" / "naive", again / "naive" / "run"))  # fmt: skip
    assert wanted == have
    shared = [path.parent.name for name in ("set", "capture") for path in again.glob(f"*/{name}")]
    assert shared == ["naive"] * 2  # the others are of the same set and capture


@pytest.mark.parametrize("forged", ["geometry.abs_rel", "noise.renders", "training_2d.blur.psnr", "mean.lit.ssim"])
def test_every_kind_of_score_is_compared(forged: str) -> None:
    """Rationale: depths and noise could say anything, and all scores were said to be the same."""
    depth = {"abs_rel": 0.1, "views": {"0000": {"abs_rel": 0.1}}}
    scores = {"mean": {"lit": {"ssim": 0.5}}, "geometry": depth, "noise": {"renders": 0.2},
              "training_2d": {"blur": {"psnr": 20.0}}, "seconds": {"render": 3.0}}  # fmt: skip
    other: Any = json.loads(json.dumps(scores | {"seconds": {"render": 4.0}}))
    assert module._compared("naive", scores, other).same
    part, (*above, last) = other, forged.split(".")
    for name in above:
        part = part[name]
    part[last] += 1.0
    found = module._compared("naive", scores, other)
    assert found.differ == (forged.removeprefix("mean."),)
    assert found.parts == 4


def test_nothing_of_the_inputs_is_taken_over(place: Path) -> None:
    """Rationale: a link or a copy of what is verified would always be the same."""
    found(place, "naive")
    for name in ("set/images/0000.png", "capture/images/0001.png"):
        own, other = place / name, place.parent / "again" / "naive" / name
        assert own.read_bytes() == other.read_bytes()
        assert own.stat().st_ino != other.stat().st_ino


def test_a_method_that_fits_otherwise_now_is_named_with_its_files_and_scores(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A seed that is another one: stages before the fit are what they were, the record of the fit too."""
    reconstruct = module.reconstruct

    def otherwise(capture: Path, out: Path, config: Any, console: Console, **more: Any) -> Any:
        return reconstruct(capture, out, replace(config, seed=config.seed + 1), console, **more)

    monkeypatch.setattr(module, "reconstruct", otherwise)
    parts = dict(zip(STAGES, found(place, "naive"), strict=True))
    assert parts["set"].same
    assert parts["capture"].same
    assert "point_cloud.ply" in parts["run"].differ
    assert f"{len(parts['run'].differ)} of {parts['run'].parts} files differ: " in parts["run"].line()
    assert parts["scores"].differ
    assert parts["scores"].largest is not None
    assert parts["scores"].largest > 0
    before, after = (
        open_run(folder).scores() for folder in (place / "runs" / "naive", place.parent / "again/naive/run")
    )
    assert before is not None
    assert after is not None
    gaps = [abs(before["mean"][kind][name] - after["mean"][kind][name])
            for kind in before["mean"] for name in (before["mean"][kind] or {}) if name.endswith("psnr")
            and before["mean"][kind][name] is not None]  # fmt: skip
    assert parts["scores"].largest == pytest.approx(max(gaps))
    assert f"scores differ, by {max(gaps):.3g} dB at most" in parts["scores"].line()


def test_noise_of_another_seed_is_a_difference_of_the_capture(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    take = module.take
    monkeypatch.setattr(module, "take", lambda views, out, config, console, **more: take(
        views, out, replace(config, seed=config.seed + 1), console, **more))  # fmt: skip
    parts = dict(zip(STAGES, found(place, "naive"), strict=True))
    assert parts["set"].same
    assert {"images/0000.png", "raw/0000.dng"} <= set(parts["capture"].differ)
    assert not any(name.startswith("sparse") for name in parts["capture"].differ)
    assert parts["run"].same  # it is made from the capture that there is


def test_settings_that_this_version_does_not_have_are_not_made_into_others(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    resolved = RenderConfig.resolved
    monkeypatch.setattr(RenderConfig, "resolved", lambda self: resolved(self) | {"new": 1})
    monkeypatch.setattr(CaptureConfig, "resolved", lambda self: {})
    parts = dict(zip(STAGES, found(place, "naive"), strict=True))
    for stage in ("set", "capture"):
        assert not parts[stage].same
        assert parts[stage].line() == (
            f"naive: {stage}: not made again: this version does not make the {stage} again as it was made"
        )
    assert parts["run"].same


def test_photographs_and_their_captures_are_named_as_what_cannot_be_made_again(capture: Path, tmp_path: Path) -> None:
    fitted(shutil.copytree(capture.parent, tmp_path / "foreign") / "capture", tmp_path / "runs", "naive")
    parts = verify(chosen_runs([tmp_path / "runs"], 1, 0), tmp_path / "again", QUIET)
    assert [part.why_not for part in parts] == ["the set shows no scene of the catalogue", "", "", ""]
    assert [part.same for part in parts] == [False, True, True, True]


def test_a_run_that_cannot_be_made_here_does_not_cost_the_others(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reconstruct = module.reconstruct

    def lacking(capture: Path, out: Path, config: Any, console: Console, **more: Any) -> Any:
        if config.variant.name == "naive":
            raise ValueError("its weights are not here")
        return reconstruct(capture, out, config, console, **more)

    monkeypatch.setattr(module, "reconstruct", lacking)
    parts = found(place, "naive", "raw-gs")
    assert [part.why_not for part in parts] == ["", "", *["its weights are not here"] * 2, "", "", "", ""]
    assert [part.same for part in parts] == [True, True, False, False, True, True, True, True]
    assert len(json.loads((place.parent / "again" / RECORD).read_text())["parts"]) == 8


@pytest.mark.parametrize(
    ("sensor", "more", "why"),
    [("own camera", {}, "its camera, own camera, is not in the catalogue"),
     ("a7s2-iso6400", {"dark_frames": "hash"}, "its noise comes from dark frames")],
)  # fmt: skip
def test_captures_that_need_files_of_the_user_say_so(sensor: str, more: dict[str, str], why: str) -> None:
    record = SimpleNamespace(sensor_name=sensor, stage={"config": more})
    capture: Any = SimpleNamespace(record=record, imported=None)
    with pytest.raises(ValueError, match=why):
        taking_of(capture)


@pytest.mark.parametrize("file", ["capture/images/0001.png", "set/images/0001.png", "runs/naive/renders/0000.png"])
def test_a_run_with_a_file_that_has_changed_is_named_and_does_not_cost_the_others(file: str, place: Path) -> None:
    """The others here are of another capture and set."""
    shutil.copytree(place, place.parent / "sound")
    picture = place / file
    picture.write_bytes(picture.read_bytes()[::-1])
    runs = [place / "runs" / "naive", place.parent / "sound" / "runs" / "raw-gs"]
    bad, *good = verify(chosen_runs(runs, 9, 0), place.parent / "again", QUIET)
    assert bad.line().startswith("naive: all of it: not made again: ")
    assert picture.name in bad.why_not
    assert not bad.same
    assert [part.stage for part in good] == STAGES
    assert all(part.same for part in good)


def test_runs_are_drawn_by_the_seed_and_stay_in_their_order(made: Path) -> None:
    draws = [list(chosen_runs([made / "runs"], 2, seed)) for seed in range(12)]
    assert all(len(draw) == 2 for draw in draws)
    assert len({tuple(draw) for draw in draws}) == 3
    every = list(chosen_runs([made / "runs"], 100, 0))
    assert sorted(every) == ["naive", "naive-x2", "raw-gs"]
    assert all(draw == [name for name in every if name in draw] for draw in draws)
    assert list(chosen_runs([made / "runs"], 2, 5)) == draws[5]


def test_the_command_ends_with_three_where_something_differs(
    place: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place)
    assert call("verify", "runs/naive", "--out", "again") == 0
    assert "naive: run: all " in capsys.readouterr().out
    monkeypatch.setattr(module, "render", lambda *_, **__: {"stage": {"files": {}}})
    assert call("verify", "runs/naive", "--out", "again") == 3
    assert "naive: set: " in capsys.readouterr().out
    assert call("verify", "runs/naive", "--out", "other", "--count", "0") == 2
    assert "count must be" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["results.json", "results.csv"])
def test_a_score_that_is_another_one_in_the_tables_of_a_study_is_a_difference(
    name: str, place: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Rationale: these are the numbers that people print, and every run may be what it was."""
    monkeypatch.chdir(place.parent)
    study = place / "study"
    study.mkdir()
    runs = [("s", "naive"), ("s", "raw-gs"), ("t", "naive")]
    rows = [{"run": k, "scene": scene, "method": method, "state": "done", "folder": f"../runs/{method}"}
            for k, (scene, method) in enumerate(runs, 1)]  # fmt: skip
    table = {"axes": {"scene": ["s", "t"], "method": ["naive", "raw-gs"]}, "rows": rows}
    (study / "results.json").write_text(json.dumps(table))
    rescored(study)
    monkeypatch.setattr(module, "verify", lambda chosen, out, console, tables: list(tables))
    assert call("verify", str(study), "--out", "same") == 0
    assert capsys.readouterr().out == "study: tables: all 3 files are the same\n"
    score = next(row for row in json.loads((study / "results.json").read_text())["rows"])["lit.psnr"]
    text = (study / name).read_text()
    (study / name).write_text(text.replace(f"{score}", f"{score + 3}", 1))
    assert call("verify", str(place), "--out", "other") == 3
    assert capsys.readouterr().out == f"study: tables: 1 of 3 files differ: {name}\n"
