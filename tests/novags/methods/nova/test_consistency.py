import math

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

SIZE = 64
K = torch.tensor([[60.0, 0.0, 32.0], [0.0, 60.0, 32.0], [0.0, 0.0, 1.0]], dtype=torch.float64)


def camera(x: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Pinhole:
    """A camera at (x, 0, z), turned by yaw radians about its vertical axis."""
    c, s = math.cos(yaw), math.sin(yaw)
    rotation = torch.tensor([[c, 0, -s], [0, 1, 0], [s, 0, c]], dtype=torch.float64)
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ torch.tensor([x, 0.0, z], dtype=torch.float64)
    return Pinhole(viewmat, K)


def plane_depth(view: Pinhole, distance: float = 4.0) -> torch.Tensor:
    """z-depth of the world plane z = distance seen by a camera."""
    y, x = torch.meshgrid(torch.arange(SIZE) + 0.5, torch.arange(SIZE) + 0.5, indexing="ij")
    rays = torch.stack([(x - 32) / 60, (y - 32) / 60, torch.ones_like(x)], -1).double()
    rotation, center = view.viewmat[:3, :3], -view.viewmat[:3, :3].T @ view.viewmat[:3, 3]
    return (distance - center[2]) / (rays @ rotation)[..., 2]


def plane_image(view: Pinhole, distance: float = 4.0) -> torch.Tensor:
    """A smooth pattern painted on that plane."""
    y, x = torch.meshgrid(torch.arange(SIZE) + 0.5, torch.arange(SIZE) + 0.5, indexing="ij")
    rays = torch.stack([(x - 32) / 60, (y - 32) / 60, torch.ones_like(x)], -1).double()
    center = -view.viewmat[:3, :3].T @ view.viewmat[:3, 3]
    world = (rays * plane_depth(view, distance)[..., None]) @ view.viewmat[:3, :3] + center
    return torch.stack([torch.sin(2 * world[..., 0]), torch.cos(2 * world[..., 1]), world[..., :2].sum(-1) / 4], -1)


def test_a_camera_sees_itself():
    view, image = camera(), torch.rand(SIZE, SIZE, 3, dtype=torch.float64)
    warped, mask = reproject(image, plane_depth(view), plane_depth(view), view, view)
    torch.testing.assert_close(warped, image)
    assert mask.all()


@pytest.mark.parametrize("source", [camera(x=0.5), camera(x=-0.3, z=0.4), camera(x=0.6, yaw=-0.15)])
def test_a_plane_warped_between_two_cameras_looks_as_rendered(source):
    target = camera()
    warped, mask = reproject(plane_image(source), plane_depth(target), plane_depth(source), target, source)
    assert mask.double().mean() > 0.6
    # Bilinear interpolation of a pattern of curvature 4 at pixels 1/15 apart: below 4 (1/15)² / 4.
    error = (warped - plane_image(target)).abs().amax(-1)
    assert error[mask].max() < 6e-3


def test_pixels_outside_the_source_frame_are_masked():
    target, source = camera(), camera(x=1.0)
    _, mask = reproject(plane_image(source), plane_depth(target), plane_depth(source), target, source)
    # At depth 4 a baseline of 1 moves pixels by 60 / 4 = 15 px to the left: 15 columns have no counterpart.
    assert not mask[:, :15].any()
    assert mask[1:-1, 15:].all()


def test_an_occluder_in_the_source_is_detected():
    target, source = camera(), camera(x=0.5)
    depth_s = plane_depth(source)
    depth_s[:, 20:30] = 2.0
    _, mask = reproject(plane_image(source), plane_depth(target), depth_s, target, source)
    _, without = reproject(plane_image(source), plane_depth(target), plane_depth(source), target, source)
    hidden = without & ~mask
    # The shift is 60 * 0.5 / 4 = 7.5 px: source columns 20 to 30 answer for target columns 27.5 to 37.5.
    assert hidden[:, 28:37].all()
    assert not hidden[:, :26].any()
    assert not hidden[:, 39:].any()


@pytest.mark.parametrize(("relative", "visible"), [(0.08, True), (0.13, False), (-0.08, True), (-0.13, False)])
def test_the_occlusion_test_allows_a_tenth_of_the_projected_depth(relative, visible):
    view = camera()
    _, mask = reproject(plane_image(view), plane_depth(view) * (1 + relative), plane_depth(view), view, view)
    assert bool(mask[32, 32]) == visible


def test_unknown_and_negative_depths_are_masked():
    target, source = camera(), camera(x=0.1)
    depth_t, depth_s = plane_depth(target), plane_depth(source)
    depth_t[:8], depth_s[-8:] = 0, -1
    warped, mask = reproject(plane_image(source), depth_t, depth_s, target, source)
    assert torch.isfinite(warped).all()
    assert not mask[:8].any()
    assert not mask[-7:].any()
    assert mask[9:-9, 8:-8].all()


def test_points_behind_the_source_are_masked_and_leave_gradients_finite():
    target, source = camera(), camera(z=6.0)
    depth = plane_depth(target).requires_grad_()
    warped, mask = reproject(plane_image(target), depth, torch.full_like(depth, 1.0).detach(), target, source)
    assert not mask.any()
    consistency_loss(warped, plane_image(target), torch.ones(SIZE, SIZE), mask, 0.1).backward()
    assert torch.isfinite(depth.grad).all()


def test_the_loss_pulls_a_wrong_depth_towards_the_plane():
    target, source = camera(), camera(x=0.3)
    depth = (plane_depth(target) * 1.03).requires_grad_()
    warped, mask = reproject(plane_image(source), depth, plane_depth(source), target, source)
    loss = consistency_loss(warped, plane_image(target), torch.ones(SIZE, SIZE), mask, 0.0)
    loss.backward()
    assert depth.grad[mask].sum() > 0
    with torch.no_grad():
        closer = plane_depth(target) * 1.02
        warped, mask = reproject(plane_image(source), closer, plane_depth(source), target, source)
        assert consistency_loss(warped, plane_image(target), torch.ones(SIZE, SIZE), mask, 0.0) < loss


def test_depth_gradients_match_finite_differences():
    target, source, pixel = camera(), camera(x=0.3), (30, 40)
    image = plane_image(source)

    def colour(depth: torch.Tensor) -> torch.Tensor:
        return reproject(image, depth, plane_depth(source), target, source)[0][pixel].sum()

    depth = (plane_depth(target) * 1.01).requires_grad_()
    (gradient,) = torch.autograd.grad(colour(depth), depth)
    step = torch.zeros_like(depth)
    step[pixel] = 1e-5
    with torch.no_grad():
        difference = (colour(depth + step) - colour(depth - step)) / 2e-5
    torch.testing.assert_close(gradient[pixel], difference, rtol=1e-5, atol=1e-8)


def test_the_loss_equals_its_formula_and_is_zero_without_valid_pixels():
    generator = torch.Generator().manual_seed(0)
    warped, target = torch.rand(2, 6, 5, 3, generator=generator)
    confidence = torch.rand(6, 5, generator=generator) * 0.8 + 0.1
    mask = torch.rand(6, 5, generator=generator) > 0.4
    photo = sum(confidence[p] * (target[p] - warped[p]).abs().mean() for p in zip(*mask.nonzero().T, strict=True))
    penalty = sum(-torch.log(confidence[p]) for p in zip(*mask.nonzero().T, strict=True))
    expected = (photo + 0.05 * penalty) / mask.sum()
    torch.testing.assert_close(consistency_loss(warped, target, confidence, mask, 0.05), expected)
    assert float(consistency_loss(warped, target, confidence, torch.zeros_like(mask), 0.05)) == 0


@pytest.mark.parametrize(("residual", "best"), [(0.2, 0.25), (0.5, 0.1), (0.01, 1.0)])
def test_the_best_confidence_is_lambda_over_the_residual_at_most_one(residual, best):
    warped, target = torch.zeros(1, 1, 3), torch.full((1, 1, 3), residual)
    mask = torch.ones(1, 1, dtype=torch.bool)
    candidates = torch.linspace(0.01, 1, 100)
    losses = [float(consistency_loss(warped, target, c.reshape(1, 1), mask, 0.05)) for c in candidates]
    assert float(candidates[losses.index(min(losses))]) == pytest.approx(best, abs=0.006)


def test_the_confidence_network_is_the_papers_and_ends_in_one_sigmoid():
    torch.manual_seed(0)
    network = ConfidenceNet()
    convolutions = [m for m in network.modules() if isinstance(m, torch.nn.Conv2d)]
    assert [(m.in_channels, m.out_channels, m.kernel_size[0]) for m in convolutions] == [
        (6, 16, 3),
        (16, 16, 3),
        (16, 1, 1),
    ]
    warped, target = torch.rand(2, 10, 12, 3)
    logits = network.layers(torch.cat([warped, target], -1).movedim(-1, 0)[None])[0, 0]
    torch.testing.assert_close(network(warped, target), torch.sigmoid(logits))


def orbit(count: int, radius: float = 3.0) -> Views:
    """Cameras on a circle that look at its centre."""
    viewmats = []
    for i in range(count):
        angle = 2 * math.pi * i / count
        z = -torch.tensor([math.cos(angle), math.sin(angle), 0.0])
        x = torch.tensor([-math.sin(angle), math.cos(angle), 0.0])
        viewmat = torch.eye(4)
        viewmat[:3, :3] = torch.stack([x, torch.linalg.cross(z, x), z])
        viewmat[2, 3] = radius
        viewmats.append(viewmat)
    return Views(torch.stack(viewmats), K.float().expand(count, 3, 3).contiguous(), SIZE, SIZE)


def test_partners_are_the_nearest_views_within_the_angle():
    candidates = source_candidates(orbit(24), ConsistencyConfig())
    # 15 degrees apart: one neighbour on each side is within 30 degrees (two are at the limit, which is excluded).
    for i, partners in enumerate(candidates):
        assert {(j - i) % 24 for j in partners} >= {1, 23}
        assert i not in partners
        assert all(min((j - i) % 24, (i - j) % 24) <= 2 for j in partners)
    assert source_candidates(orbit(8), ConsistencyConfig()) == [[]] * 8


def test_views_without_a_partner_are_counted_and_a_loss_without_effect_is_said():
    def loss(views: Views) -> ConsistencyLoss:
        return ConsistencyLoss(views, lambda _: torch.zeros(SIZE, SIZE, 3), ConsistencyConfig(), iterations=8, seed=0)

    assert loss(orbit(24)).facts() == {"views_with_partner": 24, "of": 24}
    with pytest.warns(UserWarning, match="none of the 8 views has a partner .* less than 30 degrees"):
        alone = loss(orbit(8))  # in steps of 45 degrees
    assert alone.facts() == {"views_with_partner": 0, "of": 8}


def test_partners_do_not_stand_in_the_same_place():
    views = orbit(24)
    doubled = Views(views.viewmats.repeat(2, 1, 1), views.Ks.repeat(2, 1, 1), SIZE, SIZE)
    for i, partners in enumerate(source_candidates(doubled, ConsistencyConfig())):
        assert (i + 24) % 48 not in partners


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"weight": -1.0}, "weights must be >= 0, got -1.0 and"),
        ({"start": 1.5}, r"start must lie in \[0, 1\], got 1.5"),
        ({"every": 0}, "every and neighbours must be >= 1, got 0 and"),
        ({"occlusion_tolerance": 0.0}, "occlusion_tolerance must be > 0, got 0.0"),
        ({"neighbours": 0}, "every and neighbours must be >= 1, got .* and 0"),
    ],
)
def test_impossible_configurations_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        ConsistencyConfig(**wrong)
