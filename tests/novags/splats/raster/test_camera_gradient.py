"""The gradient of `rasterize` to its cameras: against finite differences along rigid motions, autograd and symmetry.

A camera's six motions are those of `twist_gradient`: it turns about, and then moves along, its own three axes.
Finite differences are central, of the readable rasteriser in float64, over steps far below the distances of depths
from each other and of weights from thresholds, so that the order of Gaussians is frozen. They and autograd of the
readable rasteriser agree to 1e-6 of a camera's largest entry (measured: 1e-9); the float32 kernels agree with both to
2e-4 (measured: 5e-5 at most, of expected depth; 6e-6 of the other modes).
"""

from typing import Any

import pytest
import torch
from scipy.linalg import expm
from torch import Tensor

from novags.splats import rasterize

MODES = ["RGB", "D", "ED", "RGB+D", "RGB+ED"]
STEP = 1e-6
REFERENCE_BOUND, KERNEL_BOUND = 1e-6, 2e-4
SHAPE = ["means", "quats", "scales", "opacities", "colors"]


def generator_of(motion: int) -> Tensor:
    """The derivative [4, 4] of a motion of the camera: about x, y, z, then along x, y, z."""
    E = torch.zeros(4, 4, dtype=torch.float64)
    if motion < 3:
        a, b = (motion + 1) % 3, (motion + 2) % 3
        E[b, a], E[a, b] = 1, -1
    else:
        E[motion - 3, 3] = 1
    return E


def twist_gradient(gradients: Tensor, viewmats: Tensor) -> Tensor:
    """Gradients [C, 6] to the motions from those to the matrices [C, 4, 4], entry by entry."""
    motions = [generator_of(k) for k in range(6)]
    return torch.stack(
        [
            torch.stack([(gradient.double() * (E @ view.double())).sum() for E in motions])
            for gradient, view in zip(gradients, viewmats, strict=True)
        ]
    )


def loss(scene: dict[str, Any], weights: Tensor, mode: str, backend: str) -> Tensor:
    image, alpha, _ = rasterize(**scene, render_mode=mode, backend=backend)
    weights = weights.to(image)
    return (image * weights[..., : image.shape[-1]]).sum() + (alpha[..., 0] * weights[..., -1]).sum()


def weights_of(scene: dict[str, Any], seed: int = 7) -> Tensor:
    shape = len(scene["viewmats"]), scene["height"], scene["width"], 5
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def camera_gradient(scene: dict[str, Any], weights: Tensor, mode: str, backend: str) -> Tensor:
    dtype = torch.float32 if backend == "numba" else torch.float64
    converted = {name: v.to(dtype) if isinstance(v, Tensor) else v for name, v in scene.items()}
    viewmats = converted["viewmats"].clone().requires_grad_()
    loss({**converted, "viewmats": viewmats}, weights, mode, backend).backward()
    return viewmats.grad.double()


def losses_of_all_modes(scene: dict[str, Any], weights: Tensor) -> Tensor:
    """[MODES], from one render by the readable rasteriser."""
    image, alpha, _ = rasterize(**scene, render_mode="RGB+D", backend="torch")
    color, depth, covered = image[..., :3], image[..., 3:], (alpha * weights[..., -1:]).sum()
    expected = torch.where(alpha > 0, depth / alpha, 0.0)
    channels = {"RGB": color, "D": depth, "ED": expected, "RGB+D": image, "RGB+ED": torch.cat([color, expected], -1)}
    return torch.stack([(x * weights[..., : x.shape[-1]]).sum() + covered for x in (channels[m] for m in MODES)])


def finite_differences(scene: dict[str, Any], weights: Tensor) -> Tensor:
    """Gradients [MODES, C, 6]."""
    result = torch.zeros(len(MODES), len(scene["viewmats"]), 6, dtype=torch.float64)
    for c, view in enumerate(scene["viewmats"]):
        for k in range(6):
            steps = [torch.from_numpy(expm(sign * STEP * generator_of(k).numpy())) for sign in (1, -1)]
            ahead, back = (
                losses_of_all_modes(
                    {**scene, "viewmats": (step @ view)[None], "Ks": scene["Ks"][c : c + 1]}, weights[c : c + 1]
                )
                for step in steps
            )
            result[:, c, k] = (ahead - back) / (2 * STEP)
    return result


def error(got: Tensor, expected: Tensor) -> float:
    """The largest over cameras, relative to each one's largest entry."""
    got, expected = got.flatten(1), expected.flatten(1)
    assert (expected.abs().amax(1) > 0).all()
    return float(((got - expected).abs().amax(1) / expected.abs().amax(1)).max())


@pytest.mark.parametrize("sh_degree", [None, 0, 3])
def test_camera_gradient_equals_finite_differences_in_all_modes(make_scene, sh_degree):
    scene = make_scene(21, 40, 14, 11, sh_degree=sh_degree, cameras=2)
    weights = weights_of(scene)
    for mode, exact in zip(MODES, finite_differences(scene, weights), strict=True):
        for backend, bound in (("torch", REFERENCE_BOUND), ("numba", KERNEL_BOUND)):
            gradient = camera_gradient(scene, weights, mode, backend)
            assert error(twist_gradient(gradient, scene["viewmats"]), exact) < bound, (mode, backend)


@pytest.mark.parametrize(("seed", "n", "sh_degree"), [(31, 700, 3), (32, 700, None), (33, 1100, 1), (34, 20, 2)])
def test_all_entries_of_the_kernels_gradient_equal_autograd_in_float64(make_scene, seed, n, sh_degree):
    """Off the rigid motions too; more Gaussians than one block of partial sums holds."""
    scene = make_scene(seed, n, 37, 21, sh_degree=sh_degree, cameras=2)
    weights = weights_of(scene)
    exact = camera_gradient(scene, weights, "RGB+ED", "torch")
    assert error(camera_gradient(scene, weights, "RGB+ED", "numba"), exact) < KERNEL_BOUND
    assert not exact[:, 3].any()


def test_moving_the_camera_is_moving_all_gaussians_the_other_way(make_scene):
    """The same kernel's gradients to positions and rotations, in the camera's frame; plain colours look alike."""
    scene = {k: v.float() if isinstance(v, Tensor) else v for k, v in make_scene(41, 200, 30, 24).items()}
    names = ["means", "quats", "viewmats"]
    leaves = {name: scene[name].clone().requires_grad_() for name in names}
    loss({**scene, **leaves}, weights_of(scene), "RGB+D", "numba").backward()
    means, quats, view = (leaves[name].detach().double() for name in names)
    v_means, v_quats, v_view = (leaves[name].grad.double() for name in names)
    R, t = view[0, :3, :3], view[0, :3, 3]
    turn = torch.zeros(3, dtype=torch.float64)
    w, v = quats[:, :1], quats[:, 1:]
    for k in range(3):
        axis = R.T[:, k].expand(len(means), 3)  # in the world
        d_quats = 0.5 * torch.cat([-(axis * v).sum(1, keepdim=True), w * axis + torch.linalg.cross(axis, v)], 1)
        d_means = torch.linalg.cross(axis, means + R.T @ t)  # about the camera's centre
        turn[k] = (v_means * d_means).sum() + (v_quats * d_quats).sum()
    move = v_means.sum(0) @ R.T
    found = twist_gradient(v_view, view)
    assert error(found, torch.cat([turn, move])[None]) < KERNEL_BOUND


def test_cameras_have_gradients_of_their_own(make_scene):
    scene = make_scene(51, 60, 20, 18, sh_degree=2, cameras=3)
    weights = weights_of(scene)
    together = camera_gradient(scene, weights, "RGB+D", "numba")
    for c in range(3):
        alone = {**scene, "viewmats": scene["viewmats"][c : c + 1], "Ks": scene["Ks"][c : c + 1]}
        assert torch.equal(camera_gradient(alone, weights[c : c + 1], "RGB+D", "numba")[0], together[c])
        of_one = weights * (torch.arange(3) == c)[:, None, None, None]
        others = camera_gradient(scene, of_one, "RGB+D", "numba")
        assert torch.equal(others[c], together[c])
        assert not others[torch.arange(3) != c].any()


def test_gaussians_gradients_are_the_same_bits_with_and_without_the_cameras(make_scene):
    scene = make_scene(61, 300, 40, 30, sh_degree=3)
    scene = {name: v.float() if isinstance(v, Tensor) else v for name, v in scene.items()}
    gradients = []
    for with_cameras in (False, True):
        leaves = {name: scene[name].clone().requires_grad_() for name in SHAPE}
        viewmats = scene["viewmats"].clone().requires_grad_(with_cameras)
        loss({**scene, **leaves, "viewmats": viewmats}, weights_of(scene), "RGB+ED", "numba").backward()
        gradients.append({name: leaf.grad for name, leaf in leaves.items()})
        assert (viewmats.grad is not None) == with_cameras
    for name in SHAPE:
        assert torch.equal(gradients[0][name], gradients[1][name]), name
