"""The adapter to VGGT-Ω against a stand-in with the interface of the real package, over a scene it knows.

The package is for non-commercial research, so its sources were not read: names, shapes and conventions are facts about
its version of May 2026.
"""

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from novags.cameras import parse_cameras
from novags.cameras.align import align
from novags.cameras.networks.vggt_omega import as_its_loader, vggt_omega_cameras
from novags.cameras.sources.vggt_omega import VggtOmegaConfig

# Pictures, the size that they get, and the part of it that is kept: wide, tall, square, larger, and longer than 2:1.
SIZES = {
    (60, 40): ((624, 416), (624, 416)), (30, 40): ((448, 592), (448, 592)), (96, 96): ((512, 512), (512, 512)),
    (900, 600): ((624, 416), (624, 416)), (90, 30): ((1080, 368), (720, 368)), (30, 120): ((368, 1440), (368, 720)),
}  # fmt: skip


class VGGTOmega(torch.nn.Module):
    """Says what a test sets, in a precision that depends on the device alone."""

    said: dict[str, torch.Tensor] = {}
    precisions: set[torch.dtype] = set()

    def __init__(self, enable_alignment: bool = False) -> None:
        super().__init__()
        assert not enable_alignment
        self.weight = torch.nn.Parameter(torch.rand(2))

    def forward(self, images):
        assert images.dtype == torch.float32
        assert images.shape == (1, self.said["depth"].shape[1], 3, *self.said["depth"].shape[2:4])
        assert 0 <= float(images.min()) < float(images.max()) <= 1
        assert not self.training
        assert not torch.is_grad_enabled()
        torch.testing.assert_close(self.weight.detach(), torch.tensor([1.0, 2.0]))
        half = torch.bfloat16 if torch.cuda.is_bf16_supported() else torch.float16
        with torch.autocast("cuda", dtype=half):
            self.precisions.add((images[0, 0, 0] @ images[0, 0, 0].T).dtype)
        return dict(self.said)


def encoding_to_camera(encoding: torch.Tensor, size: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
    """[1, N, 9]: translation, quaternion with the scalar last, fields of view of the height and of the width."""
    values = encoding[0].double().numpy()
    turns = Rotation.from_quat(values[:, 3:7]).as_matrix()
    Ks = np.tile(np.eye(3), (len(values), 1, 1))
    for axis, column in ((0, 8), (1, 7)):
        Ks[:, axis, axis] = size[1 - axis] / 2 / np.tan(values[:, column] / 2)
        Ks[:, axis, 2] = size[1 - axis] / 2
    return torch.tensor(np.concatenate([turns, values[:, :3, None]], 2))[None].float(), torch.tensor(Ks)[None].float()


@pytest.fixture
def package(installed, tmp_path, monkeypatch):
    installed({
        "vggt_omega.models": {"VGGTOmega": VGGTOmega},
        "vggt_omega.utils.pose_enc": {"encoding_to_camera": encoding_to_camera},
    })  # fmt: skip
    torch.save({"weight": torch.tensor([1.0, 2.0])}, tmp_path / "vggt_omega_1b_512.pt")
    monkeypatch.setattr(VGGTOmega, "precisions", set())
    return tmp_path / "vggt_omega_1b_512.pt"


@pytest.fixture
def shown(corner, package, answered):
    """A corner of a room, and the configuration that runs the stand-in on it, whose answer is right."""

    def make(width: int, height: int, count: int = 2) -> tuple[Any, VggtOmegaConfig]:
        scene = corner(count, width, height)
        scaled, (wide, tall) = SIZES[width, height]
        Ks = scene.rig.Ks * np.array([scaled[0] / width, scaled[1] / height, 1])[:, None]
        Ks[:, :2, 2] -= [(scaled[0] - wide) / 2, (scaled[1] - tall) / 2]
        answer = answered(scene, Ks, wide, tall)
        viewmats = np.linalg.inv(answer.poses)
        fields = 2 * np.arctan([tall / 2 / Ks[:, 1, 1], wide / 2 / Ks[:, 0, 0]]).T
        turns = Rotation.from_matrix(viewmats[:, :3, :3]).as_quat()
        said = {"pose_enc": np.concatenate([viewmats[:, :3, 3], turns, fields], 1), "depth": answer.depths[..., None],
                "depth_conf": answer.confidence}  # fmt: skip
        VGGTOmega.said = {key: torch.tensor(value, dtype=torch.float32)[None] for key, value in said.items()}
        return scene, VggtOmegaConfig(checkpoint=package)

    return make


def found(scene: Any, config: VggtOmegaConfig, count: int = 1000, seed: int = 0) -> Any:
    dark = torch.from_numpy(scene.pictures.astype(np.float32) / 2550)
    return vggt_omega_cameras(scene.pictures, dark, n_points=count, config=config, seed=seed)


@pytest.mark.parametrize(("width", "height"), [(60, 40), (30, 40), (90, 30), (30, 120)])
def test_cameras_intrinsics_and_points_are_the_networks_at_the_size_of_the_pictures(shown, width, height):
    scene, config = shown(width, height)
    got = found(scene, config, 4000)
    assert VGGTOmega.precisions == {torch.float32}
    assert got.registered == (0, 1)
    np.testing.assert_allclose(got.Ks.numpy(), scene.rig.Ks, rtol=2e-6)
    fitted = align(got.viewmats, torch.from_numpy(np.array(scene.rig.viewmats)))
    assert fitted.similarity.scale == pytest.approx(1 / 1.7, rel=1e-6)
    assert fitted.rotation_deg.max() < 1e-4
    assert fitted.centre_error.max() < 1e-5
    assert scene.distance(fitted.similarity.apply(got.points).numpy()).max() < 1e-5


@pytest.mark.parametrize(("width", "height"), list(SIZES))
def test_pictures_have_about_1024_patches_and_are_cut_beyond_two_to_one(corner, width, height):
    pictures = corner(1, width, height).pictures
    prepared, window = as_its_loader(pictures)
    scaled, (wide, tall) = SIZES[width, height]
    left, top = (scaled[0] - wide) // 2, (scaled[1] - tall) // 2
    image = Image.fromarray(pictures[0]).resize(scaled, Image.Resampling.BICUBIC)
    want = np.asarray(image.crop((left, top, left + wide, top + tall)), np.float64) / 255
    assert prepared.dtype == torch.float32
    np.testing.assert_allclose(prepared[0].movedim(0, -1).numpy(), want, atol=1e-6)
    np.testing.assert_allclose(window.scale, [scaled[0] / width, scaled[1] / height])
    np.testing.assert_array_equal(window.offset, [left, top])
    assert wide % 16 == tall % 16 == 0
    assert wide * tall / 256 == pytest.approx(1024, rel=0.03)


def test_cameras_of_another_convention_are_refused(shown, monkeypatch):
    scene, config = shown(60, 40, 3)

    def inverse(encoding: torch.Tensor, size: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
        extrinsics, intrinsics = encoding_to_camera(encoding, size)
        turned = extrinsics[..., :3].mT
        return torch.cat([turned, -turned @ extrinsics[..., 3:]], -1), intrinsics

    module = sys.modules["vggt_omega.utils.pose_enc"]
    monkeypatch.setattr(module, "encoding_to_camera", inverse)
    with pytest.raises(ValueError, match=r"if cameras were camera-to-world .* has other conventions"):
        found(scene, config)
    monkeypatch.setattr(module, "encoding_to_camera", lambda *given: encoding_to_camera(*given)[::-1])
    with pytest.raises(ValueError, match=r"vggt-omega returned viewmats \[3, 3, 3\], expected \[3, 3, 4\]"):
        found(scene, config)


def test_doubtful_depths_give_no_points_and_the_seed_chooses(shown):
    scene, config = shown(60, 40)
    said, wrong = VGGTOmega.said, torch.zeros_like(VGGTOmega.said["depth_conf"], dtype=torch.bool)
    wrong[..., :120] = True  # a fifth, of which no depth is right
    said["depth_conf"] = torch.where(wrong, 1.0, said["depth_conf"] + 1)
    said["depth"] = torch.where(wrong[..., None], 3 * said["depth"], said["depth"])
    one, two, other = (found(scene, config, 2000, seed) for seed in (3, 3, 4))
    there = align(one.viewmats, torch.from_numpy(np.array(scene.rig.viewmats))).similarity
    assert scene.distance(there.apply(one.points).numpy()).max() < 1e-5
    assert torch.equal(one.points, two.points)
    assert not torch.equal(one.points, other.points)


def test_what_is_missing_is_said_in_one_line_with_licence_and_place(shown, package, tmp_path, monkeypatch):
    scene, config = shown(60, 40)
    assert parse_cameras(f"vggt-omega:checkpoint={package}") == config
    torch.save({"weight": torch.zeros(2), "alignment": torch.zeros(1)}, tmp_path / "vggt_omega_1b_256_text.pt")
    with pytest.raises(ValueError, match=r"does not hold the weights of this VGGTOmega: .*only vggt_omega_1b_512.pt"):
        found(scene, replace(config, checkpoint=tmp_path / "vggt_omega_1b_256_text.pt"))
    with pytest.raises(ValueError, match=r"no VGGT-OMEGA weights at .*facebook/VGGT-Omega from .*FAIR Noncommercial"):
        found(scene, replace(config, checkpoint=tmp_path / "none.pt"))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        ValueError, match=r"package vggt_omega, which is not installed: .*vggt-omega.*FAIR Noncommercial"
    ):
        found(scene, config)
