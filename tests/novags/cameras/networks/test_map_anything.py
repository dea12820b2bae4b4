"""The adapter to MapAnything against a stand-in with the interface of the real package, over a scene it knows.

Signatures, shapes and conventions are those of github.com/facebookresearch/map-anything of March 2026 (f7ebafb4), read
in its sources.
"""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import save_file

from novags.cameras import parse_cameras
from novags.cameras.align import align
from novags.cameras.networks.map_anything import as_its_loader, map_anything_cameras
from novags.cameras.sources.map_anything import MapAnythingConfig

# Pictures, and what the package makes of them: wide, tall, square, larger, and ones that are cropped.
SIZES = {(40, 30): (518, 392), (40, 60): (336, 518), (96, 96): (518, 518), (800, 600): (518, 392), (60, 50): (518, 392),
         (90, 20): (518, 168)}  # fmt: skip
MEAN, DEVIATION = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
CONFIG = {
    "name": "mapanything", "encoder_config": {"size": "giant", "uses_torch_hub": True},
    "info_sharing_config": {"module_args": {"depth": 16, "pretrained_checkpoint_path": "/theirs/weights.pth"}},
    "pred_head_config": {}, "geometric_input_config": {"overall_prob": 0}, "info_sharing_mlp_layer_str": "swiglufused",
    "pretrained_checkpoint_path": "/theirs/all.pth",
}  # fmt: skip
ALLOWED = {"img", "data_norm_type", "depth_z", "ray_directions", "intrinsics", "camera_poses", "is_metric_scale",
           "true_shape", "idx", "instance"}  # fmt: skip


class StandIn(torch.nn.Module):
    """`mapanything.models.MapAnything`: says what a test sets, and knows what it may be told."""

    answer: Any = None
    said: dict[str, Any] = {}
    told_as: Any = None
    asked: list[set[str]] = []
    drawn: list[torch.Tensor] = []
    broken = False

    def __init__(
        self, name, encoder_config, info_sharing_config, pred_head_config, geometric_input_config,
        fusion_norm_layer=torch.nn.LayerNorm, pretrained_checkpoint_path=None,
        load_specific_pretrained_submodules=False, specific_pretrained_submodules=None, torch_hub_force_reload=False,
        use_register_tokens_from_encoder=False, info_sharing_mlp_layer_str="mlp",
    ) -> None:  # fmt: skip
        super().__init__()
        if self.broken:
            raise OSError("urlopen error: no route to host")
        # Each of these would be read by `torch.load(..., weights_only=False)`.
        assert pretrained_checkpoint_path is None
        assert info_sharing_config["module_args"] == {"depth": 16, "pretrained_checkpoint_path": None}
        assert encoder_config == {"size": "giant", "uses_torch_hub": True, "torch_hub_pretrained": False}
        assert info_sharing_mlp_layer_str == "swiglufused"
        self.weight = torch.nn.Parameter(torch.rand(2))

    def infer(
        self, views, memory_efficient_inference=True, minibatch_size=None, use_amp=True, amp_dtype="bf16",
        apply_mask=True, mask_edges=True, edge_normal_threshold=5.0, edge_depth_threshold=0.03,
        apply_confidence_mask=False, confidence_percentile=10, ignore_calibration_inputs=False,
        ignore_depth_inputs=False, ignore_pose_inputs=False, ignore_depth_scale_inputs=False,
        ignore_pose_scale_inputs=False, use_multiview_confidence=False, multiview_conf_depth_abs_thresh=0.02,
        multiview_conf_depth_rel_thresh=0.02,
    ) -> list[dict[str, torch.Tensor]]:  # fmt: skip
        assert (use_amp, minibatch_size, apply_mask, mask_edges) == (False, 1, True, True)
        assert not self.training
        self.drawn.append(torch.rand(3))  # as it does, to decide what is certain
        torch.testing.assert_close(self.weight.detach(), torch.tensor([1.0, 2.0]))
        told, shape = self.answer, self.answer.depths.shape
        assert len(views) == shape[0]
        for view in views:
            assert set(view) <= ALLOWED
            assert view["img"].dtype == torch.float32
            assert view["img"].shape == (1, 3, *shape[1:])
            assert view["data_norm_type"] == ["dinov2"]
            self.asked.append(set(view))
        if "intrinsics" in views[0]:
            given = torch.cat([view["intrinsics"] for view in views])
            assert given.dtype == torch.float32
            # It sends a ray through each pixel at whole numbers.
            np.testing.assert_allclose(given.numpy(), told.Ks - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]], rtol=1e-6)
        if "camera_poses" in views[0]:
            assert all(view["is_metric_scale"].tolist() == [False] for view in views)
            type(self).told_as(torch.cat([view["camera_poses"] for view in views]), told)
        return [{key: value[i : i + 1] for key, value in self.said.items()} for i in range(shape[0])]


def network_view(width: int, height: int) -> tuple[float, tuple[int, int], tuple[int, int]]:
    """Scale, size and offset of what the network sees, written out."""
    wide, tall = SIZES[width, height]
    scale = max(wide / width, tall / height)
    return scale, (wide, tall), (int(round(width * scale, 6)) - wide, int(round(height * scale, 6)) - tall)


@pytest.fixture
def package(installed, tmp_path, monkeypatch, told_as):
    installed({"mapanything.models": {"MapAnything": StandIn}})
    save_file({"weight": torch.tensor([1.0, 2.0]), "unused": torch.zeros(1)}, tmp_path / "model.safetensors")
    (tmp_path / "config.json").write_text(json.dumps(CONFIG))
    monkeypatch.setattr(StandIn, "asked", [])
    monkeypatch.setattr(StandIn, "drawn", [])
    monkeypatch.setattr(StandIn, "told_as", staticmethod(told_as))
    return tmp_path / "model.safetensors"


@pytest.fixture
def shown(corner, package, answered):
    """A corner of a room, and the configuration that runs the stand-in on it, whose answer is right."""

    def make(width: int, height: int, count: int = 2, **settings) -> tuple[Any, MapAnythingConfig]:
        scene = corner(count, width, height)
        _, (wide, tall), _ = network_view(width, height)
        _, window = as_its_loader(scene.pictures)  # which a test of its own compares with the package's
        Ks = scene.rig.Ks.copy()
        Ks[:, :2] *= window.scale[:, None]
        Ks[:, :2, 2] -= window.offset
        answer = StandIn.answer = answered(scene, Ks, wide, tall)
        StandIn.said = as_said(answer)
        return scene, MapAnythingConfig(checkpoint=package, **settings)

    return make


def as_said(answer: Any) -> dict[str, torch.Tensor]:
    """As `infer` returns it: pixel centres at 0, 1, ...; a twentieth of the pixels are masked, which sets them to 0."""
    seen = np.random.default_rng(1).random(answer.depths.shape) > 0.05
    said = {
        "camera_poses": answer.poses, "intrinsics": answer.Ks - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]],
        "depth_z": (answer.depths * seen)[..., None], "pts3d": answer.points * seen[..., None],
        "conf": answer.confidence,
    }  # fmt: skip
    return {key: torch.tensor(value, dtype=torch.float32) for key, value in said.items()}


def found(scene: Any, config: MapAnythingConfig, count: int = 1000, seed: int = 0) -> Any:
    dark = torch.from_numpy(scene.pictures.astype(np.float32) / 2550)
    return map_anything_cameras(scene.pictures, scene.rig, dark, n_points=count, config=config, seed=seed)


@pytest.mark.parametrize(("width", "height"), [(40, 30), (60, 50), (90, 20)])
@pytest.mark.parametrize("known", ["nothing", "lenses", "cameras"])
def test_cameras_lenses_and_points_are_right_and_known_ones_the_sets_own(shown, width, height, known):
    scene, config = shown(width, height, 3, known=known)
    got = found(scene, config, 4000)
    assert got.registered == (0, 1, 2)
    assert got.made_of == {"of the network's depths": 4000}
    assert StandIn.asked[0] - {"img", "data_norm_type"} == {
        "nothing": set(), "lenses": {"intrinsics"}, "cameras": {"intrinsics", "camera_poses", "is_metric_scale"},
    }[known]  # fmt: skip
    if known == "nothing":
        np.testing.assert_allclose(got.Ks.numpy(), scene.rig.Ks, rtol=2e-6, atol=1e-5)
    else:
        np.testing.assert_array_equal(got.Ks.numpy(), scene.rig.Ks)
    fitted = align(got.viewmats, torch.from_numpy(np.array(scene.rig.viewmats)))
    if known == "cameras":
        np.testing.assert_array_equal(got.viewmats.numpy(), scene.rig.viewmats)
    else:
        np.testing.assert_allclose(got.viewmats[0].numpy(), np.eye(4), atol=1e-7)
        assert fitted.similarity.scale == pytest.approx(1 / 1.7, rel=1e-6)
        assert fitted.rotation_deg.max() < 1e-4
        assert fitted.centre_error.max() < 1e-5
    assert scene.distance(fitted.similarity.apply(got.points).numpy()).max() < 1e-5


@pytest.mark.parametrize(("width", "height"), list(SIZES))
def test_pictures_are_prepared_as_the_loader_of_the_package_does(corner, width, height):
    pictures = corner(1, width, height).pictures
    prepared, window = as_its_loader(pictures)
    scale, (wide, tall), spare = network_view(width, height)
    assert min(spare) == 0
    scaled = (wide + spare[0], tall + spare[1])
    resample = Image.Resampling.LANCZOS if scale < 1 else Image.Resampling.BICUBIC
    image = Image.fromarray(pictures[0]).resize(scaled, resample)
    left, top = spare[0] // 2, spare[1] // 2
    want = np.asarray(image.crop((left, top, left + wide, top + tall)), np.float64) / 255
    assert prepared.dtype == torch.float32
    np.testing.assert_allclose(prepared[0].movedim(0, -1).numpy(), (want - MEAN) / DEVIATION, atol=1e-5)
    np.testing.assert_allclose(window.scale, [scaled[0] / width, scaled[1] / height])
    np.testing.assert_array_equal(window.offset, [left, top])
    assert (window.width, window.height) == (wide, tall)


def test_an_answer_of_other_conventions_is_refused(shown):
    scene, config = shown(40, 30, 3)
    right = StandIn.said["camera_poses"]
    StandIn.said["camera_poses"] = torch.linalg.inv(right)
    with pytest.raises(ValueError, match=r"its own cameras see .* px from their pixels.*has other conventions"):
        found(scene, config)
    StandIn.said["camera_poses"], StandIn.said["conf"] = right, StandIn.said["conf"][..., None]
    with pytest.raises(
        ValueError, match=r"returned confidence \[3, 392, 518, 1\], expected \[3, 392, 518\]: this version"
    ):
        found(scene, config)


def test_a_lens_that_is_not_the_one_it_was_told_is_refused(shown, answered):
    scene, config = shown(40, 30)
    longer = StandIn.answer.Ks * np.array([1.3, 1.3, 1])[:, None]
    longer[:, :2, 2] /= 1.3
    StandIn.said = as_said(answered(scene, longer, 518, 392))
    with pytest.raises(ValueError, match=r"map-anything was told the lenses and returned others, .* factor of 1\.3 \("):
        found(scene, config)
    assert len(found(scene, replace(config, known="nothing")).points) == 1000  # whose word is then all there is


def test_cameras_other_than_it_was_told_give_no_scale(shown):
    scene, config = shown(40, 30, 3, known="cameras")
    right = StandIn.said["camera_poses"]
    turned = right.clone()
    turned[1:] = torch.linalg.inv(right[1:])
    StandIn.said["camera_poses"] = turned
    StandIn.said["pts3d"] = torch.tensor(
        np.einsum("cij,chwj->chwi", turned[:, :3, :3].numpy(), StandIn.answer.local)
    ).float() + turned[:, None, None, :3, 3]  # fmt: skip
    with pytest.raises(ValueError, match=r"was told the cameras and returned others, .* degrees from them"):
        found(scene, config)
    StandIn.said["camera_poses"] = torch.eye(4).repeat(3, 1, 1)
    StandIn.said["pts3d"] = torch.tensor(StandIn.answer.local).float()
    with pytest.raises(ValueError, match=r"map-anything cannot scale its depths by the known cameras: the estimated"):
        found(scene, config)


def test_masked_and_doubtful_depths_give_no_points_and_the_seed_chooses(shown):
    scene, config = shown(40, 30, known="cameras")
    wrong = torch.zeros_like(StandIn.said["conf"], dtype=torch.bool)
    wrong[..., :100] = True  # a fifth, of which no depth is right
    StandIn.said["conf"] = torch.where(wrong, 0.5, StandIn.said["conf"])
    StandIn.said["depth_z"] = torch.where(wrong[..., None], 3 * StandIn.said["depth_z"], StandIn.said["depth_z"])
    state = torch.random.get_rng_state()
    one, two, other = (found(scene, config, 3000, seed) for seed in (3, 3, 4))
    assert torch.equal(state, torch.random.get_rng_state())
    assert scene.distance(one.points.numpy()).max() < 1e-5
    assert torch.equal(one.points, two.points)
    assert not torch.equal(one.points, other.points)
    mine, again, others = StandIn.drawn  # the network's own draws follow the seed as well
    assert torch.equal(mine, again)
    assert not torch.equal(mine, others)
    StandIn.said["depth_z"] = 0 * StandIn.said["depth_z"]
    with pytest.raises(ValueError, match="no positive depth"):
        found(scene, config)


def test_what_is_missing_is_said_in_one_line_with_licence_and_place(shown, package, tmp_path, monkeypatch):
    scene, config = shown(40, 30)
    save_file({"unused": torch.zeros(1)}, tmp_path / "other.safetensors")
    with pytest.raises(
        ValueError, match=r"other.safetensors does not hold the weights of MapAnything: 1 of its tensors"
    ):
        found(scene, replace(config, checkpoint=tmp_path / "other.safetensors"))
    place = r"no MAP-ANYTHING weights at .*facebook/map-anything-apache from Hugging Face.*Apache-2.0; of facebook/"
    with pytest.raises(ValueError, match=place + "map-anything: CC BY-NC 4.0.*map-anything:checkpoint=FILE"):
        found(scene, replace(config, checkpoint=tmp_path / "none.safetensors"))
    monkeypatch.setattr(StandIn, "broken", True)
    with pytest.raises(ValueError, match=r"cannot be made as .*config.json says: urlopen error.*through torch.hub"):
        found(scene, config)
    (tmp_path / "config.json").unlink()
    with pytest.raises(ValueError, match=r"no config.json beside .*model.safetensors: .* download it too"):
        found(scene, config)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        ValueError, match=r"package mapanything, which is not installed: .*map-anything .*\(Apache-2.0\)"
    ):
        found(scene, config)


def test_what_does_not_fit_is_refused(shown, package):
    scene, config = shown(40, 30, 1, known="cameras")
    assert parse_cameras(f"map-anything:checkpoint={package},known=cameras") == config
    assert MapAnythingConfig(checkpoint=package).known == "lenses"
    with pytest.raises(ValueError, match="known of map-anything must be one of nothing, lenses, cameras, got 'all'"):
        MapAnythingConfig(checkpoint=package, known="all")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"pictures must be uint8 \[C >= 2"):
        found(scene, config)
    assert len(found(scene, replace(config, known="lenses")).points) == 1000
