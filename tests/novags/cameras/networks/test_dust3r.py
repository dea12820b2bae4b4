"""The adapters to DUSt3R and MASt3R against stand-ins that know the scene they are shown, in a frame of their own."""

import argparse
import importlib.util
import json
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import save_file

from novags.cameras.align import align
from novags.cameras.networks.dust3r import as_its_loader, dust3r_cameras
from novags.cameras.networks.mast3r import mast3r_cameras
from novags.cameras.sources.dust3r import Dust3rConfig
from novags.cameras.sources.mast3r import Mast3rConfig

PACKAGES = {
    "dust3r": (Dust3rConfig, dust3r_cameras, "AsymmetricCroCo3DStereo"),
    "mast3r": (Mast3rConfig, mast3r_cameras, "AsymmetricMASt3R"),
}
# Width and height; what the loader scales it to; what it keeps of that, from which column and row.
SHAPES = {
    (40, 30): ((512, 384), (512, 384), (0, 0)),
    (30, 40): ((384, 512), (384, 512), (0, 0)),
    (96, 96): ((512, 512), (512, 384), (0, 64)),  # a square becomes 4:3
    (64, 45): ((512, 360), (512, 352), (0, 4)),  # whole patches of 16
    (45, 64): ((360, 512), (352, 512), (4, 0)),
    (640, 480): ((512, 384), (512, 384), (0, 0)),  # larger than the network's
}


def as_dark(pictures: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(pictures.astype(np.float32) / 2550)


@pytest.fixture(params=PACKAGES)
def shown(request, stage, weights, corner, truth):
    """A corner of a room as one of the two networks would see it, the adapter, and what it needs."""
    config, adapter, model = PACKAGES[request.param]
    stand_in = stage(request.param)

    def make(width: int = 40, height: int = 30, count: int = 3):
        scene = corner(count, width, height)
        scaled, (wide, tall), (left, top) = SHAPES[width, height]
        Ks = scene.rig.Ks.copy()
        Ks[:, 0] *= scaled[0] / width
        Ks[:, 1] *= scaled[1] / height
        Ks[:, :2, 2] -= [left, top]
        depths = np.stack([scene.depth(v, K, wide, tall) for v, K in zip(scene.rig.viewmats, Ks, strict=True)])
        confidence = 1 + np.random.default_rng(0).random(depths.shape)
        stand_in.truth = truth(wide, tall, scene.rig.viewmats, Ks, depths, confidence)
        return scene, stand_in.truth, adapter, config(checkpoint=weights(model))

    return make


@pytest.mark.parametrize(("width", "height"), SHAPES)
def test_aligned_cameras_are_the_true_ones_and_points_lie_on_the_true_surface(shown, width, height):
    scene, _, adapter, config = shown(width, height)
    found = adapter(scene.pictures, as_dark(scene.pictures), n_points=3000, config=config)
    assert found.registered == (0, 1, 2)
    aligned = align(found.viewmats, torch.tensor(scene.rig.viewmats))
    # Everything is float64 but the points, whose float32 resolves 1e-7 of the scene.
    assert aligned.rotation_deg.max() < 1e-5
    assert aligned.centre_error.max() < 1e-6
    np.testing.assert_allclose(found.Ks.numpy(), scene.rig.Ks, rtol=1e-9, atol=1e-9)
    assert len(found.points) == 3000
    assert scene.distance(aligned.similarity.apply(found.points.double()).numpy()).max() < 1e-5


@pytest.mark.parametrize(("width", "height"), [(40, 30), (96, 96), (45, 64)])
def test_points_take_the_colour_of_the_place_they_are_seen_at(shown, width, height):
    """Dark images whose red and green are the position in the picture; at least two views, so the third is black."""
    scene, truth, adapter, config = shown(width, height)
    truth.confidence[1:] = 0  # all points from the first view
    y, x = np.mgrid[0:height, 0:width] + 0.5
    dark = torch.zeros(3, height, width, 3, dtype=torch.float64)
    dark[0] = torch.from_numpy(np.stack([x / width, y / height, 0 * x], -1))
    config = type(config)(checkpoint=config.checkpoint, drop_percent=70.0)
    found = adapter(scene.pictures, dark, n_points=20_000, config=config)
    camera = found.points.double().numpy() @ found.viewmats[0, :3, :3].numpy().T + found.viewmats[0, :3, 3].numpy()
    pixels = (camera @ scene.rig.Ks[0].T)[:, :2] / camera[:, 2:]
    off = found.colors[:, :2].numpy() * [width, height] - pixels
    # A colour is that of a whole pixel, so half a pixel off at most, and a mean over neighbours less than a pixel away.
    assert np.abs(off).max() < 1.5
    # Positions within pixels are uniform up to the network's raster; 20,000 of them.
    assert np.abs(off.mean(0)).max() < 0.03


def test_the_least_confident_points_are_left_out(shown):
    scene, truth, adapter, config = shown()
    wrong = np.zeros(truth.depths.shape, bool)
    wrong[:, :, :128] = True  # a quarter, of which no depth is right
    truth.depths[wrong] *= 3
    truth.confidence = np.where(wrong, 1.0, truth.confidence + 1)
    dark = as_dark(scene.pictures)

    def share_off(config) -> float:
        found = adapter(scene.pictures, dark, n_points=3000, config=config)
        similarity = align(found.viewmats, torch.tensor(scene.rig.viewmats)).similarity
        return float((scene.distance(similarity.apply(found.points.double()).numpy()) > 1e-3).mean())

    assert share_off(config) == 0
    # Without a cut it is a quarter: 5 standard deviations of a share among 3000, and what is right three times as far.
    everything = type(config)(checkpoint=config.checkpoint, drop_percent=0.0)
    assert share_off(everything) == pytest.approx(0.25, abs=5 * (0.25 * 0.75 / 3000) ** 0.5 + 0.01)


def test_settings_and_the_seed_reach_the_alignment(shown):
    scene, truth, adapter, config = shown()
    chosen = type(config)(checkpoint=config.checkpoint, pairs="swin-2", iterations=7)
    adapter(scene.pictures, as_dark(scene.pictures), n_points=10, config=chosen, seed=5)
    assert truth.asked.pop("scene_graph") == "swin-2"
    assert truth.asked.pop("seed") == 5
    wanted = {
        Dust3rConfig: {"niter": 7, "schedule": "cosine", "lr": 0.01},
        Mast3rConfig: {"niter1": 7, "niter2": 7, "lr1": 0.07, "lr2": 0.014, "opt_depth": True,
                       "matching_conf_thr": 5.0, "shared_intrinsics": False},
    }  # fmt: skip
    assert truth.asked == wanted[type(config)]


def test_a_graph_without_pairs_is_refused_by_name(shown):
    scene, _, adapter, config = shown()
    wrong = type(config)(checkpoint=config.checkpoint, pairs="complet")
    said = r"pairs of .*3r must be a scene graph .*got 'complet', for which it forms no pairs"
    with pytest.raises(ValueError, match=said):
        adapter(scene.pictures, as_dark(scene.pictures), n_points=10, config=wrong)


def test_the_same_seed_gives_the_same_points_and_torchs_own_stream_goes_on_untouched(shown):
    scene, _, adapter, config = shown()
    torch.manual_seed(11)
    first, second, other = (
        adapter(scene.pictures, as_dark(scene.pictures), n_points=50, config=config, seed=seed) for seed in (3, 3, 4)
    )
    after = torch.rand(1)
    assert torch.equal(first.points, second.points)
    assert not torch.equal(first.points, other.points)
    torch.manual_seed(11)
    assert torch.equal(after, torch.rand(1))


@pytest.mark.parametrize(("width", "height"), SHAPES)
def test_pictures_are_prepared_as_the_loader_of_the_package_does(corner, width, height):
    """Pillow's filter for the direction, the part in the middle, and -1..1."""
    pictures = corner(1, width, height).pictures
    views, window = as_its_loader(pictures)
    scaled, (wide, tall), (left, top) = SHAPES[width, height]
    how = Image.Resampling.LANCZOS if max(width, height) > 512 else Image.Resampling.BICUBIC
    whole = np.asarray(Image.fromarray(pictures[0]).resize(scaled, how), np.float32)
    want = whole[top : top + tall, left : left + wide] / 127.5 - 1
    np.testing.assert_allclose(views[0]["img"][0].movedim(0, -1).numpy(), want, atol=1e-6)
    np.testing.assert_allclose(
        window.original(np.array([0.0, 0.0])), [left * width / scaled[0], top * height / scaled[1]]
    )
    assert (window.width, window.height) == (wide, tall)


def test_pictures_too_elongated_for_a_patch_are_refused():
    with pytest.raises(ValueError, match=r"pictures of 400 x 10 px are 512 x 13 px when .* needs 16 px each way"):
        as_its_loader(np.zeros((2, 10, 400, 3), np.uint8))


def test_weights_of_hugging_face_are_read_with_their_arguments(shown, arguments, tmp_path):
    """JSON has no tuples, and Infinity for inf."""
    scene, _, adapter, config = shown()
    folder = tmp_path / "snapshot"
    folder.mkdir()
    save_file({"head.weight": torch.tensor([[1.0, 2.0]])}, folder / "model.safetensors")
    lists = {k: list(v) if isinstance(v, tuple) else v for k, v in arguments.items()}
    (folder / "config.json").write_text(json.dumps(lists))
    config = type(config)(checkpoint=folder / "model.safetensors")
    assert len(adapter(scene.pictures, as_dark(scene.pictures), n_points=10, config=config).points) == 10
    (folder / "config.json").unlink()
    with pytest.raises(ValueError, match=r"model.safetensors does not hold the weights .*config.json"):
        adapter(scene.pictures, as_dark(scene.pictures), n_points=10, config=config)


class Bomb:
    """A pickle that makes a file when it is read."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self):
        return (Path.touch, (self.file,))


def test_a_checkpoint_that_would_run_code_is_refused_and_runs_none(shown, weights, tmp_path):
    scene, _, adapter, config = shown()
    name, mark = PACKAGES[adapter.__module__.rsplit(".", 1)[1]][2], tmp_path / "mark"
    weights(name, extra=Bomb(mark))
    with pytest.raises(ValueError, match=r"weights.pth cannot be read as weights without running code .*safetensors"):
        adapter(scene.pictures, as_dark(scene.pictures), n_points=10, config=config)
    weights(name, args=argparse.Namespace(model=f"{name}(img_size=open({str(mark)!r}, 'w'))"))
    with pytest.raises(ValueError, match=f"weights.pth does not hold the weights of this {name}: malformed"):
        adapter(scene.pictures, as_dark(scene.pictures), n_points=10, config=config)
    assert not mark.exists()
    with pytest.raises(pickle.UnpicklingError):  # it was one
        torch.load(weights(name, extra=Bomb(mark)), weights_only=True)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"model": {"body.weight": torch.zeros(1, 2)}}, r"1 of its tensors are missing, head.weight for one"),
        ({"model": {"head.weight": torch.zeros(3, 2)}}, r"size mismatch|Error\(s\) in loading"),
        ({"args": argparse.Namespace(model="Other(img_size=(512, 512))")}, r"its arguments belong to 'Other"),
        ({"args": argparse.Namespace(model="{name}(img_size=(224, 224))")}, r"they are for pictures of 224 px"),
        ({"args": argparse.Namespace(model="{name}((512, 512))")}, r"its arguments belong to"),
        ({"args": None}, "has no attribute 'model'"),
    ],
)
def test_weights_of_another_network_are_refused(shown, weights, wrong, message):
    scene, _, adapter, config = shown()
    name = PACKAGES[adapter.__module__.rsplit(".", 1)[1]][2]
    if isinstance(spelled := wrong.get("args"), argparse.Namespace):
        wrong = {"args": argparse.Namespace(model=spelled.model.format(name=name))}
    weights(name, **wrong)
    with pytest.raises(ValueError, match=f"weights.pth does not hold the weights of this {name}: .*({message})"):
        adapter(scene.pictures, as_dark(scene.pictures), n_points=10, config=config)


def test_a_version_with_another_convention_is_refused_instead_of_believed(shown):
    """Poses world-to-camera, which no later step could tell from true ones."""
    scene, truth, adapter, config = shown()
    pose = truth.pose
    truth.pose = lambda view: np.linalg.inv(pose(view))
    points = truth.points
    # The points stay where they are: in the world of the true poses.
    truth.points = lambda i: (
        (points(i) @ pose(i)[:3, :3].T + pose(i)[:3, 3] - truth.pose(i)[:3, 3]) @ truth.pose(i)[:3, :3]
    )
    with pytest.raises(ValueError, match=r"returned points that its own cameras see .* px from their pixels"):
        adapter(scene.pictures, as_dark(scene.pictures), n_points=500, config=config)


def test_cameras_that_are_not_finite_and_absent_points_are_refused(shown):
    scene, truth, adapter, config = shown()
    truth.Ks[1, 0, 0] = np.nan
    with pytest.raises(ValueError, match="returned cameras that are not finite"):
        adapter(scene.pictures, as_dark(scene.pictures), n_points=10, config=config)
    truth.depths[:] = np.nan
    with pytest.raises(ValueError, match="the pictures may be too dark, try pictures=enhanced"):
        adapter(scene.pictures, as_dark(scene.pictures), n_points=10, config=config)


def test_what_does_not_fit_is_refused(shown):
    scene, _, adapter, config = shown()
    dark, source = as_dark(scene.pictures), adapter.__module__.rsplit(".", 1)[1]
    with pytest.raises(ValueError, match=r"pictures must be uint8 \[C >= 2, h, w, 3\]"):
        adapter(scene.pictures[:1], dark[:1], n_points=10, config=config)
    with pytest.raises(ValueError, match="n_points must be >= 2, got 1"):
        adapter(scene.pictures, dark, n_points=1, config=config)
    for wrong, message in (
        ({"drop_percent": 100.0}, rf"drop_percent of {source} must lie in \[0, 100\), got 100"),
        ({"pictures": "lit"}, f"pictures of {source} must be one of raw, enhanced, denoised, got 'lit'"),
        ({"iterations": 0}, f"iterations of {source} must be >= 1, got 0"),
    ):
        with pytest.raises(ValueError, match=message):
            type(config)(checkpoint=config.checkpoint, **wrong)


def test_without_package_or_weights_one_line_says_what_to_do(shown, tmp_path, monkeypatch):
    scene, _, adapter, config = shown()
    dark, source = as_dark(scene.pictures), adapter.__module__.rsplit(".", 1)[1]
    none = type(config)(checkpoint=tmp_path / "none.pth")
    with pytest.raises(
        ValueError, match=rf"no {source.upper()} weights at .*none.pth: download .*{source}:checkpoint=FILE"
    ):
        adapter(scene.pictures, dark, n_points=10, config=none)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        ValueError, match=rf"need the package {source}, .*clone https://github.com/naver/{source} .*CC BY-NC"
    ):
        adapter(scene.pictures, dark, n_points=10, config=config)


def test_a_package_that_cannot_be_imported_says_what_is_missing(shown, monkeypatch):
    scene, _, adapter, config = shown()
    source = adapter.__module__.rsplit(".", 1)[1]
    monkeypatch.setitem(sys.modules, f"{source}.model", None)  # importing it then fails
    with pytest.raises(ValueError, match=rf"cameras {source}: {source}.model cannot be imported"):
        adapter(scene.pictures, as_dark(scene.pictures), n_points=10, config=config)
