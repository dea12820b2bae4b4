"""The adapter to VGGT against a stand-in with the interface of the real package, which knows the scene it is shown."""

import importlib.machinery
import sys
import types

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import save_file
from scipy.spatial.transform import Rotation

from novags.cameras.networks.vggt import as_its_loader, vggt_cameras
from novags.cameras.points import unproject
from novags.cameras.sources.vggt import VggtConfig

SIZES = [(40, 30), (40, 60), (96, 96), (560, 420)]  # wide, tall (its middle is kept), square, larger than the network's


def pose_encoding(viewmats: np.ndarray, Ks: np.ndarray, height: int, width: int) -> torch.Tensor:
    """[1, S, 9]: translation, quaternion with the scalar last, vertical and horizontal field of view in radians."""
    quaternions = Rotation.from_matrix(viewmats[:, :3, :3]).as_quat()
    fov = 2 * np.arctan([height / 2 / Ks[:, 1, 1], width / 2 / Ks[:, 0, 0]]).T
    return torch.tensor(np.concatenate([viewmats[:, :3, 3], quaternions, fov], 1), dtype=torch.float32)[None]


def pose_encoding_to_extri_intri(pose_encoding, image_size_hw=None, pose_encoding_type="absT_quaR_FoV"):
    """[B, S, 9] -> world-to-camera [B, S, 3, 4] and intrinsics [B, S, 3, 3] with the principal point in the middle."""
    height, width = image_size_hw
    x, y, z, w = (pose_encoding[..., 3:7] / pose_encoding[..., 3:7].norm(dim=-1, keepdim=True)).unbind(-1)
    rotation = torch.stack(
        [
            1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
            2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
            2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
        ],
        -1,
    ).unflatten(-1, (3, 3))  # fmt: skip
    intrinsics = torch.zeros_like(rotation)
    intrinsics[..., 0, 0] = width / 2 / torch.tan(pose_encoding[..., 8] / 2)
    intrinsics[..., 1, 1] = height / 2 / torch.tan(pose_encoding[..., 7] / 2)
    intrinsics[..., 0, 2], intrinsics[..., 1, 2], intrinsics[..., 2, 2] = width / 2, height / 2, 1
    return torch.cat([rotation, pose_encoding[..., :3, None]], -1), intrinsics


class StandIn(torch.nn.Module):
    """Predicts the truth, which the test sets: cameras, intrinsics and depths of the prepared pictures."""

    truth: dict[str, torch.Tensor] = {}

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(2))

    def aggregator(self, images):
        assert images.ndim == 5
        assert images.shape[:3] == (1, len(self.truth["depth"][0]), 3)
        assert not self.training
        torch.testing.assert_close(self.weight.detach(), torch.tensor([1.0, 2.0]))
        return [images.mean((-1, -2))], 5

    def camera_head(self, tokens):
        assert len(tokens) == 1
        return [torch.zeros_like(self.truth["pose"]), self.truth["pose"]]  # refined step by step; the last one counts

    def depth_head(self, tokens, images, patch_start_idx):
        assert patch_start_idx == 5
        return self.truth["depth"], self.truth["confidence"]

    def point_head(self, tokens, images, patch_start_idx):
        assert patch_start_idx == 5
        return self.truth["points"], self.truth["confidence"]


@pytest.fixture
def package(monkeypatch, tmp_path):
    """The stand-in as the package `vggt`, and a file of weights."""
    modules = {name: types.ModuleType(name) for name in
               ("vggt", "vggt.models", "vggt.models.vggt", "vggt.utils", "vggt.utils.pose_enc")}  # fmt: skip
    modules["vggt.models.vggt"].VGGT = StandIn
    modules["vggt.utils.pose_enc"].pose_encoding_to_extri_intri = pose_encoding_to_extri_intri
    for name, module in modules.items():
        module.__spec__ = importlib.machinery.ModuleSpec(name, None)
        monkeypatch.setitem(sys.modules, name, module)
    torch.save({"weight": torch.tensor([1.0, 2.0])}, tmp_path / "weights.pt")
    return tmp_path / "weights.pt"


def network_view(K: np.ndarray, width: int, height: int) -> tuple[np.ndarray, int]:
    """Intrinsics and height of the 518-px picture, written out: scaled, and the rows above the middle 518 cut off."""
    tall = 14 * round(height * 518 / width / 14)
    shown = np.array([[K[0, 0] * 518 / width, 0, K[0, 2] * 518 / width],
                      [0, K[1, 1] * tall / height, K[1, 2] * tall / height], [0, 0, 1]])  # fmt: skip
    shown[1, 2] -= (tall - min(tall, 518)) / 2
    return shown, min(tall, 518)


def world_points(viewmats: np.ndarray, Ks: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """[S, H, W, 3] of every pixel."""
    view, y, x = np.indices(depths.shape).reshape(3, -1)
    return unproject(
        np.stack([x, y], -1) + 0.5, depths.reshape(-1), np.asarray(viewmats)[view], Ks[view]
    ).reshape(*depths.shape, 3)  # fmt: skip


@pytest.fixture
def shown(corner, package):
    """A corner of a room as the network would see it, and the configuration that runs the stand-in on it."""

    def make(width: int, height: int, count: int = 2):
        scene = corner(count, width, height)
        Ks = np.stack([network_view(K, width, height)[0] for K in scene.rig.Ks])
        tall = network_view(scene.rig.Ks[0], width, height)[1]
        depths = np.stack([scene.depth(v, K, 518, tall) for v, K in zip(scene.rig.viewmats, Ks, strict=True)])
        StandIn.truth = {
            "pose": pose_encoding(scene.rig.viewmats, Ks, tall, 518),
            "depth": torch.tensor(depths, dtype=torch.float32)[None, ..., None],
            "points": torch.tensor(world_points(scene.rig.viewmats, Ks, depths), dtype=torch.float32)[None],
            "confidence": 1 + torch.rand(1, count, tall, 518, generator=torch.Generator().manual_seed(0)),
        }
        return scene, VggtConfig(checkpoint=package)

    return make


def as_dark(pictures: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(pictures.astype(np.float32) / 2550)


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_cameras_intrinsics_and_points_are_the_networks_at_the_size_of_the_pictures(shown, width, height):
    scene, config = shown(width, height)
    found = vggt_cameras(scene.pictures, as_dark(scene.pictures), n_points=4000, config=config)
    assert found.registered == (0, 1)
    np.testing.assert_allclose(found.viewmats.numpy(), scene.rig.viewmats, atol=2e-6)
    np.testing.assert_allclose(found.Ks.numpy(), scene.rig.Ks, rtol=2e-6, atol=1e-5)
    assert len(found.points) == 4000
    assert scene.distance(found.points.numpy()).max() < 1e-5
    # All over each picture that the network saw: its rows, for a tall one those of the middle.
    rows = min(height, width)
    for viewmat, K in zip(scene.rig.viewmats, scene.rig.Ks, strict=True):
        camera = found.points.double().numpy() @ viewmat[:3, :3].T + viewmat[:3, 3]
        pixels = (camera @ K.T)[:, :2] / camera[:, 2:]
        inside = ((pixels > 0) & (pixels < [width, height])).all(1)
        assert np.ptp(pixels[inside, 0]) > 0.9 * width
        assert np.ptp(pixels[inside, 1]) > 0.9 * rows


@pytest.mark.parametrize(("width", "height"), SIZES[:3])
def test_points_take_the_colour_of_the_place_they_are_seen_at(shown, width, height):
    """A dark image whose red and green are the position in the picture."""
    scene, config = shown(width, height, count=1)
    y, x = np.mgrid[0:height, 0:width] + 0.5
    dark = torch.from_numpy(np.stack([x / width, y / height, 0 * x], -1)[None])
    found = vggt_cameras(scene.pictures, dark, n_points=20_000, config=config)
    camera = found.points.double().numpy() @ scene.rig.viewmats[0, :3, :3].T + scene.rig.viewmats[0, :3, 3]
    pixels = (camera @ scene.rig.Ks[0].T)[:, :2] / camera[:, 2:]
    off = found.colors[:, :2].numpy() * [width, height] - pixels
    # A colour is that of a whole pixel, so half a pixel off at most, and a mean over neighbours less than a pixel away.
    assert np.abs(off).max() < 1.5
    assert np.abs(off.mean(0)).max() < 0.02


def test_the_least_confident_depths_give_no_points(shown):
    scene, config = shown(40, 30)
    wrong = torch.zeros(1, 2, 392, 518, dtype=torch.bool)
    wrong[0, :, :, :130] = True  # a quarter, of which no depth is right
    StandIn.truth["depth"] = torch.where(wrong[..., None], 3 * StandIn.truth["depth"], StandIn.truth["depth"])
    StandIn.truth["confidence"] = torch.where(wrong, 1.0, StandIn.truth["confidence"] + 1)
    dark = as_dark(scene.pictures)
    kept = vggt_cameras(scene.pictures, dark, n_points=3000, config=config)
    assert scene.distance(kept.points.numpy()).max() < 1e-5
    everything = VggtConfig(checkpoint=config.checkpoint, drop_percent=0.0)
    all_of_them = vggt_cameras(scene.pictures, dark, n_points=3000, config=everything)
    share = (scene.distance(all_of_them.points.numpy()) > 1e-3).mean()
    # A quarter of all pixels; 5 standard deviations of a share among 3000.
    assert share == pytest.approx(130 / 518, abs=5 * (0.25 * 0.75 / 3000) ** 0.5 + 0.01)


def test_the_seed_chooses_the_points(shown):
    scene, config = shown(40, 30)
    first, second, other = (
        vggt_cameras(scene.pictures, as_dark(scene.pictures), n_points=50, config=config, seed=seed).points
        for seed in (3, 3, 4)
    )
    assert torch.equal(first, second)
    assert not torch.equal(first, other)


def test_weights_in_safetensors_are_read_and_other_weights_are_refused(shown, tmp_path):
    scene, _ = shown(40, 30)
    dark = as_dark(scene.pictures)
    save_file({"weight": torch.tensor([1.0, 2.0])}, tmp_path / "weights.safetensors")
    config = VggtConfig(checkpoint=tmp_path / "weights.safetensors")
    assert len(vggt_cameras(scene.pictures, dark, n_points=10, config=config).points) == 10
    save_file({"other": torch.tensor([1.0, 2.0])}, tmp_path / "other.safetensors")
    with pytest.raises(ValueError, match="does not hold the weights of this VGGT"):
        vggt_cameras(scene.pictures, dark, n_points=10, config=VggtConfig(checkpoint=tmp_path / "other.safetensors"))


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_pictures_are_prepared_as_the_loader_of_the_package_does(corner, width, height):
    """Pillow's bicubic filter, then the middle of a tall picture."""
    pictures = corner(1, width, height).pictures
    prepared, window = as_its_loader(pictures)
    tall = round(height * (518 / width) / 14) * 14
    want = np.asarray(Image.fromarray(pictures[0]).resize((518, tall), Image.Resampling.BICUBIC), np.float32) / 255
    start = max(0, (tall - 518) // 2)
    got = prepared[0].movedim(0, -1).numpy()
    assert prepared.dtype == torch.float32
    np.testing.assert_array_equal(window.offset, [0, start])
    np.testing.assert_allclose(got, want[start : start + 518], atol=1e-6)
    np.testing.assert_allclose(window.scale, [518 / width, tall / height])


def test_without_package_or_weights_one_line_says_what_to_do(corner, package, tmp_path, monkeypatch):
    scene = corner(2, 40, 30)
    dark = as_dark(scene.pictures)
    with pytest.raises(ValueError, match=r"no VGGT weights at .*vggt:checkpoint=FILE"):
        vggt_cameras(scene.pictures, dark, n_points=10, config=VggtConfig(checkpoint=tmp_path / "none.pt"))
    monkeypatch.delitem(sys.modules, "vggt")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"package vggt, which is not installed.*vggt:checkpoint=FILE"):
        vggt_cameras(scene.pictures, dark, n_points=10, config=VggtConfig(checkpoint=package))


def test_cameras_and_confidences_that_are_not_finite_and_absent_depths_are_refused(shown):
    scene, config = shown(40, 30)
    dark, truth = as_dark(scene.pictures), StandIn.truth
    StandIn.truth = truth | {"pose": truth["pose"] * float("nan")}
    with pytest.raises(ValueError, match="cameras that are not finite"):
        vggt_cameras(scene.pictures, dark, n_points=10, config=config)
    StandIn.truth = truth | {"depth": -truth["depth"]}
    with pytest.raises(ValueError, match="no positive depth"):
        vggt_cameras(scene.pictures, dark, n_points=10, config=config)
    for part in ("pose", "depth", "confidence"):  # as half precision leaves them where it overflows
        StandIn.truth = StandIn.truth | {part: truth[part] * float("nan")}
    with pytest.raises(ValueError, match="confidences that are not finite: check the weights"):
        vggt_cameras(scene.pictures, dark, n_points=10, config=config)


def inverted(extrinsics: torch.Tensor, intrinsics: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    turned = extrinsics[..., :3].mT
    return torch.cat([turned, -turned @ extrinsics[..., 3:]], -1), intrinsics


def with_longer_lens(extrinsics: torch.Tensor, intrinsics: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    return extrinsics, intrinsics * torch.tensor([1.3, 1.3, 1.0])[:, None]


@pytest.mark.parametrize("otherwise", [inverted, with_longer_lens])
@pytest.mark.parametrize("count", [2, 3])
def test_cameras_of_other_conventions_are_refused(shown, monkeypatch, otherwise, count):
    """In the frame of the first camera, as the network's are: inverting that one changes nothing."""
    scene, config = shown(40, 30, count)
    first = scene.rig.viewmats[0]
    moved = scene.rig.viewmats @ np.linalg.inv(first)
    StandIn.truth["pose"] = pose_encoding(moved, np.stack([network_view(K, 40, 30)[0] for K in scene.rig.Ks]), 392, 518)
    StandIn.truth["points"] = StandIn.truth["points"].double() @ torch.tensor(first[:3, :3].T) + torch.tensor(
        first[:3, 3]
    )
    dark = as_dark(scene.pictures)
    vggt_cameras(scene.pictures, dark, n_points=500, config=config)
    monkeypatch.setattr(
        sys.modules["vggt.utils.pose_enc"], "pose_encoding_to_extri_intri",
        lambda *given: otherwise(*pose_encoding_to_extri_intri(*given)),
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"its own cameras see .* px from their pixels.*has other conventions"):
        vggt_cameras(scene.pictures, dark, n_points=500, config=config)


def test_points_of_a_network_that_is_not_quite_right_about_them_do_not_refuse_its_cameras(shown):
    """One in a hundred of the distance, as two parts of one network may differ."""
    scene, config = shown(40, 30)
    points = StandIn.truth["points"]
    shift = torch.randn(points.shape, generator=torch.Generator().manual_seed(1))
    StandIn.truth["points"] = points + 0.01 * shift * StandIn.truth["depth"]
    vggt_cameras(scene.pictures, as_dark(scene.pictures), n_points=500, config=config)


def test_what_does_not_fit_is_refused(shown, package):
    scene, config = shown(40, 30)
    with pytest.raises(ValueError, match="pictures must be uint8"):
        vggt_cameras(scene.pictures[0], as_dark(scene.pictures), n_points=10, config=config)
    with pytest.raises(ValueError, match="colors_from must be"):
        vggt_cameras(scene.pictures, as_dark(scene.pictures)[:1], n_points=10, config=config)
    with pytest.raises(ValueError, match=r"drop_percent of vggt must lie in \[0, 100\), got 100"):
        VggtConfig(checkpoint=package, drop_percent=100)
    with pytest.raises(ValueError, match="pictures of vggt must be one of raw, enhanced, denoised"):
        VggtConfig(checkpoint=package, pictures="lit")
