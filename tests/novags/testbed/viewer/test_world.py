"""Claims about the viewer's frame: Gaussians, cameras and pictures stay what they are, whatever frame a run has."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.cameras.align import Similarity
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.tone import ResponseTable
from novags.methods.variant.several import FITS, MeanScene, places
from novags.splats import Gaussians, read_ply, write_ply
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.viewer import splats, world
from novags.testbed.viewer.session import quaternion, viewmat_of
from novags.testbed.viewer.shown import Shown, shown_of
from novags.testbed.viewer.splats import drawn, rendered
from novags.testbed.viewer.world import SIZE, World
from simscenes import orbit_rig

QUIET = Console(quiet=True)
Runs = dict[str, Path]
FOV = 2 * np.arctan(48 / 2 / (64 / 2 / np.tan(np.radians(25))))  # vertical, of 50 degrees across 64 px


def turned(degrees: float, axis: tuple[float, float, float]) -> np.ndarray:
    """Rodrigues' formula."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    K, a = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.radians(degrees)
    return np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * K @ K


@pytest.fixture(scope="module")
def moved(runs: Runs, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first run as a camera source with its own frame would have left it: turned, moved, five times as large."""
    folder = tmp_path_factory.mktemp("moved")
    for part in ("photos", "capture", "first"):
        shutil.copytree(runs["capture"].parent / part, folder / part)
    run, turn, shift = folder / "first", turned(70, (1, 2, -1)), np.array([3.0, -8.0, 1.0])
    listed = json.loads((run / "cameras.json").read_text())
    for camera in listed:
        camera["position"] = (5 * turn @ camera["position"] + shift).tolist()
        camera["rotation"] = (turn @ camera["rotation"]).tolist()
    (run / "cameras.json").write_text(json.dumps(listed))
    g = read_ply(run / "point_cloud.ply")
    w, x, y, z = g.quats.unbind(-1)
    p, q, r, s = (float(v) for v in quaternion(turn))
    quats = torch.stack(
        [p * w - q * x - r * y - s * z, p * x + q * w + r * z - s * y, p * y - q * z + r * w + s * x,
         p * z + q * y - r * x + s * w], -1,
    )  # fmt: skip
    means = (5 * g.means.double().numpy() @ turn.T + shift).astype(np.float32)
    # The constant part of the colours alone: a turned frame would turn the rest, too.
    larger = g.log_scales + np.log(5)
    write_ply(run / "point_cloud.ply",
              Gaussians(torch.from_numpy(means), quats, larger, g.logit_opacities, g.sh[:, :1]))  # fmt: skip
    return run


def plain(run: Path, folder: Path) -> Path:
    """A run whose Gaussians have one colour from all sides."""
    for part in ("photos", "capture", "first"):
        shutil.copytree(run.parent / part, folder / part)
    g = read_ply(run / "point_cloud.ply")
    write_ply(folder / "first" / "point_cloud.ply",
              Gaussians(g.means, g.quats, g.log_scales, g.logit_opacities, g.sh[:, :1]))  # fmt: skip
    return folder / "first"


def seen(shown: Shown, i: int) -> np.ndarray:
    found = shown.scene("naive")
    assert found is not None
    return rendered(found[0], found[1], shown.world.viewmats[i], FOV, (64, 48))


def test_the_view_at_a_camera_is_the_rendering_of_the_run(runs: Runs) -> None:
    (shown,) = shown_of([runs["first"]], QUIET)
    for i in (0, 5):
        assert np.allclose(seen(shown, i), shown.runs["naive"].rendering(f"{i:04d}"), atol=2e-3)


def test_a_run_in_a_frame_of_its_own_is_drawn_and_seen_where_the_true_one_is(
    runs: Runs, moved: Path, tmp_path: Path
) -> None:
    (true,), (other,) = shown_of([plain(runs["first"], tmp_path)], QUIET), shown_of([moved], QUIET)
    for i in (0, 4, 8):
        assert np.allclose(seen(true, i), seen(other, i), atol=2e-3)
    drawn_true, drawn_other = (shown.scene("naive")[2] for shown in (true, other))  # type: ignore[index]
    assert np.allclose(drawn_true.centers, drawn_other.centers, atol=1e-4)
    size = np.abs(drawn_true.covariances).max((1, 2), keepdims=True)
    assert (np.abs(drawn_true.covariances - drawn_other.covariances) < 1e-3 * size).all()


def test_what_the_browser_draws_are_the_gaussians_moved_axis_by_axis() -> None:
    rng = torch.Generator().manual_seed(2)
    means, quats, scales = (torch.randn(5, count, generator=rng) for count in (3, 4, 3))
    g = Gaussians(means, 4 * quats, scales, torch.randn(5, generator=rng), torch.rand(5, 4, 3, generator=rng))
    turn = turned(33, (0, 1, 3))
    into = Similarity(0.2, torch.from_numpy(turn), torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64))
    found = drawn(GaussianScene(g), into)
    for k in range(5):
        w, x, y, z = (g.quats[k] / g.quats[k].norm()).double().numpy()
        vector, cross = np.array([x, y, z]), np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        rotation = (w * w - vector @ vector) * np.eye(3) + 2 * np.outer(vector, vector) + 2 * w * cross
        covariance = np.zeros((3, 3))
        for axis in range(3):
            arm = 0.2 * turn @ rotation[:, axis] * float(g.log_scales[k, axis].exp())
            covariance += np.outer(arm, arm)
        assert np.allclose(found.covariances[k], covariance, rtol=1e-5, atol=1e-6)
        assert np.allclose(found.centers[k], 0.2 * turn @ g.means[k].double().numpy() + [1, 2, 3], atol=1e-5)
    assert np.allclose(found.colors, np.clip(0.28209479 * g.sh[:, 0].numpy() + 0.5, 0, 1), atol=1e-6)
    assert np.allclose(found.opacities[:, 0], 1 / (1 + np.exp(-g.logit_opacities.numpy())), atol=1e-6)


def test_the_browser_draws_what_the_colours_stand_for() -> None:
    """Light of another unit, and radiance under a camera's response."""
    rng = torch.Generator().manual_seed(5)
    means, scales = (torch.randn(6, 3, generator=rng) for _ in range(2))
    g = Gaussians(means, torch.ones(6, 4), scales, torch.zeros(6), torch.rand(6, 1, 3, generator=rng))
    base, here = 0.28209479 * g.sh[:, 0].numpy() + 0.5, Similarity(1.0, torch.eye(3).double(), torch.zeros(3).double())
    light = 2.0 * 0.1 * base
    code = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    found = drawn(GaussianScene(g, matrix=0.1 * torch.eye(3)), here, gain=2.0).colors
    assert np.allclose(found, code, atol=1e-5)
    table = ResponseTable(faint=1e-3, low=-7.0, high=0.0, values=(0.0, 0.7))
    found = drawn(GaussianScene(g, response=table), here).colors
    assert np.allclose(found, 0.1 * (np.log(base + 1e-3) + 7), atol=1e-5)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e4])
def test_a_scene_of_any_size_fits_into_the_frame(runs: Runs, size: float, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = open_capture(runs["capture"])
    rig = orbit_rig(9, 64, 48, 50.0, radius=size)
    monkeypatch.setattr("novags.testbed.viewer.world.true_cameras", lambda _: torch.from_numpy(np.array(rig.viewmats)))
    world = World.of(capture, upright=False)
    centers = -np.einsum("cji,cj->ci", world.viewmats[:, :3, :3], world.viewmats[:, :3, 3])
    reach = np.linalg.norm(centers - centers.mean(0), axis=1).max()
    assert reach == pytest.approx(SIZE / 1.1, rel=1e-4)
    assert np.allclose(world.viewmats[:, :3, :3], np.array(rig.viewmats)[:, :3, :3])
    assert world.up[2] > 0.99  # a ring around an upright axis


@pytest.mark.parametrize(("axis", "sign"), [(2, 1), (1, 1), (0, -1)])
def test_a_rendered_scene_stands_upright_whichever_axis_of_its_file_is_up(
    runs: Runs, axis: int, sign: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = orbit_rig(3, 64, 48, 50.0, radius=2.0, sweep_deg=60.0, elevation_deg=35.0)
    world = np.eye(4)
    world[:3, :3] = np.roll(np.eye(3), axis - 2, axis=0) if sign > 0 else turned(-90, (0, 1, 0))
    moved = np.array(rig.viewmats) @ np.linalg.inv(world)
    monkeypatch.setattr("novags.testbed.viewer.world.true_cameras", lambda _: torch.from_numpy(moved))
    expected = world[:3, :3] @ [0, 0, 1]
    assert np.allclose(World.of(open_capture(runs["capture"]), upright=True).up, expected)
    tilted = np.array(World.of(open_capture(runs["capture"]), upright=False).up)
    assert 0.7 < tilted @ expected < 0.999
    assert np.linalg.norm(tilted) == pytest.approx(1)


def test_the_nearest_view_is_the_one_whose_camera_it_is(runs: Runs) -> None:
    (shown,) = shown_of([runs["first"]], QUIET)
    for i in (0, 3, 8):
        near = shown.world.viewmats[i].copy()
        near[:3, 3] += 0.05
        assert shown.world.nearest(near) == i
        center = -near[:3, :3].T @ near[:3, 3]
        assert np.allclose(viewmat_of(quaternion(near[:3, :3].T), center), near)


def test_cameras_that_are_not_those_of_the_capture_are_one_line(runs: Runs, tmp_path: Path) -> None:
    run = plain(runs["first"], tmp_path)
    text = (run / "cameras.json").read_text()
    (run / "cameras.json").write_text(text.replace('"0003"', '"0033"'))
    (shown,) = shown_of([run], QUIET)
    with pytest.raises(ValueError, match=r"cameras.json names 0033, which is not a view of .*: reconstruct again"):
        shown.scene("naive")
    (run / "cameras.json").write_text(text.replace("[", "", 1))
    with pytest.raises(ValueError, match=r"cameras.json is not valid JSON .*; reconstruct again"):
        shown.scene("naive")


def test_cameras_beyond_what_float64_tells_apart_are_one_line(runs: Runs, tmp_path: Path) -> None:
    run = plain(runs["first"], tmp_path)
    listed = json.loads((run / "cameras.json").read_text())
    listed[0]["position"][1] = 1e300
    (run / "cameras.json").write_text(json.dumps(listed))
    (shown,) = shown_of([run], QUIET)
    with pytest.raises(ValueError, match=r"cameras.json must hold positions and rotations up to 1e\+12, got 1e\+300"):
        shown.scene("naive")


def test_the_cameras_of_a_run_are_compared_with_the_true_ones_of_the_same_views(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A run may hold some of the views, in an order of its own."""
    true, asked = torch.arange(4.0), list[list[float]]()

    def align(found: Any, known: torch.Tensor) -> Any:
        asked.append(known.tolist())
        return SimpleNamespace(similarity="s")

    capture: Any = SimpleNamespace(names=("a", "b", "c", "d"), path=Path("c"))
    run: Any = SimpleNamespace(path=Path("r"))
    monkeypatch.setattr(world, "true_cameras", lambda capture: true)
    monkeypatch.setattr(world, "align", align)
    monkeypatch.setattr(world, "own_cameras", lambda run: (["d", "b", "c"], "found"))
    assert world.true_from(run, capture) == "s"
    assert asked == [[3.0, 1.0, 2.0]]
    for names in (["x", "a"], ["a", "x"]):
        monkeypatch.setattr(world, "own_cameras", lambda run, names=names: (names, "found"))
        with pytest.raises(ValueError, match="names x, which is not a view"):
            world.true_from(run, capture)


def test_a_run_of_several_fits_is_the_mean_of_all_unless_one_is_of_another_kind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    @dataclass(frozen=True)
    class OfRun:
        path: Path
        record: dict[str, Any]

    scenes = {place: f"the field in {place.name}" for place in places(Path("run"), 3)}
    monkeypatch.setattr(splats, "gaussians_of", lambda run: None)
    monkeypatch.setattr(splats, "load_field", scenes.get)
    run: Any = OfRun(Path("run"), {FITS: [{}, {}, {}]})
    found = splats.scene_of(run)
    assert isinstance(found, MeanScene)
    assert list(found.scenes) == ["the field in fit-1", "the field in fit-2", "the field in fit-3"]
    for place in [*scenes]:
        scene = scenes.pop(place)
        assert splats.scene_of(run) is None, place
        scenes[place] = scene
