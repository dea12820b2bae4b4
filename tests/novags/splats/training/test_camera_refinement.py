"""Training cameras with errors are brought back by the fit; without refinement nothing changes."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from novags.splats import CameraRefinement, FitConfig, Gaussians, Step, Views, fit, rasterize
from novags.splats.training.updates.camera_refinement import CameraState, move_cameras, refined

SIZE, N_VIEWS, N = 40, 6, 300
RADIUS, FOCAL = 2.4, 0.7  # near and wide: turns and moves of a camera then look different


def around(n_views: int = N_VIEWS, size: int = SIZE) -> Views:
    """Cameras on a wavy ring that look at the origin."""
    viewmats = torch.eye(4).repeat(n_views, 1, 1)
    for k in range(n_views):
        a, e = 2 * math.pi * k / n_views, 0.3 + 0.5 * math.sin(6 * math.pi * k / n_views)
        center = RADIUS * np.array([math.cos(a) * math.cos(e), math.sin(a) * math.cos(e), math.sin(e)])
        right = np.array([-math.sin(a), math.cos(a), 0.0])
        R = np.stack([right, np.cross(-center / RADIUS, right), -center / RADIUS])
        viewmats[k, :3] = torch.from_numpy(np.column_stack([R, -R @ center]))
    K = torch.tensor([[FOCAL * size, 0, size / 2], [0, FOCAL * size, size / 2], [0, 0, 1]])
    return Views(viewmats, K.repeat(n_views, 1, 1), size, size)


def pictures(gaussians: Gaussians, viewmats: Tensor, views: Views) -> Tensor:
    g = gaussians
    with torch.no_grad():
        return rasterize(
            g.means, g.quats, g.scales, g.opacities, g.sh, viewmats, views.Ks, views.width, views.height,
            sh_degree=g.sh_degree,
        )[0]  # fmt: skip


def problem() -> tuple[Gaussians, Views, Tensor, Views]:
    """A start near the truth, the true cameras, their pictures, and cameras with errors of 2 degrees, 0.02 extents."""
    g = torch.Generator().manual_seed(0)
    points = 2 * torch.rand(N, 3, generator=g) - 1
    colors = (torch.sin(4 * points) + 1) / 2
    truth = Gaussians.from_points(points, colors, sh_degree=0, init_opacity=0.9)
    views = around()
    images = pictures(truth, views.viewmats, views)
    start = Gaussians(**{name: t.clone() for name, t in truth.tensors().items()})
    start.means += 0.02 * torch.randn(N, 3, generator=g)
    start.sh += 0.1 * torch.randn(N, 1, 3, generator=g)
    start.logit_opacities[:] = 0
    rng = np.random.default_rng(2)
    wrong = views.viewmats.double().numpy().copy()
    turns = Rotation.from_rotvec(math.radians(2) / math.sqrt(3) * rng.standard_normal((N_VIEWS, 3))).as_matrix()
    wrong[:, :3] = turns @ wrong[:, :3]
    wrong[:, :3, 3] += 0.02 * views.extent / math.sqrt(3) * rng.standard_normal((N_VIEWS, 3))
    return start, views, images, dataclasses.replace(views, viewmats=torch.from_numpy(wrong).float())


def camera_errors(viewmats: Tensor, truth: Views) -> tuple[float, float]:
    """RMS angle in degrees and distance of centres in extents, after the best similarity (Umeyama 1991)."""
    found, true = viewmats.double().numpy(), truth.viewmats.double().numpy()
    a, b = (-np.einsum("cji,cj->ci", v[:, :3, :3], v[:, :3, 3]) for v in (found, true))
    a0, b0 = a - a.mean(0), b - b.mean(0)
    U, S, Vt = np.linalg.svd(b0.T @ a0)
    D = np.diag([1, 1, np.linalg.det(U @ Vt)])
    Q = U @ D @ Vt
    distance = np.linalg.norm(np.trace(np.diag(S) @ D) / (a0**2).sum() * a0 @ Q.T - b0, axis=1) / truth.extent
    turn = Rotation.from_matrix(found[:, :3, :3] @ Q.T @ true[:, :3, :3].transpose(0, 2, 1)).magnitude()
    return float(np.degrees(np.sqrt((turn**2).mean()))), float(np.sqrt((distance**2).mean()))


def psnr(a: Tensor, b: Tensor) -> float:
    return -10 * math.log10((a - b).square().mean().item())


def config(**changes: object) -> FitConfig:
    return dataclasses.replace(FitConfig(iterations=400, sh_degree=0, mcmc=None), **changes)


def test_a_short_fit_brings_cameras_back_and_shows_the_pictures_better():
    start, views, images, wrong = problem()
    before = camera_errors(wrong.viewmats, views)
    assert before[0] > 1.2
    assert before[1] > 0.012
    # 67 visits to a camera take larger steps than the many of a full run
    quick = CameraRefinement(start=10, rotation_rate=1e-2, translation_rate=4e-3)
    plain = fit(start, wrong, lambda i: images[i], config())
    better = fit(start, wrong, lambda i: images[i], config(refine_cameras=quick))
    after = camera_errors(better.viewmats, views)
    assert after[0] < 0.45 * before[0]
    assert after[1] < 0.45 * before[1]
    gain = psnr(pictures(better.gaussians, better.viewmats, views), images) - psnr(
        pictures(plain.gaussians, wrong.viewmats, views), images
    )
    assert gain > 6
    assert torch.equal(plain.viewmats, wrong.viewmats)


def test_until_it_starts_the_fit_is_the_same_to_the_bit():
    start, _, images, wrong = problem()
    plain = fit(start, wrong, lambda i: images[i], config(iterations=12))
    idle = fit(start, wrong, lambda i: images[i], config(iterations=12, refine_cameras=CameraRefinement(start=12)))
    late = fit(start, wrong, lambda i: images[i], config(iterations=12, refine_cameras=CameraRefinement(start=11)))
    assert torch.equal(idle.viewmats, wrong.viewmats)
    assert all(torch.equal(t, idle.gaussians.tensors()[name]) for name, t in plain.gaussians.tensors().items())
    moved = (late.viewmats != wrong.viewmats).flatten(1).any(1)
    assert moved.sum() == 1  # iteration 11 shows one camera


def test_an_interrupted_refinement_resumes_to_the_same_bits(tmp_path):
    start, _, images, wrong = problem()
    settings = config(iterations=40, refine_cameras=CameraRefinement(start=5, pull=0.1), checkpoint_every=15)
    whole = fit(start, wrong, lambda i: images[i], settings)

    def stop(iteration: int) -> None:
        if iteration == 34:
            raise KeyboardInterrupt

    path = tmp_path / "state.safetensors"
    with pytest.raises(KeyboardInterrupt):
        fit(start, wrong, lambda i: images[i], settings, before_step=stop, checkpoint=path)
    seen: list[int] = []
    resumed = fit(start, wrong, lambda i: images[i], settings, before_step=seen.append, checkpoint=path)
    assert seen == list(range(30, 40))
    assert torch.equal(resumed.viewmats, whole.viewmats)
    assert all(torch.equal(t, whole.gaussians.tensors()[name]) for name, t in resumed.gaussians.tensors().items())
    assert not torch.equal(whole.viewmats, wrong.viewmats)
    again = fit(start, wrong, lambda i: images[i], settings, checkpoint=path)
    assert torch.equal(again.viewmats, whole.viewmats)
    other = dataclasses.replace(settings, refine_cameras=CameraRefinement(start=6, pull=0.1))
    with pytest.raises(ValueError, match="other settings .*refine_cameras"):
        fit(start, wrong, lambda i: images[i], other, checkpoint=path)


def test_steps_see_the_cameras_where_they_are_and_losses_on_other_views_move_those():
    start, _, images, wrong = problem()
    steps: list[Step] = []

    def toward(step: Step) -> Tensor:
        steps.append(step)
        other = (step.view + 1) % N_VIEWS
        assert step.views.viewmats.requires_grad
        image, _, _, _ = step.rasterize_view(other)
        return (image - images[other]).square().mean()

    settings = config(iterations=1, refine_cameras=CameraRefinement(start=0, rotation_rate=1e-3, translation_rate=5e-3))
    result = fit(start, wrong, lambda i: images[i], settings, extra_losses=[toward])
    (step,) = steps
    assert torch.equal(step.views.viewmats, wrong.viewmats)
    moved = (result.viewmats != wrong.viewmats).flatten(1).any(1)
    assert moved.nonzero()[:, 0].tolist() == sorted([step.view, (step.view + 1) % N_VIEWS])
    fit(start, wrong, lambda i: images[i], dataclasses.replace(settings, iterations=2), extra_losses=[toward])
    torch.testing.assert_close(steps[2].views.viewmats, result.viewmats, rtol=0, atol=0)


def test_a_twist_turns_about_the_cameras_own_axes_and_moves_its_centre_along_them():
    views = around()
    g = torch.Generator().manual_seed(3)
    twists = 0.1 * torch.randn(N_VIEWS, 6, generator=g)
    found = dataclasses.replace(views, viewmats=refined(views.viewmats, twists, 2.5))
    R = views.viewmats[:, :3, :3]
    expected = views.centers + 2.5 * (R.mT @ twists[:, 3:, None])[..., 0]
    torch.testing.assert_close(found.centers, expected, rtol=0, atol=2e-6)
    turns = (found.viewmats[:, :3, :3] @ R.mT).double().numpy()
    angle = twists[:, :3].double().norm(dim=1, keepdim=True)
    vectors = (2 * torch.atan(angle / 2) / angle * twists[:, :3].double()).numpy()
    np.testing.assert_allclose(turns, Rotation.from_rotvec(vectors).as_matrix(), atol=1e-6)
    assert torch.equal(refined(views.viewmats, torch.zeros(N_VIEWS, 6), 2.5), views.viewmats)


def test_a_scene_in_other_units_and_another_frame_is_refined_alike():
    start, _, images, wrong = problem()
    settings = config(iterations=60, refine_cameras=CameraRefinement(start=0))
    result = fit(start, wrong, lambda i: images[i], settings)
    scale, turn = 4.0, torch.tensor(Rotation.from_euler("z", 90, degrees=True).as_matrix()).float()
    viewmats = wrong.viewmats.clone()
    viewmats[:, :3, :3] = viewmats[:, :3, :3] @ turn.T
    viewmats[:, :3, 3] *= scale
    half = math.sqrt(0.5)
    larger = Gaussians(
        means=scale * start.means @ turn.T, quats=torch.tensor([half, 0, 0, half]).repeat(N, 1),
        log_scales=start.log_scales + math.log(scale), logit_opacities=start.logit_opacities, sh=start.sh,
    )  # fmt: skip
    other = fit(larger, dataclasses.replace(wrong, viewmats=viewmats), lambda i: images[i],
                dataclasses.replace(settings, scale_reg=settings.scale_reg / scale))  # fmt: skip
    back = other.viewmats.clone()
    back[:, :3, :3] = back[:, :3, :3] @ turn
    back[:, :3, 3] /= scale
    moved = (result.viewmats - wrong.viewmats).abs().max()
    assert (back - result.viewmats).abs().max() < 0.05 * moved


def test_steps_of_the_cameras_are_adams_and_only_of_those_with_a_gradient():
    state = CameraState.of(torch.eye(4).repeat(3, 1, 1))
    refinement = CameraRefinement(rotation_rate=0.01, translation_rate=0.002, pull=0.5)
    reference = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    turn, move = reference[:3].detach().clone().requires_grad_(), reference[3:].detach().clone().requires_grad_()
    groups = [{"params": [turn], "lr": 0.01}, {"params": [move], "lr": 0.002}]
    adam = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15)
    g = torch.Generator().manual_seed(0)
    for step in range(9):
        gradient = torch.zeros(3, 6)
        if step % 3 != 2:  # then only the first camera has a part
            gradient[1] = torch.randn(6, generator=g)
            full = gradient[1].double() + 2 * 0.5 * torch.cat([turn, move]).detach()
            turn.grad, move.grad = full[:3].clone(), full[3:].clone()
            for group, rate in zip(adam.param_groups, (0.01, 0.002), strict=True):
                group["lr"] = 0.7 * rate
            adam.step()
        else:
            gradient[0] = 1.0
        state.twists.grad = gradient
        move_cameras(state, refinement, 0.7)
    expected = torch.cat([turn, move]).detach().float()
    torch.testing.assert_close(state.twists[1], expected, rtol=1e-5, atol=1e-7)
    assert state.visits.tolist() == [3, 6, 0]
    assert not state.twists[2].any()
    assert state.twists[0].abs().min() > 0
    state.twists.grad = torch.ones(3, 6)
    before = state.twists.clone()
    move_cameras(state, refinement, 0.0)
    assert torch.equal(state.twists, before)
    assert state.visits.tolist() == [3, 6, 0]


def test_rates_fall_log_linearly_from_the_start_of_refinement_to_the_end_of_the_run():
    refinement = CameraRefinement(start=100, decay=0.01)
    factors = [refinement.factor_at(i, 500) for i in (0, 99, 100, 300, 500)]
    assert factors == pytest.approx([0, 0, 1, 0.1, 0.01])


def test_a_strong_pull_keeps_the_cameras_where_they_were_given():
    start, _, images, wrong = problem()
    twist = {}
    for pull in (0.0, 1e4):
        refinement = CameraRefinement(start=0, pull=pull)
        result = fit(start, wrong, lambda i: images[i], config(iterations=60, refine_cameras=refinement))
        twist[pull] = (result.viewmats - wrong.viewmats).norm().item()
    assert twist[1e4] < 0.1 * twist[0.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rotation_rate": -1e-3}, "rotation_rate of camera refinement must be finite and >= 0, got -0.001"),
        ({"translation_rate": math.nan}, "translation_rate of camera refinement must be finite and >= 0, got nan"),
        ({"pull": math.inf}, "pull of camera refinement must be finite and >= 0, got inf"),
        ({"start": -1}, "start of camera refinement must be >= 0 iterations, got -1"),
        ({"decay": 0.0}, r"decay of camera refinement must lie in \(0, 1\], got 0.0"),
    ],
)
def test_bad_refinements_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        CameraRefinement(**changes)
