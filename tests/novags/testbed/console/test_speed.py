"""Claims about the rate at which a run's Gaussians are drawn: of which views, of what, and that no result has it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from novags.methods.gaussian_scene import GaussianScene
from novags.methods.variant import Variant
from novags.splats.views import Views
from novags.testbed import stages
from novags.testbed.console import speed
from novags.testbed.console.terminal import Console
from novags.testbed.folders.run import open_run
from novags.testbed.ledger.contents import read_json, record_digest, write_json
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.study.results import flat_scores
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png

QUIET = Console(quiet=True)
WIDTH, HEIGHT = 32, 24


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scored fit of a few Gaussians to a few photographs."""
    folder, rng = tmp_path_factory.mktemp("fast"), np.random.default_rng(0)
    names = [f"{i:04d}" for i in range(9)]
    write_cameras(folder / "set", names, orbit_rig(len(names), WIDTH, HEIGHT, 50.0, radius=3.0))
    for name in names:
        write_png(folder / "set" / "images" / f"{name}.png", rng.integers(20, 250, (HEIGHT, WIDTH, 3)).astype(np.uint8))
    stages.capture(folder / "set", folder / "capture", CaptureConfig(electrons=200.0), QUIET)
    variant = Variant(name="short", method="naive", settings={"fit.iterations": 3})
    stages.reconstruct(folder / "capture", folder / "run", ReconstructConfig(variant=variant, points=80), QUIET)
    stages.score(folder / "run", QUIET)
    return folder / "run"


def measured(run: Path) -> dict[str, Any]:
    (method,) = read_json(run / "metrics.json")["methods"].values()
    return dict(method)


def test_scores_hold_the_rates_with_what_drew(run: Path) -> None:
    found = measured(run)["frames_per_second"]
    assert found.keys() == {"160", "800", "device", "threads"}
    assert min(found["160"], found["800"]) > 0
    assert (found["device"], found["threads"]) == ("cpu", speed.torch.get_num_threads())
    assert flat_scores(measured(run))["frames_per_second.800"] == found["800"]


def test_views_are_as_wide_as_said_and_of_the_shape_of_the_capture(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn, render = list[Views](), GaussianScene.render

    def watched(self: GaussianScene, views: Views) -> Any:
        drawn.append(views)
        return render(self, views)

    monkeypatch.setattr(GaussianScene, "render", watched)
    speed.frames_per_second(run / "point_cloud.ply", run / "cameras.json", {})
    assert {(views.width, views.height) for views in drawn} == {(160, 120), (800, 600)}
    camera = read_record_of(run)[0]
    for views in drawn:  # all see as much
        scale = views.width / camera["width"]
        assert views.Ks[0].diagonal().tolist() == pytest.approx([scale * camera["fx"], scale * camera["fy"], 1])
    times = [sum(views.width == width for views in drawn) for width in speed.WIDTHS]
    assert all(2 <= count <= 1 + speed.FRAMES for count in times)  # one that warms up, and one that is timed, at least


def test_what_is_drawn_is_what_a_training_view_shows(run: Path) -> None:
    listed = read_record_of(run)
    name = listed[len(listed) // 2]["img_name"]
    view = speed._view(listed[len(listed) // 2], WIDTH)
    scene = speed.saved_gaussians(run / "point_cloud.ply", read_json(run / "run.json"))
    image, _, _ = scene.render(view)
    shown = open_run(run).rendering(name)
    assert np.abs(image[0].numpy() - shown).max() < 1e-4 * np.abs(shown).max()


def read_record_of(run: Path) -> list[dict[str, Any]]:
    return list(speed.read_record(run / "cameras.json", speed.CAMERAS))


def test_how_fast_this_machine_was_is_part_of_no_digest(run: Path, tmp_path: Path) -> None:
    record = read_json(run / "metrics.json")
    method = measured(run)
    name = next(iter(record["methods"]))
    other = {**record, "methods": {name: {**method, "frames_per_second": {**method["frames_per_second"], "160": 0.5}}}}
    assert record_digest(other) == record_digest(record)
    worse = {**record, "methods": {name: {**method, "mean": {}}}}
    assert record_digest(worse) != record_digest(record)


@pytest.mark.parametrize("missing", ["point_cloud.ply", "cameras.json"])
def test_what_has_no_gaussians_or_no_cameras_has_no_rate(run: Path, tmp_path: Path, missing: str) -> None:
    places = {name: run / name for name in ("point_cloud.ply", "cameras.json")} | {missing: tmp_path / missing}
    assert speed.frames_per_second(places["point_cloud.ply"], places["cameras.json"], {}) is None


def test_no_camera_at_all_has_no_rate(run: Path, tmp_path: Path) -> None:
    write_json(tmp_path / "cameras.json", [])
    assert speed.frames_per_second(run / "point_cloud.ply", tmp_path / "cameras.json", {}) is None
