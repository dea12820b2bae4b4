"""The adapter to Depth Anything 3 against a stand-in with the interface of the real package, over a scene it knows.

Signatures, shapes and conventions are those of depth-anything-3 0.1.1, read in its sources.
"""

import importlib.util
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from novags.cameras import parse_cameras
from novags.cameras.estimate import extent_of
from novags.cameras.networks.depth_anything import as_its_loader, da3_cameras
from novags.cameras.sources.da3 import Da3Config

SIZES = [(40, 30), (40, 60), (96, 96), (560, 420), (60, 40)]  # wide, tall, square, larger than the network's, rounded
MEAN, DEVIATION = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])


class Net(torch.nn.Module):
    """The network within, which is called without the half precision of its owner's `forward`."""

    truth: dict[str, torch.Tensor] = {}
    asked: list[bool] = []
    told: Any = None  # known cameras, which it expects
    told_as: Any = None

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(2))

    def forward(
        self, x, extrinsics=None, intrinsics=None, export_feat_layers=(), infer_gs=False, use_ray_pose=False,
        ref_view_strategy="saddle_balanced",
    ) -> dict[str, torch.Tensor]:  # fmt: skip
        assert x.dtype == torch.float32
        assert x.shape == (1, self.truth["depth"].shape[1], 3, *self.truth["depth"].shape[2:])
        assert (export_feat_layers, infer_gs) == ([], False)
        if self.told is None:
            assert (extrinsics, intrinsics) == (None, None)
        else:  # world to camera, of which the package takes the inverses
            assert extrinsics.dtype == intrinsics.dtype == torch.float32
            assert extrinsics.shape == (1, len(self.told.Ks), 4, 4)
            type(self).told_as(torch.linalg.inv(extrinsics[0]), self.told)
            np.testing.assert_allclose(intrinsics[0].numpy(), self.told.Ks, rtol=1e-6)
        assert ref_view_strategy == "saddle_balanced"
        assert not self.training
        assert not torch.is_grad_enabled()
        torch.testing.assert_close(self.weight.detach(), torch.tensor([1.0, 2.0]))
        self.asked.append(use_ray_pose)
        return dict(self.truth)


class DepthAnything3(torch.nn.Module):
    """Whose weights have names that begin with `model.`."""

    def __init__(self, model_name: str = "da3-large", **kwargs) -> None:
        super().__init__()
        assert not kwargs
        self.made_as, self.model = model_name, Net()
        if model_name == "da3-giant":
            self.model.more = torch.nn.Parameter(torch.zeros(1))


@pytest.fixture
def package(monkeypatch, tmp_path, installed, told_as):
    installed({"depth_anything_3.api": {"DepthAnything3": DepthAnything3}})
    monkeypatch.setattr(Net, "told", None)
    monkeypatch.setattr(Net, "told_as", staticmethod(told_as))
    save_file({"model.weight": torch.tensor([1.0, 2.0])}, tmp_path / "model.safetensors")
    monkeypatch.setattr(Net, "asked", [])
    return tmp_path / "model.safetensors"


def network_size(width: int, height: int) -> tuple[int, int]:
    """The longest side 504 px, then the nearest multiples of 14, written out."""
    sides = [round(side * 504 / max(width, height)) for side in (width, height)]
    return tuple(min(range(14, 1000, 14), key=lambda m: (abs(m - side), -m)) for side in sides)  # type: ignore[return-value]


@pytest.fixture
def shown(corner, package):
    """A corner of a room as the network would see it, and the configuration that runs the stand-in on it."""

    def make(width: int, height: int, count: int = 2) -> tuple[Any, Da3Config]:
        scene = corner(count, width, height)
        wide, tall = network_size(width, height)
        Ks = scene.rig.Ks * np.array([wide / width, tall / height, 1])[:, None]
        depths = np.stack([scene.depth(v, K, wide, tall) for v, K in zip(scene.rig.viewmats, Ks, strict=True)])
        confidence = 1 + torch.rand(1, count, tall, wide, generator=torch.Generator().manual_seed(0))
        Net.truth = {
            "depth": torch.tensor(depths, dtype=torch.float32)[None], "depth_conf": confidence,
            "extrinsics": torch.tensor(scene.rig.viewmats[:, :3], dtype=torch.float32)[None],
            "intrinsics": torch.tensor(Ks, dtype=torch.float32)[None],
        }  # fmt: skip
        return scene, Da3Config(checkpoint=package)

    return make


def as_dark(pictures: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(pictures.astype(np.float32) / 2550)


def found(scene: Any, config: Da3Config, count: int = 1000, seed: int = 0) -> Any:
    dark = as_dark(scene.pictures)
    return da3_cameras(scene.pictures, scene.rig, dark, n_points=count, config=config, seed=seed)


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_cameras_intrinsics_and_points_are_the_networks_at_the_size_of_the_pictures(shown, width, height):
    scene, config = shown(width, height)
    got = found(scene, config, 4000)
    assert got.registered == (0, 1)
    np.testing.assert_allclose(got.viewmats.numpy(), scene.rig.viewmats, atol=2e-6)
    np.testing.assert_allclose(got.Ks.numpy(), scene.rig.Ks, rtol=2e-6, atol=1e-5)
    assert len(got.points) == 4000
    assert scene.distance(got.points.numpy()).max() < 1e-5


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_pictures_are_prepared_as_the_loader_of_the_package_does(corner, width, height):
    pictures = corner(1, width, height).pictures
    prepared, window = as_its_loader(pictures)
    longest, picture = max(width, height), pictures[0]
    first = (round(width * 504 / longest), round(height * 504 / longest))
    wanted = network_size(width, height)
    for size, shrinks in ((first, longest > 504), (wanted, wanted[0] <= first[0] and wanted[1] <= first[1])):
        if size != picture.shape[1::-1]:
            picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)
    assert prepared.dtype == torch.float32
    np.testing.assert_allclose(prepared[0].movedim(0, -1).numpy(), (picture / 255 - MEAN) / DEVIATION, atol=1e-5)
    assert (window.width, window.height) == wanted
    np.testing.assert_allclose(window.scale, [wanted[0] / width, wanted[1] / height])


def test_the_least_confident_depths_give_no_points(shown):
    scene, config = shown(40, 30)
    wrong = torch.zeros_like(Net.truth["depth_conf"], dtype=torch.bool)
    wrong[..., :100] = True  # a fifth, of which no depth is right
    Net.truth["depth"] = torch.where(wrong, 3 * Net.truth["depth"], Net.truth["depth"])
    Net.truth["depth_conf"] = torch.where(wrong, 1.0, Net.truth["depth_conf"] + 1)
    assert scene.distance(found(scene, config, 3000).points.numpy()).max() < 1e-5
    everything = Da3Config(checkpoint=config.checkpoint, drop_percent=0.0)
    assert scene.distance(found(scene, everything, 3000).points.numpy()).max() > 0.1


def test_rays_and_seed_are_passed_on(shown):
    scene, config = shown(40, 30)
    rays = Da3Config(checkpoint=config.checkpoint, rays=True)
    first, second, other = (found(scene, rays, 50, seed).points for seed in (3, 3, 4))
    assert torch.equal(first, second)
    assert not torch.equal(first, other)
    found(scene, config)
    assert Net.asked == [True, True, True, False]


@pytest.mark.parametrize("count", [2, 3, 9])
@pytest.mark.parametrize("inverse", [True, False])
def test_cameras_of_another_convention_are_refused_though_depths_scatter(shown, count, inverse):
    scene, config = shown(40, 30, count)
    noise = torch.randn(Net.truth["depth"].shape, generator=torch.Generator().manual_seed(1))
    Net.truth["depth"] = Net.truth["depth"] * torch.exp(0.01 * noise)
    found(scene, config)
    other = np.linalg.inv(scene.rig.viewmats) if inverse else np.diag([1, -1, -1, 1]) @ scene.rig.viewmats
    Net.truth["extrinsics"] = torch.tensor(other[:, :3], dtype=torch.float32)[None]
    with pytest.raises(
        ValueError,
        match=r"da3 returned depths .* if cameras were camera-to-world .* has other conventions",
    ):
        found(scene, config)


def test_depths_that_contradict_each_other_by_any_convention_are_no_sign_of_one(shown):
    scene, config = shown(40, 30, 4)
    noise = torch.randn(Net.truth["depth"].shape, generator=torch.Generator().manual_seed(2))
    Net.truth["depth"] = Net.truth["depth"] * torch.exp(noise)
    assert len(found(scene, config).points) == 1000


@pytest.mark.parametrize("count", [2, 3, 11])
def test_known_cameras_stay_and_depths_are_scaled_to_them(shown, answered, count):
    """It answers in a frame and unit of its own, with a lens that is a little off, as networks do."""
    scene, config = shown(40, 30, count)
    right = Net.told = answered(scene, Net.truth["intrinsics"][0].double().numpy(), *network_size(40, 30))
    Net.truth |= {
        "depth": torch.tensor(right.depths).float()[None],
        "extrinsics": torch.linalg.inv(torch.tensor(right.poses).float())[None],
        "intrinsics": Net.truth["intrinsics"] * torch.tensor([1.01, 1.01, 1])[:, None],
    }
    known = replace(config, known="cameras")
    got = found(scene, known, 3000)
    np.testing.assert_array_equal(got.viewmats.numpy(), scene.rig.viewmats)
    np.testing.assert_array_equal(got.Ks.numpy(), scene.rig.Ks)
    assert got.extent == extent_of(np.array(scene.rig.viewmats))
    assert scene.distance(got.points.numpy()).max() < 1e-5
    Net.truth["extrinsics"] = torch.eye(4)[None, None].repeat(1, count, 1, 1)
    with pytest.raises(ValueError, match="da3 cannot scale its depths by the known cameras: the estimated cameras all"):
        found(scene, known)


def test_depths_of_cameras_the_other_way_round_are_refused_where_cameras_are_known(shown, answered):
    """Of a package that takes what it is told for camera-to-world, and says it again."""
    scene, config = shown(40, 30, 3)
    size = network_size(40, 30)
    right = Net.told = answered(scene, Net.truth["intrinsics"][0].double().numpy(), *size)
    first, viewmats = scene.rig.viewmats[0], scene.rig.viewmats
    inverse = np.stack([np.linalg.inv(viewmat @ np.linalg.inv(first)) @ first for viewmat in viewmats])
    wrong = answered(replace(scene, rig=replace(scene.rig, viewmats=inverse)), right.Ks, *size)
    Net.truth["depth"] = torch.tensor(wrong.depths).float()[None]
    Net.truth["extrinsics"] = torch.linalg.inv(torch.tensor(right.poses).float())[None]
    with pytest.raises(
        ValueError, match=r"da3 returned depths .* if cameras were camera-to-world .* other conventions"
    ):
        found(scene, replace(config, known="cameras"))


def test_one_view_has_nothing_to_contradict_it(shown):
    scene, config = shown(40, 30, 1)
    assert len(found(scene, config).points) == 1000


def test_weights_of_another_network_or_none_are_said_in_one_line(shown, package, tmp_path, monkeypatch):
    scene, config = shown(40, 30)
    with pytest.raises(ValueError, match=r"does not hold the weights of da3-giant: .*; da3:network=NAME says which"):
        found(scene, Da3Config(checkpoint=package, network="da3-giant"))
    with pytest.raises(ValueError, match=r"no DA3 weights at .*SMALL and BASE: Apache-2.0.*da3:checkpoint=FILE"):
        found(scene, Da3Config(checkpoint=tmp_path / "none.safetensors"))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"package depth_anything_3, which is not installed.*CC BY-NC"):
        found(scene, config)


def test_what_does_not_fit_is_refused(shown, package):
    scene, config = shown(40, 30)
    assert parse_cameras(f"da3:checkpoint={package},network=da3-small,known=cameras") == Da3Config(
        checkpoint=package, network="da3-small", known="cameras"
    )
    with pytest.raises(ValueError, match="known must be one of nothing, cameras, got 'lenses'"):
        parse_cameras(f"da3:checkpoint={package},known=lenses")
    with pytest.raises(ValueError, match="known of da3 must be one of nothing, cameras, got 'lenses'"):
        Da3Config(checkpoint=package, known="lenses")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="network of da3 must be one of da3-small, .*, got 'da3-tiny'"):
        Da3Config(checkpoint=package, network="da3-tiny")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"drop_percent of da3 must lie in \[0, 100\), got 100"):
        Da3Config(checkpoint=package, drop_percent=100)
    for key, value in (("extrinsics", torch.nan), ("depth_conf", torch.inf), ("depth", -1.0)):
        before = Net.truth[key]
        Net.truth[key] = torch.full_like(before, value)
        with pytest.raises(ValueError, match="not finite|no positive depth"):
            found(scene, config)
        Net.truth[key] = before
