"""The stop of a fit sees no truth, and the fit sees nothing of the views that judge it."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.methods import METHODS, chosen
from novags.settings import changed
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders import capture as captures
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.references import enhanced_truth
from novags.testbed.folders.run import Run, open_run
from novags.testbed.metrics.images import aligned_psnr
from novags.testbed.report.blocks.length import length
from novags.testbed.report.material import material_of
from novags.testbed.report.page import write_report
from novags.testbed.report.place import places_in
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.stages.explaining.swaps import Case
from novags.testbed.stages.reconstructing import holding_out
from novags.testbed.stages.scores import lengths
from novags.testbed.stages.scores.lengths import Stops, held_out_scores, length_columns, lengths_of
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.study.results import flat_scores

QUIET = Console(quiet=True)
LENGTHS = (10, 20)
SHORT = {"fit.iterations": 30, "fit.keep_at": LENGTHS, "enhance.window": 9, "denoiser.warmup_steps": 2}


def config_of(name: str, hold_out: int = 1) -> ReconstructConfig:
    """A short fit, shown along its length."""
    variant = chosen(name)
    published = METHODS[variant.method].config()
    settings = {key: value for key, value in SHORT.items() if not key.startswith("denoiser.") or name == "nova-fast"}
    config = changed(variant.config(published, {}), settings, what=name)
    return ReconstructConfig(variant=variant, config=config, points=120, hold_out=hold_out)


def made(capture: Path, out: Path, config: ReconstructConfig) -> Run:
    stages.reconstruct(capture, out, config, QUIET)
    stages.score(out, QUIET)
    return open_run(out)


def scores_of(run: Run) -> dict[str, Any]:
    found = run.scores()
    assert found is not None
    return found


@pytest.fixture(scope="module")
def runs(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    folder = tmp_path_factory.mktemp("runs")
    return {key: made(capture, folder / key, config_of("naive", hold_out)) for key, hold_out in
            {"all": 0, "one": 1, "two": 2}.items()}  # fmt: skip


@pytest.fixture
def other_pictures(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes captures read other pictures and raw frames of some views than there are."""
    read = Capture._read

    def change(held: tuple[int, ...]) -> None:
        def turned(self: Capture, by: Any, kind: str, i: int, suffix: str) -> np.ndarray:
            found = read(self, by, kind, i, suffix)
            return np.ascontiguousarray(found[::-1]) if i in held and kind != "truth" else found

        monkeypatch.setattr(captures, "_OPENED", {})  # what was read from captures that are open stays theirs
        monkeypatch.setattr(Capture, "_read", turned)

    return change


@pytest.mark.parametrize("name", ["naive", "nova-fast", "raw-gs"])
def test_pictures_of_held_out_views_never_reach_a_fit(
    capture: Path, tmp_path: Path, other_pictures: Any, name: str
) -> None:
    held = holding_out(open_capture(capture), 1, seed=0).held
    before = made(capture, tmp_path / "before", config_of(name))
    before_all = made(capture, tmp_path / "before-all", config_of(name, hold_out=0))
    other_pictures(held)
    after = made(capture, tmp_path / "after", config_of(name))
    after_all = made(capture, tmp_path / "after-all", config_of(name, hold_out=0))
    fitted = [(run.path / "point_cloud.ply").read_bytes() for run in (before, after, before_all, after_all)]
    assert fitted[0] == fitted[1]
    assert fitted[2] != fitted[3]
    figures = [scores_of(run)["held_out"]["psnr"] for run in (before, after)]
    assert all(figures[0][at] != figures[1][at] for at in ("10", "20", "30"))


def test_the_stop_is_known_without_truth(runs: dict[str, Run], monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: Any, **__: Any) -> Any:
        raise AssertionError("it looked at the truth")

    run = runs["two"]
    told = scores_of(run)["held_out"]
    monkeypatch.setattr(captures, "_OPENED", {})
    for name in ("truth", "clean", "clean_linear", "source"):
        monkeypatch.setattr(Capture, name, refused)
    found = held_out_scores(run, run.capture())
    assert found is not None
    assert {str(at): value for at, value in found["psnr"].items()} == told["psnr"]
    assert found["stop"] == told["stop"] == int(max(told["psnr"], key=told["psnr"].get))


def test_the_picture_without_noise_wins_against_one_that_fits_its_own_noise(
    runs: dict[str, Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = runs["one"]
    capture, enhancement = run.capture(), run.enhancement
    assert enhancement is not None
    truth = {name: enhanced_truth(capture, capture.names.index(name), enhancement) for name in run.held}
    errors, rng = {10: 0.2, 20: 0.05, None: 0.1}, np.random.default_rng(0)

    def shown(self: Run, name: str) -> np.ndarray:
        return truth[name] + errors[self.at] * rng.standard_normal(truth[name].shape).astype(np.float32)

    monkeypatch.setattr(Run, "rendering", shown)
    found = held_out_scores(run, capture)
    assert found is not None
    assert sorted(found["psnr"], key=found["psnr"].get) == [10, 30, 20]
    assert found["stop"] == 20


def test_a_length_is_judged_by_all_views_that_were_held_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two the second alone tells that the shorter fit is the better one."""
    pictures = np.random.default_rng(0).uniform(0, 1, (3, 12, 16, 3)).astype(np.float32)
    monkeypatch.setattr(lengths, "enhanced_dark", lambda capture, i, enhancement: pictures[i])
    monkeypatch.setattr(lengths, "pictured", lambda run, capture, rendering: rendering)
    errors = {"a": {10: 0.2, None: 0.1}, "c": {10: 0.01, None: 0.1}}

    def run(at: int | None, along: tuple[Any, ...] = ()) -> Any:
        noise = np.random.default_rng(1).standard_normal((12, 16, 3)).astype(np.float32)
        shown = {name: pictures["abc".index(name)] + each[at] * noise for name, each in errors.items()}
        return SimpleNamespace(held=["a", "c"], enhancement="guided", at=at, iterations=30, along=lambda: along,
                               rendering=shown.__getitem__)  # fmt: skip

    capture: Any = SimpleNamespace(names=("a", "b", "c"))
    found = held_out_scores(run(None, (run(10),)), capture)
    assert found is not None
    shown = [run(10).rendering(name) for name in "ac"]
    each = [aligned_psnr(picture, pictures["abc".index(name)]) for name, picture in zip("ac", shown, strict=True)]
    assert found["psnr"][10] == pytest.approx(np.mean(each))  # type: ignore[arg-type]
    assert found["stop"] == 10


def test_nothing_changes_for_a_run_that_holds_nothing_out(runs: dict[str, Run]) -> None:
    run = runs["all"]
    assert "hold_out" not in run.record["stage"]["config"]
    assert "held_out" not in run.record
    assert "held_out" not in scores_of(run)
    assert not [column for column in flat_scores(scores_of(run)) if column.startswith(("stop.", "best."))]
    plain = config_of("naive", 0).resolved()
    assert config_of("naive", 1).resolved() == {**plain, "hold_out": 1}


def test_held_out_views_are_drawn_by_the_seed_for_all_methods_alike(capture: Path, runs: dict[str, Run]) -> None:
    whole = open_capture(capture)
    training, tested = set(whole.cameras.train_indices), set(whole.cameras.test_indices)
    drawn = {seed: holding_out(whole, 2, seed) for seed in range(8)}
    for one in drawn.values():
        assert len(set(one.held)) == 2
        assert set(one.held) <= training
        assert set(one.cameras.train_indices) == training - set(one.held)
        assert set(one.cameras.test_indices) == tested | set(one.held)
    assert len({one.held for one in drawn.values()}) > 1
    assert runs["two"].held == [whole.names[i] for i in drawn[0].held]
    assert set(scores_of(runs["two"])["views"]) == {whole.names[i] for i in tested}


def test_held_out_views_leave_two_to_train_on(capture: Path) -> None:
    whole = open_capture(capture)
    count = len(whole.cameras.train_indices)
    assert len(holding_out(whole, count - 2, 0).cameras.train_indices) == 2
    with pytest.raises(ValueError, match=f"hold_out must leave 2 training views, got {count - 1} of {count}"):
        holding_out(whole, count - 1, 0)
    with pytest.raises(ValueError, match="hold_out must be >= 0 training views, got -1"):
        replace(config_of("naive"), hold_out=-1)


def along(values: dict[int, float], psnr: dict[str, float], stop: int) -> dict[str, Any]:
    """Scores of a run along its fit, the last of them at its end."""
    means = {at: {"lit": {"tone_aligned_psnr": value}, "enhanced": None} for at, value in values.items()}
    *before, end = means
    return {"mean": means[end], "along": [{"iterations": at, "mean": means[at]} for at in before],
            "held_out": {"psnr": psnr, "stop": stop}}  # fmt: skip


def test_three_lengths_are_told_apart() -> None:
    scores = along({10: 20.0, 20: 23.0, 40: 22.5, 80: 19.0}, {"10": 15.0, "20": 15.3, "40": 15.4, "80": 15.1}, 40)
    found = lengths_of(scores, "lit", "tone_aligned_psnr")
    assert found == Stops(end=19.0, stop=40, stopped=22.5, best=20, highest=23.0)
    assert lengths_of(scores, "enhanced", "aligned_psnr") is None
    assert length_columns(scores) == {
        "stop.iterations": 40, "stop.lit.tone_aligned_psnr": 22.5,
        "best.lit.iterations": 20, "best.lit.tone_aligned_psnr": 23.0,
    }  # fmt: skip


def test_a_fit_stops_at_its_end_if_it_gets_better_to_there_and_at_its_first_length_if_it_gets_worse() -> None:
    scores = along({10: 20.0, 20: 23.0}, {"10": 15.0, "20": 15.3}, 20)
    assert lengths_of(scores, "lit", "tone_aligned_psnr") == Stops(23.0, 20, 23.0, 20, 23.0)
    scores = along({10: 23.0, 20: 21.0, 30: 20.0}, {"10": 15.3, "20": 15.1, "30": 15.0}, 10)
    assert lengths_of(scores, "lit", "tone_aligned_psnr") == Stops(20.0, 10, 23.0, 10, 23.0)


def test_reports_and_tables_print_three_figures(runs: dict[str, Run]) -> None:
    folder = runs["one"].path.parent
    found = length(material_of(places_in([folder / key for key in runs], QUIET), folder / "report.html"), None)  # type: ignore[arg-type]
    assert found is not None
    for each, (kind, score) in zip(found["kinds"], [("enhanced", "aligned_psnr"), ("lit", "tone_aligned_psnr")],
                                   strict=True):  # fmt: skip
        rows = {row.cells[0]: [str(getattr(cell, "text", cell)) for cell in row.cells] for row in each["three"].rows}
        assert [*rows] == ["one/naive", "two/naive"]
        three = lengths_of(scores_of(runs["one"]), kind, score)
        assert three is not None
        told = [f"{value:.2f}" for value in (three.end, three.stopped, three.highest)]
        assert rows["one/naive"] == ["one/naive", "1", *told, str(three.stop), f"{three.highest - three.stopped:.2f}"]
        assert flat_scores(scores_of(runs["one"]))[f"stop.{kind}.{score}"] == three.stopped
    page = write_report(folder / "one", QUIET).read_text(encoding="utf-8")
    assert "At its own stop" in page
    assert "At its own stop" not in write_report(folder / "all", QUIET).read_text(encoding="utf-8")


def test_studies_and_swaps_keep_what_is_held_out(runs: dict[str, Run]) -> None:
    preset = adapted(EXPERIMENTS["demo"], hold_out=2, methods=("naive", "nerf"))
    assert [preset.reconstruct(name).hold_out for name in preset.methods] == [2, 2]
    run = runs["one"]
    capture, source = run.inputs(QUIET)
    assert Case(run, capture, source, scores_of(run)).config.hold_out == 1
