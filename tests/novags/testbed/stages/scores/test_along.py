"""Held-out views along a fit: the fit, its scores at the end and its files are the same with and without."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from novags.methods import METHODS, chosen
from novags.settings import changed
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.run import ALONG, Run, open_run
from novags.testbed.report.blocks.length import curve_of, length, mean_curve
from novags.testbed.report.material import material_of
from novags.testbed.report.page import write_report
from novags.testbed.report.place import places_in
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted

QUIET = Console(quiet=True)
LENGTHS = (10, 20)


def made(capture: Path, name: str, out: Path, keep_at: tuple[int, ...], **settings: Any) -> tuple[Run, str]:
    """A short run, and what was said."""
    variant = chosen(name)
    settings = {"fit.iterations": 30, "fit.keep_at": keep_at, "enhance.window": 9, **settings}
    config = changed(variant.config(METHODS[variant.method].config(), {}), settings, what=name)
    stream = io.StringIO()
    wanted = ReconstructConfig(variant=variant, config=config, points=120)
    stages.reconstruct(capture, out, wanted, Console(stream=stream))
    stages.score(out, QUIET)
    return open_run(out), stream.getvalue()


@pytest.fixture(scope="module")
def runs(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    """The same run with and without, and one in linear light."""
    folder = tmp_path_factory.mktemp("runs")
    of = {"with": ("naive", LENGTHS), "without": ("naive", ()), "light": ("raw-gs", LENGTHS)}
    return {key: made(capture, name, folder / key, at)[0] for key, (name, at) in of.items()}


def test_the_fit_and_its_scores_are_the_same_with_and_without(runs: dict[str, Run]) -> None:
    one, other = (run.scores() for run in (runs["with"], runs["without"]))
    assert one is not None
    assert other is not None
    assert one["mean"] == other["mean"]
    assert (runs["with"].path / "point_cloud.ply").read_bytes() == (
        runs["without"].path / "point_cloud.ply"
    ).read_bytes()
    assert other["along"] == []
    assert not (runs["without"].path / ALONG).exists()


@pytest.mark.parametrize("key", ["with", "light"])
def test_a_run_is_shown_and_scored_after_each_length(runs: dict[str, Run], key: str) -> None:
    run = runs[key]
    scores = run.scores()
    assert scores is not None
    assert [then.at for then in run.along()] == [each["iterations"] for each in scores["along"]] == list(LENGTHS)
    held_out = [*scores["views"]]
    pictures = [run, *run.along()]
    for name in held_out:
        shown = [then.rendering(name) for then in pictures]
        assert all(not np.array_equal(shown[0], other) for other in shown[1:])
        assert not np.array_equal(shown[1], shown[2])
    for each in scores["along"]:
        assert each["views"].keys() == scores["views"].keys()
        assert each["mean"].keys() == scores["mean"].keys()
    kind, score = ("lit", "tone_aligned_psnr")
    values = [each["mean"][kind][score] for each in scores["along"]]
    assert len({*values, scores["mean"][kind][score]}) == 3


def test_what_cannot_be_shown_is_said(capture: Path, tmp_path: Path) -> None:
    run, said = made(capture, "naive", tmp_path / "long", (20, 40))
    assert run.record[ALONG] == [20]
    assert "reconstruct naive: not shown after 40 iterations" in said
    run, said = made(capture, "nova-plus", tmp_path / "plus", (10, 20), seeds=1)
    assert ALONG not in run.record
    assert "reconstruct nova-plus: not shown after 10, 20 iterations" in said


def test_a_report_draws_a_line_for_each_run_that_was_shown(runs: dict[str, Run]) -> None:
    folder = runs["with"].path.parent
    page = write_report(folder / "with", QUIET)
    assert 'id="length"' in page.read_text(encoding="utf-8")
    assert 'id="length"' not in write_report(folder / "without", QUIET).read_text(encoding="utf-8")
    found = length(material_of(places_in([folder / key for key in runs], QUIET), folder / "report.html"), None)  # type: ignore[arg-type]
    assert found is not None
    tables = {each["kind"]: each["table"] for each in found["kinds"]}
    assert [row.cells[0] for row in tables["enhanced"].rows] == ["with/naive", "raw-gs"]
    assert [name for name, _ in found["key"]] == ["with/naive", "raw-gs"]


def test_a_mean_curve_is_over_the_lengths_that_all_runs_have(runs: dict[str, Run]) -> None:
    one, other = (curve_of(runs[key], "lit", "tone_aligned_psnr") for key in ("with", "light"))
    assert [*one] == [*other] == [*LENGTHS, 30]
    mean = mean_curve([runs["with"], runs["without"], runs["light"]], "lit", "tone_aligned_psnr")
    assert mean == pytest.approx({at: (one[at] + other[at]) / 2 for at in one})
    assert curve_of(runs["without"], "lit", "tone_aligned_psnr") == {}


def test_commands_and_studies_ask_for_lengths_of_every_fit() -> None:
    preset = adapted(EXPERIMENTS["demo"], score_at=(400, 800), methods=("naive", "nerf"))
    assert preset.reconstruct("naive").config.fit.keep_at == (400, 800)
    assert not hasattr(preset.reconstruct("nerf").config.fit, "keep_at")
