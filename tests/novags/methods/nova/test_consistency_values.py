"""Reprojection against a loop over pixels, and which images, cameras and depths the loss brings together.

The two cameras differ in every way: pose, focal lengths, principal points, and size of the image where that may be.
"""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from novags.methods.nova.config import ConsistencyConfig
from novags.methods.nova.consistency import (
    ConfidenceNet,
    ConsistencyLoss,
    Pinhole,
    consistency_loss,
    reproject,
    source_candidates,
)
from novags.splats.views import Views

TARGET_SIZE, SOURCE_SIZE = (9, 14), (12, 11)  # height, width


def rotation(x: float, y: float, z: float) -> np.ndarray:
    """Turns about the axes, in radians, one after another."""
    out = np.eye(3)
    for axis, angle in enumerate((x, y, z)):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = math.cos(angle)
        turn[i, j], turn[j, i] = -math.sin(angle), math.sin(angle)
        out = turn @ out
    return out


def camera(turn: tuple[float, float, float], shift: tuple[float, float, float], K: list[list[float]]) -> Pinhole:
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation(*turn), shift
    return Pinhole(torch.from_numpy(viewmat), torch.tensor(K, dtype=torch.float64))


TARGET = camera((0.05, -0.1, 0.02), (0.1, -0.2, 0.3), [[14.0, 0, 7.5], [0, 12.0, 4.0], [0, 0, 1]])
SOURCE = camera((-0.03, 0.08, -0.05), (-0.3, 0.1, 0.1), [[11.0, 0, 5.0], [0, 13.0, 6.5], [0, 0, 1]])


def depth_of_plane(view: Pinhole, size: tuple[int, int], normal=(0.1, 0.2, 1.0), offset=4.0) -> np.ndarray:
    """z-depth of the world plane normal . X = offset."""
    R, t, K = view.viewmat[:3, :3].numpy(), view.viewmat[:3, 3].numpy(), view.K.numpy()
    out = np.empty(size)
    for row, column in np.ndindex(size):
        ray = np.linalg.solve(K, [column + 0.5, row + 0.5, 1])
        # X = R' (z ray - t)
        out[row, column] = (offset + np.dot(normal, R.T @ t)) / np.dot(normal, R.T @ ray)
    return out


def read(image: np.ndarray, x: float, y: float) -> np.ndarray:
    """Bilinear between pixel centres at +0.5, the border repeated."""
    u, v = np.clip(x - 0.5, 0, image.shape[1] - 1), np.clip(y - 0.5, 0, image.shape[0] - 1)
    left, top = int(u), int(v)
    right, below = min(left + 1, image.shape[1] - 1), min(top + 1, image.shape[0] - 1)
    upper = image[top, left] * (1 - (u - left)) + image[top, right] * (u - left)
    lower = image[below, left] * (1 - (u - left)) + image[below, right] * (u - left)
    return upper * (1 - (v - top)) + lower * (v - top)


def world(view: Pinhole, x: float, y: float, depth: float) -> np.ndarray:
    point = depth * np.linalg.solve(view.K.numpy(), [x, y, 1])
    return view.viewmat[:3, :3].numpy().T @ (point - view.viewmat[:3, 3].numpy())


def seen(view: Pinhole, point: np.ndarray) -> tuple[float, float, float]:
    """x, y, depth."""
    local = view.viewmat[:3, :3].numpy() @ point + view.viewmat[:3, 3].numpy()
    x, y, w = view.K.numpy() @ local
    return x / w, y / w, local[2]


def by_hand(source, depth_t, depth_s, target_camera, source_camera, tolerance=0.1) -> tuple[np.ndarray, np.ndarray]:
    warped, mask = np.zeros((*depth_t.shape, source.shape[-1])), np.zeros(depth_t.shape, bool)
    height, width = depth_s.shape
    for row, column in np.ndindex(depth_t.shape):
        depth = depth_t[row, column]
        x, y, ahead = seen(source_camera, world(target_camera, column + 0.5, row + 0.5, depth))
        if depth <= 0 or ahead <= 0:
            continue
        warped[row, column] = read(source, x, y)
        there = read(depth_s, x, y)
        _, _, z_t = seen(target_camera, world(source_camera, x, y, there))
        inside = 0.5 < x < width - 0.5 and 0.5 < y < height - 0.5
        mask[row, column] = inside and there > 0 and z_t > 0 and abs(depth - z_t) / z_t < tolerance
    return warped, mask


def tensors(*arrays: np.ndarray) -> list[torch.Tensor]:
    return [torch.from_numpy(array) for array in arrays]


@pytest.mark.parametrize("tolerance", [0.1, 0.02])
def test_reprojection_equals_the_loop_over_pixels(tolerance):
    rng = np.random.default_rng(0)
    source = rng.uniform(0, 1, (*SOURCE_SIZE, 3))
    depth_t = depth_of_plane(TARGET, TARGET_SIZE) * rng.uniform(0.9, 1.1, TARGET_SIZE)
    depth_s = depth_of_plane(SOURCE, SOURCE_SIZE) * rng.uniform(0.95, 1.05, SOURCE_SIZE)
    depth_t[2, 3], depth_s[5, 6] = 0, -1
    expected, expected_mask = by_hand(source, depth_t, depth_s, TARGET, SOURCE, tolerance)
    warped, mask = reproject(*tensors(source, depth_t, depth_s), TARGET, SOURCE, tolerance)
    assert 0.1 < expected_mask.mean() < 0.9
    np.testing.assert_array_equal(mask, expected_mask)
    np.testing.assert_allclose(warped.numpy()[expected_mask], expected[expected_mask], rtol=1e-9)


def test_a_tilted_plane_with_true_depths_is_nowhere_occluded():
    depths = depth_of_plane(TARGET, TARGET_SIZE), depth_of_plane(SOURCE, SOURCE_SIZE)
    source = np.ones((*SOURCE_SIZE, 3))
    # The source's depth is read between its pixels: a few per mille off, far from a tenth.
    _, loose = reproject(*tensors(source, *depths), TARGET, SOURCE, 0.1)
    _, strict = reproject(*tensors(source, *depths), TARGET, SOURCE, 0.01)
    assert torch.equal(loose, strict)
    assert loose.double().mean() > 0.4


def test_the_warp_reads_the_homography_of_the_plane():
    """Rationale: of a plane n . X = d in the target's frame, x_s ~ K_s (R + t n' / d) K_t^-1 x_t."""
    change = SOURCE.viewmat @ torch.linalg.inv(TARGET.viewmat)
    R_t, t_t = TARGET.viewmat[:3, :3].numpy(), TARGET.viewmat[:3, 3].numpy()
    normal = R_t @ np.array([0.1, 0.2, 1.0])
    distance = 4.0 + normal @ t_t
    rigid = change[:3, :3].numpy() + np.outer(change[:3, 3].numpy(), normal) / distance
    H = SOURCE.K.numpy() @ rigid @ np.linalg.inv(TARGET.K.numpy())
    y, x = np.meshgrid(np.arange(SOURCE_SIZE[0]) + 0.5, np.arange(SOURCE_SIZE[1]) + 0.5, indexing="ij")
    coordinates = np.stack([x, y, x * 0], -1)  # an image that shows where it was read
    depths = depth_of_plane(TARGET, TARGET_SIZE), depth_of_plane(SOURCE, SOURCE_SIZE)
    warped, mask = reproject(*tensors(coordinates, *depths), TARGET, SOURCE)
    for row, column in mask.nonzero().tolist():
        u, v, w = H @ [column + 0.5, row + 0.5, 1]
        np.testing.assert_allclose(warped[row, column, :2], [u / w, v / w], rtol=1e-9)


def test_gradients_reach_the_target_depth_and_not_the_source_depth():
    depth_t, depth_s = tensors(depth_of_plane(TARGET, TARGET_SIZE), depth_of_plane(SOURCE, SOURCE_SIZE))
    depth_t.requires_grad_(), depth_s.requires_grad_()
    source = torch.rand(*SOURCE_SIZE, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    reproject(source, depth_t, depth_s, TARGET, SOURCE)[0].sum().backward()
    assert (depth_t.grad != 0).any()
    assert depth_s.grad is None


def test_a_view_of_a_set_has_its_own_pose_and_intrinsics():
    viewmats, Ks = torch.eye(4).repeat(3, 1, 1), torch.eye(3).repeat(3, 1, 1)
    viewmats[:, 0, 3], Ks[:, 0, 0] = torch.arange(3.0), torch.arange(1.0, 4.0)
    view = Pinhole.of(Views(viewmats, Ks, 4, 4), 2)
    assert torch.equal(view.viewmat, viewmats[2])
    assert torch.equal(view.K, Ks[2])


def convolve(x: np.ndarray, weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Zero padding keeps the size."""
    reach = weight.shape[-1] // 2
    padded = np.pad(x, ((0, 0), (reach, reach), (reach, reach)))
    out = np.empty((len(weight), *x.shape[1:]))
    for row, column in np.ndindex(x.shape[1:]):
        near = padded[:, row : row + weight.shape[-1], column : column + weight.shape[-1]]
        out[:, row, column] = (weight * near).sum((1, 2, 3)) + bias
    return out


def test_the_confidence_network_equals_the_one_written_out():
    torch.manual_seed(1)
    network = ConfidenceNet().double()
    w = {name: value.detach().numpy() for name, value in network.state_dict().items()}
    warped, target = np.random.default_rng(0).uniform(0, 1, (2, 5, 7, 3))
    x = convolve(np.concatenate([warped, target], -1).transpose(2, 0, 1), w["layers.0.weight"], w["layers.0.bias"])
    x = (x - x.mean((1, 2), keepdims=True)) / np.sqrt(x.var((1, 2), keepdims=True) + 1e-5)
    x = np.where(x > 0, x, 0.2 * x)
    x = convolve(x, w["layers.3.weight"], w["layers.3.bias"])
    expected = 1 / (1 + np.exp(-convolve(x, w["layers.4.weight"], w["layers.4.bias"])[0]))
    found = network(*tensors(warped, target)).detach()
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_loss_in_numbers():
    target = torch.tensor([[[0.5, 0.5, 0.5], [0.1, 0.2, 0.3], [1.0, 1.0, 1.0]]])
    warped = torch.tensor([[[0.2, 0.5, 0.8], [0.1, 0.2, 0.6], [0.0, 0.0, 0.0]]])
    confidence, mask = torch.tensor([[0.5, 0.25, 0.9]]), torch.tensor([[True, True, False]])
    # residuals 0.2 and 0.1; photo (0.5 0.2 + 0.25 0.1) / 2; confidence (ln 2 + ln 4) / 2, weighted by 0.3
    expected = (0.1 + 0.025) / 2 + 0.3 * (math.log(2) + math.log(4)) / 2
    assert float(consistency_loss(warped, target, confidence, mask, 0.3)) == pytest.approx(expected, rel=1e-6)


def test_a_confidence_that_underflowed_costs_much_but_not_infinitely():
    one = torch.zeros(1, 1, 3)
    loss = consistency_loss(one, one, torch.zeros(1, 1), torch.ones(1, 1, dtype=torch.bool), 1.0)
    assert float(loss) == pytest.approx(-math.log(1e-7), rel=1e-5)


def looking(centres: list[tuple[float, float, float]], yaws: list[float]) -> Views:
    """Cameras at these places, turned about the vertical axis by these degrees."""
    viewmats = torch.eye(4).repeat(len(centres), 1, 1)
    for i, (centre, yaw) in enumerate(zip(centres, yaws, strict=True)):
        R = rotation(0, math.radians(yaw), 0)
        viewmats[i, :3, :3] = torch.from_numpy(R).float()
        viewmats[i, :3, 3] = torch.from_numpy(-R @ np.array(centre)).float()
    K = torch.tensor([[20.0, 0, 8], [0, 20.0, 6], [0, 0, 1]])
    return Views(viewmats, K.repeat(len(centres), 1, 1), 16, 12)


def candidates_by_hand(views: Views, config: ConsistencyConfig) -> list[list[int]]:
    found = []
    for i in range(len(views)):
        near = []
        for j in range(len(views)):
            distance = float((views.centers[i] - views.centers[j]).double().norm()) / views.extent
            cosine = float(views.viewmats[i, 2, :3].double() @ views.viewmats[j, 2, :3].double())
            angle = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
            if angle < config.max_angle and config.min_distance < distance < config.max_distance:
                near.append((angle if config.pairs == "angle" else distance, j))
        best = [j for _, j in sorted(near)]
        found.append(best if config.pairs == "random" else best[: config.neighbours])
    return found


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"neighbours": 3},
        {"max_angle": 12.0},
        {"min_distance": 0.6},
        {"max_distance": 0.5},
        {"pairs": "angle"},
        {"pairs": "random"},
    ],
    ids=["default", "few", "narrow", "far", "near", "alike", "all"],
)
def test_partners_are_those_that_a_double_loop_finds(changes):
    rng = np.random.default_rng(4)
    centres = [tuple(c) for c in rng.uniform(-1, 1, (14, 3))]
    views = looking([*centres, centres[0]], [*rng.uniform(-25, 25, 14), 0.0])
    config = ConsistencyConfig(**changes)
    expected = candidates_by_hand(views, config)
    assert (expected != candidates_by_hand(views, ConsistencyConfig())) == bool(changes)
    assert source_candidates(views, config) == expected


def test_the_published_and_chosen_constants_are_the_defaults():
    config = ConsistencyConfig()
    assert (config.weight, config.confidence_weight, config.start, config.every) == (1.0, 0.05, 0.25, 1)
    assert (config.occlusion_tolerance, config.min_alpha, config.neighbours) == (0.1, 0.5, 8)
    assert (config.max_angle, config.min_distance, config.max_distance) == (30.0, 0.002, 1.5)
    assert config.learning_rate == 1e-3


class Stage:
    """Three cameras before a wall, with images that differ; the step renders the wall's true depth and some alpha."""

    SIZE = (12, 16)

    def __init__(self) -> None:
        self.views = looking([(-0.4, 0.1, 0.0), (0.0, 0.0, 0.1), (0.5, -0.1, 0.05)], [4.0, 0.0, -6.0])
        generator = torch.Generator().manual_seed(0)
        self.images = torch.rand(3, *self.SIZE, 3, generator=generator)
        self.alphas = torch.rand(3, *self.SIZE, generator=generator)
        cameras = [Pinhole(self.views.viewmats[i].double(), self.views.Ks[i].double()) for i in range(3)]
        self.depths = [depth_of_plane(c, self.SIZE) * (1 + 0.01 * i) for i, c in enumerate(cameras)]
        self.cameras = cameras

    def step(self, view: int, iteration: int) -> SimpleNamespace:
        depths = [torch.from_numpy(d).float() for d in self.depths]
        return SimpleNamespace(
            view=view, iteration=iteration, views=self.views, depth=depths[view], alpha=self.alphas[view],
            rasterize_view=lambda j: (self.images[j] * 0, depths[j], self.alphas[j], {}),
        )  # fmt: skip

    def loss(self, iterations: int = 100, seed: int = 0, **changes) -> ConsistencyLoss:
        config = ConsistencyConfig(**{"start": 0.0, "max_distance": 5.0, **changes})
        return ConsistencyLoss(self.views, self.images.__getitem__, config, iterations=iterations, seed=seed)


@pytest.mark.parametrize(("view", "source"), [(0, 1), (1, 2), (2, 0)])
def test_the_target_is_the_steps_view_and_the_source_another_each_with_its_own_camera_image_and_depth(view, source):
    stage = Stage()
    loss = stage.loss(weight=0.7, confidence_weight=0.2, min_alpha=0.3, occlusion_tolerance=0.05)
    loss.candidates = [[source] if i == view else [] for i in range(3)]
    known = {i: np.where(stage.alphas[i].numpy() > 0.3, stage.depths[i], 0.0) for i in (view, source)}
    warped, mask = by_hand(
        stage.images[source].double().numpy(), known[view], known[source], stage.cameras[view], stage.cameras[source],
        0.05,
    )  # fmt: skip
    assert mask.sum() > 10
    target = stage.images[view].double().numpy()
    network = loss.network.double()
    found_warp = []
    network.register_forward_pre_hook(
        lambda module, inputs: found_warp.extend(inputs) or tuple(i.double() for i in inputs)
    )
    found = float(loss(stage.step(view, 3)).detach())
    # Outside the mask the network sees colours of the border; its output is taken as it is, the rest is worked out.
    np.testing.assert_allclose(found_warp[0].numpy()[mask], warped[mask], atol=1e-4)
    assert torch.equal(found_warp[1], stage.images[view])
    with torch.no_grad():
        confidence = network(found_warp[0].double(), torch.from_numpy(target)).numpy()
    photo = (confidence * np.abs(target - warped).mean(-1))[mask].mean()
    penalty = -np.log(confidence)[mask].mean()
    assert found == pytest.approx(0.7 * (photo + 0.2 * penalty), rel=1e-4)


def test_the_loss_is_due_from_its_start_on_at_its_cadence():
    loss = Stage().loss(iterations=40, start=0.5, every=4)
    assert [i for i in range(40) if loss.due(i)] == [20, 24, 28, 32, 36]
    assert Stage().loss(iterations=10, start=0.24).first == 2


def test_no_loss_before_it_is_due_nor_for_a_view_without_partners():
    stage = Stage()
    loss = stage.loss(iterations=10, start=0.5)
    loss.candidates[1] = []
    assert loss(stage.step(0, 4)) is None
    assert loss(stage.step(1, 6)) is None
    assert loss(stage.step(0, 6)) is not None


def test_partners_are_drawn_evenly_and_the_same_again_for_the_same_iteration_and_seed():
    stage = Stage()
    drawn = {}
    for seed in (0, 1):
        loss, sources = stage.loss(seed=seed), []
        step = stage.step(0, 0)
        render = step.rasterize_view
        step.rasterize_view = lambda j, sources=sources, render=render: sources.append(j) or render(j)
        for step.iteration in range(100):
            loss(step)
        drawn[seed] = sources
        # 100 draws between two views: 5 standard errors are 25
        assert 25 < sources.count(1) < 75
        assert sources.count(1) + sources.count(2) == 100
    assert drawn[0] != drawn[1]
    again, sources = stage.loss(seed=0), []
    step = stage.step(0, 57)
    render = step.rasterize_view
    step.rasterize_view = lambda j: sources.append(j) or render(j)
    again(step)
    assert sources == [drawn[0][57]]


def test_the_source_depth_is_rendered_without_gradient_and_the_target_depth_receives_one():
    stage = Stage()
    step = stage.step(1, 0)
    step.depth.requires_grad_()
    enabled = []
    render = step.rasterize_view
    step.rasterize_view = lambda j: enabled.append(torch.is_grad_enabled()) or render(j)
    stage.loss(min_alpha=0.0)(step).backward()
    assert enabled == [False]
    assert (step.depth.grad != 0).any()


def test_the_confidence_network_takes_one_step_of_adam_per_gradient():
    stage = Stage()
    loss = stage.loss(learning_rate=2e-3)
    before = [p.detach().clone() for p in loss.network.parameters()]
    loss.update()
    assert all(torch.equal(p, b) for p, b in zip(loss.network.parameters(), before, strict=True))
    loss(stage.step(0, 0)).backward()
    loss.update()
    moves = torch.cat(
        [(p.detach() - b).abs().flatten() for p, b in zip(loss.network.parameters(), before, strict=True)]
    )
    assert float(moves.max()) == pytest.approx(2e-3, rel=1e-2)
    after = [p.detach().clone() for p in loss.network.parameters()]
    loss.update()
    assert all(torch.equal(p, a) for p, a in zip(loss.network.parameters(), after, strict=True))


def test_a_restored_loss_goes_on_as_the_saved_one():
    stage = Stage()
    first, second = stage.loss(seed=0), stage.loss(seed=3)
    first(stage.step(0, 0)).backward()
    first.update()
    second.restore({name: tensor.clone() for name, tensor in first.state().items()})
    second.seed = 0
    for loss in (first, second):
        loss(stage.step(2, 1)).backward()
        loss.update()
    for a, b in zip(first.network.parameters(), second.network.parameters(), strict=True):
        assert torch.equal(a, b)


def test_the_network_depends_on_the_seed_and_leaves_the_global_stream_alone():
    stage = Stage()
    torch.manual_seed(9)
    expected = torch.rand(1)
    torch.manual_seed(9)
    networks = [stage.loss(seed=seed).network.layers[0].weight for seed in (0, 0, 1)]
    assert torch.equal(torch.rand(1), expected)
    assert torch.equal(networks[0], networks[1])
    assert not torch.equal(networks[0], networks[2])
