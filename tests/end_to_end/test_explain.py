"""Claims about `novags explain`, on tiny pictures: the cause that was put in is the first that is named."""

import json
import shlex
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from novags.cameras import parse_cameras
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.run import open_run
from novags.testbed.folders.runs import runs_in
from novags.testbed.report.page import write_report
from novags.testbed.stages.command import run_command
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.command import read_commands
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.stages.explaining.ladder import Ladder, cases_of, explain, explained, forecast
from novags.testbed.stages.explaining.swaps import SWAPS, NotSwapped
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from simscenes.sets.pictures.png import read_png

CAUSES = {  # views, electrons, cameras
    "cameras": (16, 400, "known:rotation_deg=1.5"),
    "noise": (16, 2, "known"),
    "views": (4, 400, "known"),
}


def ladder_of(run: Path, quiet: Console) -> Ladder:
    return explain(cases_of([run], quiet), list(SWAPS), quiet)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("cause", CAUSES)
def test_the_cause_that_was_put_in_is_named_first(cause: str, seed: int, tmp_path: Path, quiet: Console) -> None:
    views, electrons, cameras = CAUSES[cause]
    scene = RenderConfig(
        scene="tabletop:11", n_views=views, width=48, height=48, spp=64, truth_samples=4, seed=seed
    )  # fmt: skip
    stages.render(tmp_path / "set", scene, quiet)
    stages.capture(tmp_path / "set", tmp_path / "capture", CaptureConfig(electrons=electrons, seed=seed), quiet)
    preset = adapted(
        EXPERIMENTS["demo"], methods=("naive",), iterations=800, points=1500, device="cpu",
        cameras=parse_cameras(cameras),
    )  # fmt: skip
    stages.reconstruct(tmp_path / "capture", tmp_path / "run", replace(preset.reconstruct("naive"), seed=seed), quiet)
    found = ladder_of(tmp_path / "run", quiet)
    assert next(iter(found.won)) == cause, found.lines()
    assert cause in found.first
    assert found.won.keys() | found.not_swapped.keys() == SWAPS.keys()


def test_a_ladder_is_made_once_and_changes_nothing_but_its_own_folder(
    experiment: Path, tmp_path: Path, quiet: Console
) -> None:
    place = shutil.copytree(experiment, tmp_path / "place")
    run = place / "naive"
    digest, listed = open_run(run).digest(), list(runs_in([place]))
    before = forecast(cases_of([run], quiet), list(SWAPS))
    assert {folder.name for folder in before} == {"noise", "geometry", "length", "views"}
    first = ladder_of(run, quiet)
    made = {folder: (folder / "run.json").read_bytes() for folder in before}
    assert forecast(cases_of([run], quiet), list(SWAPS)) == {}
    assert ladder_of(run, quiet) == first
    assert made == {folder: (folder / "run.json").read_bytes() for folder in before}
    assert all(
        json.loads((folder / "run.json").read_text())["sees_truth"] for folder in made if folder.name != "length"
    )
    assert open_run(run).digest() == digest
    assert list(runs_in([place])) == list(runs_in([tmp_path])) == listed
    record = explained(run)
    assert record is not None
    assert [step["swap"] for step in record["steps"]] == list(first.won)
    page = write_report(place, quiet).read_text(encoding="utf-8")
    assert first.first in page
    assert explained(place / "oracle") is None
    # Of more views: the held-out ones are those of the run, and the exposure of all is that of the first capture.
    own, more = (json.loads((folder / "capture.json").read_text())
                 for folder in (place / "capture", run / "explain" / "more" / "capture"))  # fmt: skip
    scores = open_run(run / "explain" / "views").scores()
    assert scores is not None
    assert scores["views"].keys() == (open_run(run).scores() or {})["views"].keys()
    assert more["electrons"] / more["mean_green_radiance"] == pytest.approx(
        own["electrons"] / own["mean_green_radiance"]
    )


def test_one_ladder_of_several_seeds_pairs_each_run_with_its_own(
    experiment: Path, tmp_path: Path, quiet: Console
) -> None:
    place = shutil.copytree(experiment, tmp_path / "place")
    preset = adapted(EXPERIMENTS["demo"], methods=("naive",), iterations=20, points=200, device="cpu")
    runs = []
    for seed in (0, 1):
        runs.append(place / f"seed{seed}")
        stages.reconstruct(place / "capture", runs[-1], replace(preset.reconstruct("naive"), seed=seed), quiet)
    alone = [explain(cases_of([run], quiet), ["noise"], quiet) for run in runs]
    whole = explain(cases_of(runs, quiet), ["noise"], quiet)
    assert whole.won["noise"].value == pytest.approx(np.mean([each.won["noise"].value for each in alone]))
    assert whole.won["noise"].seeds == 2
    assert [explained(run) for run in runs] == [each.record() for each in alone]
    with pytest.raises(ValueError, match="must differ in their seeds"):
        cases_of([runs[0], shutil.copytree(runs[0], tmp_path / "place" / "again")], quiet)


BLUR = """
import pathlib, sys
import cv2
capture, out = map(pathlib.Path, sys.argv[1:3])
for name in (capture / "test_list.txt").read_text().split():
    dark = cv2.imread(str(capture / "images" / pathlib.Path(name).name))
    cv2.imwrite(str(out / (pathlib.Path(name).stem + ".png")), cv2.convertScaleAbs(cv2.blur(dark, (2, 2)), alpha=3))
print(sorted(path.name for path in capture.iterdir()), file=open("seen.txt", "w"))
"""


def test_the_noise_of_a_program_is_replaced_from_outside(experiment: Path, tmp_path: Path, quiet: Console) -> None:
    """It brightens what it is shown: without noise it comes closer, and everything else is its own."""
    capture, run = experiment / "capture", tmp_path / "run"
    (tmp_path / "mine.py").write_text(BLUR)
    table = {"mine": {"command": f"{shlex.quote(sys.executable)} mine.py {{capture}} {{out}}"}}
    commands = read_commands(table, tmp_path)
    run_command(capture, run, commands[0], quiet)
    (case,) = cases_of([run], quiet)
    found = explain([case], list(SWAPS), quiet)
    assert "name its study file" in found.not_swapped["noise"]
    (known,) = cases_of([run], quiet, commands)
    assert [folder.name for folder in forecast([known], list(SWAPS))] == ["noise"]
    found = explain([known], list(SWAPS), quiet)
    assert found.won.keys() == {"noise", "tone"}
    assert found.won["noise"].value > 0.5
    assert all("has the true cameras" in found.not_swapped[name] for name in ("cameras", "geometry", "length", "views"))
    assert "raw" not in (tmp_path / "seen.txt").read_text()
    record = open_run(run / "explain" / "noise").record
    assert record["sees_truth"] is True
    view = open_capture(capture).cameras.names[0]
    shown = cv2.convertScaleAbs(cv2.blur(_codes(open_capture(capture).clean(0, demosaiced=True)), (2, 2)), alpha=3)
    assert np.array_equal(_codes(read_png(run / "explain" / "noise" / "renders" / f"{view}.png")), shown)
    (tmp_path / "mine.py").write_text(BLUR + "# another one")
    (other,) = cases_of([run], quiet, read_commands(table, tmp_path))
    with pytest.raises(NotSwapped, match="it has changed since"):
        _ = other.program


def _codes(picture: np.ndarray) -> np.ndarray:
    return np.round(picture * 255).clip(0, 255).astype(np.uint8)
