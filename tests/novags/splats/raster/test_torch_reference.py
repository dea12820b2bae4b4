"""The readable rasteriser against plain loops, finite differences and known integrals."""

import importlib
import math
from typing import Any

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y

from novags.splats import rasterize
from novags.splats.raster.raster_torch import project
from novags.splats.sh import sh_basis, sh_colors

Scene = dict[str, Any]
AA = "antialiased"


def loop_oracle(scene: Scene, *, antialiased: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """EWA splatting pixel by pixel and Gaussian by Gaussian, from the formulas, in numpy."""
    a = {k: v.numpy() for k, v in scene.items() if isinstance(v, torch.Tensor)}
    view, K = a["viewmats"][0], a["Ks"][0]
    width, height = scene["width"], scene["height"]
    splats = []
    for i in range(len(a["means"])):
        w, x, y, z = a["quats"][i] / np.linalg.norm(a["quats"][i])
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        rotation = np.eye(3) + 2 * w * cross + 2 * cross @ cross  # Rodrigues
        covariance = rotation @ np.diag(a["scales"][i] ** 2) @ rotation.T
        px, py, pz = view[:3, :3] @ a["means"][i] + view[:3, 3]
        if pz <= 0.01:
            continue
        fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        tx = pz * np.clip(px / pz, -(cx + 0.15 * width) / fx, (1.15 * width - cx) / fx)
        ty = pz * np.clip(py / pz, -(cy + 0.15 * height) / fy, (1.15 * height - cy) / fy)
        J = np.array([[fx / pz, 0, -fx * tx / pz**2], [0, fy / pz, -fy * ty / pz**2]])
        sharp = J @ view[:3, :3] @ covariance @ view[:3, :3].T @ J.T
        cov2d = sharp + 0.3 * np.eye(2)
        opacity = a["opacities"][i]
        if antialiased:
            opacity = opacity * math.sqrt(np.linalg.det(sharp) / np.linalg.det(cov2d))
        center = np.array([fx * px / pz + cx, fy * py / pz + cy])
        splats.append((pz, center, np.linalg.inv(cov2d), opacity, a["colors"][i]))
    splats.sort(key=lambda s: s[0])
    image, alphas = np.zeros((height, width, 3)), np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            left = 1.0
            for _, center, conic, opacity, color in splats:
                d = np.array([column + 0.5, row + 0.5]) - center
                alpha = min(0.999, opacity * math.exp(-0.5 * d @ conic @ d))
                if alpha < 1 / 255:
                    continue
                if left * (1 - alpha) < 1e-4:
                    break
                image[row, column] += left * alpha * color
                left *= 1 - alpha
            alphas[row, column] = 1 - left
    return image, alphas


@pytest.mark.parametrize(("seed", "mode"), [(0, "classic"), (1, "classic"), (2, "antialiased")])
def test_reference_equals_loops_over_pixels_and_gaussians(make_scene, seed, mode):
    scene = make_scene(seed, 60, 13, 9)
    image, alphas, _ = rasterize(**scene, rasterize_mode=mode, backend="torch")
    expected, expected_alphas = loop_oracle(scene, antialiased=mode == "antialiased")
    np.testing.assert_allclose(image[0].numpy(), expected, atol=1e-12)
    np.testing.assert_allclose(alphas[0, ..., 0].numpy(), expected_alphas, atol=1e-12)


@pytest.mark.parametrize(
    ("sh_degree", "mode", "aa"), [(None, "RGB+D", "classic"), (3, "RGB+ED", "classic"), (0, "RGB", AA)]
)
def test_gradients_of_the_reference_equal_finite_differences(make_scene, sh_degree, mode, aa):
    # eps is far below the depth and threshold gaps of these scenes, so the order stays frozen
    scene = make_scene(5, 3, 5, 4, sh_degree=sh_degree)
    names = ["means", "quats", "scales", "opacities", "colors", "viewmats"]
    background = torch.tensor([0.3, 0.2, 0.1], dtype=torch.float64, requires_grad=True)

    def render(*tensors):
        arguments = {**scene, **dict(zip(names, tensors[:-1], strict=True)), "backgrounds": tensors[-1]}
        image, alpha, _ = rasterize(**arguments, render_mode=mode, rasterize_mode=aa, backend="torch")
        return image, alpha

    inputs = [scene[name].clone().requires_grad_() for name in names]
    assert torch.autograd.gradcheck(render, (*inputs, background), eps=1e-7, atol=1e-5, rtol=1e-4)


def test_a_gaussian_amid_an_even_loss_has_no_gradient_on_the_screen_but_one_of_its_magnitudes(make_scene):
    """Expectation: what its left half gains its right half loses; the sum of magnitudes is of both."""
    scene = make_scene(0, 1, 33, 33, sh_degree=None)
    scene |= {"means": torch.zeros(1, 3).double(), "scales": torch.full((1, 3), 0.1).double()}
    scene["viewmats"] = torch.eye(4).double()[None].clone()
    scene["viewmats"][0, 2, 3] = 3.0
    scene["Ks"] = torch.tensor([[[33.0, 0, 16.5], [0, 33, 16.5], [0, 0, 1]]]).double()
    scene["means"].requires_grad_()
    image, _, info = rasterize(**scene, absgrad=True, packed=False, backend="torch")
    centre = info["means2d"]
    centre.retain_grad()
    image.sum().backward()
    assert centre.absgrad.shape == centre.grad.shape == (1, 1, 2)
    assert float(centre.absgrad.min()) > 0.01
    assert float(centre.grad.abs().max()) < 1e-9 * float(centre.absgrad.min())


def test_projection_of_a_far_sphere_is_a_circle_of_the_right_size():
    z, s, f = 100.0, 0.5, 400.0
    one = torch.ones(1, 3, dtype=torch.float64)
    means = torch.tensor([[0.0, 0.0, z]], dtype=torch.float64)
    quats = torch.tensor([[0.3, -0.2, 0.9, 0.1]], dtype=torch.float64)
    K = torch.tensor([[f, 0, 32], [0, f, 32], [0, 0, 1]], dtype=torch.float64)
    means2d, covs2d, depths = project(means, quats, s * one, torch.eye(4, dtype=torch.float64), K, 64, 64, 0.0)
    torch.testing.assert_close(means2d, torch.tensor([[32.0, 32.0]], dtype=torch.float64))
    torch.testing.assert_close(covs2d[0], (f * s / z) ** 2 * torch.eye(2, dtype=torch.float64))
    assert depths.item() == z


def test_one_gaussian_has_the_analytic_footprint():
    f, z, s, o = 50.0, 2.0, 0.1, 0.8
    K = torch.tensor([[[f, 0, 8], [0, f, 8], [0, 0, 1]]], dtype=torch.float64)
    image, alpha, _ = rasterize(
        torch.tensor([[0.0, 0.0, z]], dtype=torch.float64), torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64),
        torch.full((1, 3), s, dtype=torch.float64), torch.tensor([o], dtype=torch.float64),
        torch.tensor([[1.0, 0.5, 0.25]], dtype=torch.float64), torch.eye(4, dtype=torch.float64)[None], K, 16, 16,
        render_mode="RGB+ED", backend="torch",
    )  # fmt: skip
    variance = (f * s / z) ** 2 + 0.3
    axis = torch.arange(16, dtype=torch.float64) + 0.5 - 8
    expected = o * torch.exp(-(axis[:, None] ** 2 + axis**2) / (2 * variance))
    expected = torch.where(expected >= 1 / 255, expected, 0.0)
    torch.testing.assert_close(alpha[0, ..., 0], expected)
    torch.testing.assert_close(image[0, ..., :3], expected[..., None] * torch.tensor([1.0, 0.5, 0.25]).double())
    torch.testing.assert_close(image[0, ..., 3], torch.where(expected > 0, z, 0.0).double())


def test_spherical_harmonics_are_the_standard_real_ones():
    g = torch.Generator().manual_seed(0)
    d = torch.nn.functional.normalize(torch.randn(50, 3, generator=g, dtype=torch.float64), dim=-1)
    theta, phi = np.arccos(d[:, 2].numpy()), np.arctan2(d[:, 1].numpy(), d[:, 0].numpy())
    basis = sh_basis(3, d).numpy()
    for degree in range(4):
        for m in range(-degree, degree + 1):
            y = sph_harm_y(degree, abs(m), theta, phi)
            # scipy's Y carries the Condon-Shortley phase, as the 3DGS basis does
            real = y.real if m == 0 else math.sqrt(2) * (y.real if m > 0 else y.imag)
            np.testing.assert_allclose(basis[:, degree * degree + degree + m], real, atol=1e-12)


def test_colors_ignore_higher_degrees_and_are_cut_at_zero():
    sh = torch.zeros(1, 16, 3, dtype=torch.float64)
    sh[0, 0] = torch.tensor([1.0, -10.0, 0.0])
    sh[0, 1:] = 7.0
    colors = sh_colors(0, torch.tensor([[0.0, 0.0, 2.0]], dtype=torch.float64), sh)
    c0 = 1 / (2 * math.sqrt(math.pi))
    torch.testing.assert_close(colors, torch.tensor([[0.5 + c0, 0.0, 0.5]], dtype=torch.float64))


def test_reference_agrees_with_gsplats_own_torch_math(make_scene):
    oracle = importlib.import_module("gsplat.cuda._torch_impl")
    scene = make_scene(11, 200, 40, 30, sh_degree=3)
    covars, _ = oracle._quat_scale_to_covar_preci(scene["quats"], scene["scales"], True, False)
    radii, means2d, depths, conics, _ = oracle._fully_fused_projection(
        scene["means"], covars, scene["viewmats"], scene["Ks"], 40, 30, eps2d=0.3, near_plane=0.01, far_plane=1e10
    )
    mine, covs2d, z = project(
        scene["means"], scene["quats"], scene["scales"], scene["viewmats"][0], scene["Ks"][0], 40, 30, 0.3
    )
    seen = (radii[0].reshape(len(z), -1) > 0).all(-1)
    inverse = torch.linalg.inv(covs2d)
    torch.testing.assert_close(mine[seen], means2d[0][seen])
    torch.testing.assert_close(z[seen], depths[0][seen])
    torch.testing.assert_close(
        torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], -1)[seen], conics[0][seen]
    )
    directions = scene["means"]
    expected = torch.clamp_min(oracle._spherical_harmonics(3, directions, scene["colors"]) + 0.5, 0)
    torch.testing.assert_close(sh_colors(3, directions, scene["colors"]), expected)


def test_antialiased_gradients_of_the_kernels_equal_finite_differences_of_the_loops(make_scene):
    """In a random direction of means, rotations and scales: Gaussians of all sizes about a pixel."""
    scene = make_scene(5, 6, 7, 6)
    scene["opacities"], scene["scales"] = 0.6 + 0.3 * scene["opacities"], 0.06 + 0.3 * scene["scales"]
    weights = torch.randn(6, 7, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    names, step = ("means", "quats", "scales", "opacities"), 1e-6
    leaves = {name: scene[name].float().requires_grad_() for name in names}
    as32 = {k: v.float() if isinstance(v, torch.Tensor) else v for k, v in scene.items()}
    image = rasterize(**{**as32, **leaves}, rasterize_mode=AA, backend="numba")[0]
    (image[0] * weights).sum().backward()
    for name in names:
        way = torch.randn(scene[name].shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
        low, high = (
            (loop_oracle({**scene, name: scene[name] + s * way}, antialiased=True)[0] * weights.numpy()).sum()
            for s in (-step, step)
        )
        expected = (high - low) / (2 * step)
        assert abs(float((leaves[name].grad * way).sum()) - expected) < 1e-4 * abs(expected) + 1e-4, name


@pytest.mark.parametrize("backend", ["torch", "numba"])
@pytest.mark.parametrize("eps2d", [0.1, 0.3])
def test_a_compensated_sphere_keeps_its_light_however_small_it_is(backend, eps2d):
    # the integral of alpha over the image is 2 pi o sqrt(det), dilated or not; classic adds up to eps2d / det to it
    f, z, o = 200.0, 2.0, 0.9
    K = torch.tensor([[[f, 0, 15.9], [0, f, 16.2], [0, 0, 1]]])
    for sigma in (0.6, 1.2):  # pixels
        _, alpha, _ = rasterize(
            torch.tensor([[0.0, 0.0, z]]), torch.tensor([[1.0, 0, 0, 0]]), torch.full((1, 3), sigma * z / f),
            torch.tensor([o]), torch.ones(1, 3), torch.eye(4)[None], K, 32, 32, eps2d=eps2d, rasterize_mode=AA,
            backend=backend,
        )  # fmt: skip
        peak = o * sigma**2 / (sigma**2 + eps2d)
        variance = sigma**2 + eps2d
        axes = [(torch.arange(32) + 0.5 - center) ** 2 for center in (15.9, 16.2)]
        expected = peak * torch.exp(-(axes[1][:, None] + axes[0]) / (2 * variance))
        torch.testing.assert_close(alpha[0, ..., 0], torch.where(expected >= 1 / 255, expected, 0.0), atol=2e-6, rtol=0)
        assert abs(float(expected.sum()) / (2 * math.pi * o * sigma**2) - 1) < 0.01


@pytest.mark.parametrize("backend", ["torch", "numba"])
@pytest.mark.parametrize("mode", ["classic", AA])
def test_what_reaches_no_farther_than_the_clip_is_left_out(make_scene, backend, mode):
    scene = {k: v.float() if isinstance(v, torch.Tensor) else v for k, v in make_scene(7, 80, 30, 26).items()}
    options = {"rasterize_mode": mode, "backend": backend, "packed": False}
    radii = rasterize(**scene, **options)[2]["radii"][0].amax(-1)
    for clip in (3, 4):
        image, _, info = rasterize(**scene, radius_clip=float(clip), **options)
        kept = radii > clip
        assert 10 < int(kept.sum()) < int((radii > 0).sum())
        few = {name: scene[name][kept] for name in ("means", "quats", "scales", "opacities", "colors")}
        torch.testing.assert_close(image, rasterize(**{**scene, **few}, **options)[0])
        assert torch.equal(info["radii"][0].amax(-1), torch.where(kept, radii, 0))
