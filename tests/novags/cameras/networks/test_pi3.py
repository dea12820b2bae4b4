"""The adapter to π³ and π³-X against stand-ins with the interface of the real package, over a scene they know.

Signatures, shapes and conventions are those of github.com/yyfz/Pi3 of May 2026 (9fa3ddb3), read in its sources.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import save_file

from novags.cameras import parse_cameras
from novags.cameras.align import align
from novags.cameras.networks.pi3 import as_its_loader, fitted_lenses, pi3_cameras
from novags.cameras.sources.pi3 import Pi3Config

SIZES = [(40, 30), (40, 60), (96, 96), (900, 600), (200, 20)]  # wide, tall, square, larger than the network's, a strip


class Answering(torch.nn.Module):
    """Says what a test sets."""

    answer: Any = None
    said: dict[str, torch.Tensor] = {}
    told_as: Any = None
    asked: list[set[str]] = []
    drawn: list[torch.Tensor] = []

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.rand(2))

    def check(self, imgs: torch.Tensor) -> None:
        assert imgs.dtype == torch.float32
        assert imgs.shape == (1, len(self.answer.depths), 3, *self.answer.depths.shape[1:])
        assert 0 <= float(imgs.min()) < float(imgs.max()) <= 1
        assert not self.training
        assert not torch.is_grad_enabled()
        torch.testing.assert_close(self.weight.detach(), torch.tensor([1.0, 2.0]))


class Pi3(Answering):
    def __init__(self, pos_type="rope100", decoder_size="large") -> None:
        super().__init__()
        assert (pos_type, decoder_size) == ("rope100", "large")

    def forward(self, imgs):
        self.check(imgs)
        self.asked.append(set())
        return {key: value for key, value in self.said.items() if key not in ("rays", "metric")}


class Pi3X(Answering):
    def __init__(self, ckpt=None, use_multimodal=True) -> None:
        super().__init__()
        assert ckpt is None
        self.use_multimodal, self.metric_token = use_multimodal, torch.nn.Parameter(torch.zeros(1))
        if use_multimodal:
            self.ray_embed = torch.nn.Parameter(torch.zeros(1))

    def forward(
        self, imgs, depths=None, intrinsics=None, rays=None, poses=None, with_prior=True, mask_add_depth=None,
        mask_add_ray=None, mask_add_pose=None,
    ):  # fmt: skip
        self.check(imgs)
        assert (depths, rays, with_prior, mask_add_depth, mask_add_ray, mask_add_pose) == (None, None, True) + 3 * (
            None,
        )
        self.drawn.append(torch.rand(3))  # as it does, to decide what is certain
        told = {name for name, value in (("intrinsics", intrinsics), ("poses", poses)) if value is not None}
        assert self.use_multimodal == bool(told)
        self.asked.append(told)
        if intrinsics is not None:  # it sends a ray through (u + 0.5, v + 0.5)
            assert intrinsics.dtype == torch.float32
            np.testing.assert_allclose(intrinsics[0].numpy(), self.answer.Ks, rtol=1e-6)
        if poses is not None:
            type(self).told_as(poses[0], self.answer)
            # Cameras that are less far apart it takes for one that does not move.
            assert poses[0, 1:, :3, 3].norm(dim=-1).max() > 2e-2
        return dict(self.said)


@pytest.fixture
def package(installed, tmp_path, monkeypatch, told_as):
    installed({"pi3.models.pi3": {"Pi3": Pi3}, "pi3.models.pi3x": {"Pi3X": Pi3X}})
    weights = {"weight": torch.tensor([1.0, 2.0])}
    save_file(weights, tmp_path / "pi3.safetensors")
    save_file(weights | {"metric_token": torch.ones(1), "ray_embed": torch.ones(1)}, tmp_path / "pi3x.safetensors")
    monkeypatch.setattr(Answering, "asked", [])
    monkeypatch.setattr(Answering, "drawn", [])
    monkeypatch.setattr(Answering, "told_as", staticmethod(told_as))
    return tmp_path


@pytest.fixture
def shown(corner, package, answered):
    """A corner of a room, and the configuration that runs a stand-in on it, whose answer is right."""

    def make(width: int, height: int, count: int = 2, network: str = "pi3x", **settings) -> tuple[Any, Pi3Config]:
        scene = corner(count, width, height)
        wide, tall = network_size(width, height)
        answer = Answering.answer = answered(
            scene, scene.rig.Ks * np.array([wide / width, tall / height, 1])[:, None], wide, tall
        )
        likely = np.log(answer.confidence - 1 + 1e-3)  # a logit
        said = {"points": answer.points, "local_points": answer.local, "conf": likely[..., None],
                "camera_poses": answer.poses}  # fmt: skip
        Answering.said = {key: torch.tensor(value, dtype=torch.float32)[None] for key, value in said.items()}
        return scene, Pi3Config(checkpoint=package / f"{network}.safetensors", network=network, **settings)

    return make


def network_size(width: int, height: int) -> tuple[int, int]:
    """As its `load_images_as_tensor` finds it."""
    scale = np.sqrt(255000 / (width * height))
    k, m = round(width * scale / 14), round(height * scale / 14)
    while (k * 14) * (m * 14) > 255000:
        if k / m > (width * scale) / (height * scale):
            k -= 1
        else:
            m -= 1
    return max(1, k) * 14, max(1, m) * 14


def found(scene: Any, config: Pi3Config, count: int = 1000, seed: int = 0) -> Any:
    dark = torch.from_numpy(scene.pictures.astype(np.float32) / 2550)
    return pi3_cameras(scene.pictures, scene.rig, dark, n_points=count, config=config, seed=seed)


@pytest.mark.parametrize(
    ("size", "network", "known"),
    [
        ((40, 30), "pi3", "nothing"), ((40, 60), "pi3x", "nothing"), ((40, 30), "pi3x", "lenses"),
        ((40, 60), "pi3x", "cameras"),
    ],
)  # fmt: skip
def test_cameras_lenses_and_points_are_right_and_known_ones_the_sets_own(shown, size, network, known):
    scene, config = shown(*size, 3, network, known=known)
    got = found(scene, config, 4000)
    assert got.registered == (0, 1, 2)
    assert Answering.asked == [{"nothing": set(), "lenses": {"intrinsics"}, "cameras": {"intrinsics", "poses"}}[known]]
    if known == "nothing":
        np.testing.assert_allclose(got.Ks.numpy(), scene.rig.Ks, rtol=2e-6)
    else:
        np.testing.assert_array_equal(got.Ks.numpy(), scene.rig.Ks)
    fitted = align(got.viewmats, torch.from_numpy(np.array(scene.rig.viewmats)))
    if known == "cameras":
        np.testing.assert_array_equal(got.viewmats.numpy(), scene.rig.viewmats)
    else:
        assert fitted.similarity.scale == pytest.approx(1 / 1.7, rel=1e-6)
        assert fitted.rotation_deg.max() < 1e-4
        assert fitted.centre_error.max() < 1e-5
    assert scene.distance(fitted.similarity.apply(got.points).numpy()).max() < 1e-5


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_pictures_are_prepared_as_the_loader_of_the_package_does(corner, width, height):
    pictures = corner(1, width, height).pictures
    prepared, window = as_its_loader(pictures)
    wide, tall = network_size(width, height)
    image = Image.fromarray(pictures[0]).resize((wide, tall), Image.Resampling.LANCZOS)
    assert prepared.dtype == torch.float32
    np.testing.assert_allclose(prepared[0].movedim(0, -1).numpy(), np.asarray(image) / 255, atol=1e-6)
    np.testing.assert_allclose(window.scale, [wide / width, tall / height])
    assert (window.width, window.height) == (wide, tall)


def test_a_lens_is_the_least_squares_of_rays_that_are_not_quite_a_lens():
    """Against a solver, over points that scatter, with sides of different focal lengths."""
    g = np.random.default_rng(0)
    y, x = np.mgrid[0:20, 0:30] + 0.5
    slopes = np.stack([(x - 15) / 40, (y - 10) / 35], -1) + 0.01 * g.standard_normal((20, 30, 2))
    z = g.uniform(1, 3, (20, 30))
    ((fx, _, cx), (_, fy, cy), _) = fitted_lenses(np.concatenate([slopes * z[..., None], z[..., None]], -1)[None])[0]
    for focal, slope, offset in ((fx, slopes[..., 0], x - 15), (fy, slopes[..., 1], y - 10)):
        assert focal == pytest.approx(np.linalg.lstsq(slope.reshape(-1, 1), offset.ravel())[0][0], rel=1e-12)
    assert (cx, cy) == (15, 10)


@pytest.mark.parametrize("known", ["nothing", "cameras"])
def test_an_answer_of_other_conventions_is_refused(shown, known):
    scene, config = shown(40, 30, 3, known=known)
    Answering.said["camera_poses"] = torch.linalg.inv(Answering.said["camera_poses"])
    with pytest.raises(ValueError, match=r"its own cameras see .* px from their pixels.*has other conventions"):
        found(scene, config)


def test_a_package_that_takes_and_gives_cameras_the_other_way_round_is_refused(shown, answered):
    """Its cameras agree with those it was told, and its depths belong to their inverses."""
    scene, config = shown(40, 30, 3, known="cameras")
    viewmats = np.array(scene.rig.viewmats)
    inverse = np.stack([np.linalg.inv(v @ np.linalg.inv(viewmats[0])) @ viewmats[0] for v in viewmats])
    wrong = answered(
        replace(scene, rig=replace(scene.rig, viewmats=inverse)), Answering.answer.Ks, *network_size(40, 30)
    )
    right = Answering.answer
    seen = np.einsum("cij,chwj->chwi", right.poses[:, :3, :3], wrong.local) + right.poses[:, None, None, :3, 3]
    for key, value in (("local_points", wrong.local), ("points", seen)):
        Answering.said[key] = torch.tensor(value, dtype=torch.float32)[None]
    with pytest.raises(ValueError, match=r"if cameras were camera-to-world .* has other conventions"):
        found(scene, config)


def test_doubtful_points_give_none_and_the_seed_chooses(shown):
    scene, config = shown(40, 30, known="cameras")
    said, wrong = Answering.said, torch.zeros_like(Answering.said["conf"], dtype=torch.bool)
    wrong[..., :100, :] = True  # a sixth, of which no depth is right
    said["conf"] = torch.where(wrong, -9.0, said["conf"])
    said["local_points"] = torch.where(wrong, 3 * said["local_points"], said["local_points"])
    state = torch.random.get_rng_state()
    one, two, other = (found(scene, config, 3000, seed) for seed in (3, 3, 4))
    assert torch.equal(state, torch.random.get_rng_state())
    assert scene.distance(one.points.numpy()).max() < 1e-5
    assert torch.equal(one.points, two.points)
    assert not torch.equal(one.points, other.points)
    mine, again, others = Answering.drawn  # the network's own draws follow the seed as well
    assert torch.equal(mine, again)
    assert not torch.equal(mine, others)


def test_what_is_missing_is_said_in_one_line_with_licence_and_place(shown, package, monkeypatch):
    scene, config = shown(40, 30)
    with pytest.raises(ValueError, match=r"does not hold the weights of pi3x: .*metric_token.*pi3:network=NAME says"):
        found(scene, replace(config, checkpoint=package / "pi3.safetensors"))
    with pytest.raises(ValueError, match=r"does not hold the weights of pi3: .*; pi3:network=NAME says"):
        found(scene, replace(config, network="pi3"))
    for network, place in (("pi3x", "Pi3X"), ("pi3", "Pi3")):
        with pytest.raises(
            ValueError, match=rf"no PI3 weights at .*yyfz233/{place} from Hugging Face \(CC BY-NC 4.0: non"
        ):
            found(scene, replace(config, checkpoint=package / "none", network=network))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"package pi3, which is not installed: .*yyfz/Pi3.*\(BSD-3-Clause\)"):
        found(scene, config)


def test_what_does_not_fit_is_refused(package):
    file = package / "pi3.safetensors"
    assert parse_cameras(f"pi3:checkpoint={file},network=pi3") == Pi3Config(checkpoint=file, network="pi3")
    with pytest.raises(ValueError, match=r"the network pi3 cannot be told known cameras, got known=lenses: .*pi3x"):
        Pi3Config(checkpoint=file, network="pi3", known="lenses")
    with pytest.raises(ValueError, match="network of pi3 must be one of pi3, pi3x, got 'pi4'"):
        Pi3Config(checkpoint=file, network="pi4")  # type: ignore[arg-type]
