"""Hard cases of the rasteriser: needles, quaternions of hardly any length, dust and giants, 100,000 layers.

Every case is rendered in float32 and in float64 by `dense`, with a random weighting of image and alpha; its error is
the worst of image, alpha and the gradients of all five tensors. "torch" is the readable rasteriser.
"""

import itertools
import math
from functools import lru_cache

import mpmath
import pytest
import torch
from torch import Tensor

from novags.splats.raster import raster_numba, raster_torch
from novags.splats.raster.rasterize import rasterize
from tests.stability.case import EPS, LARGEST, Case, Error, Fails, Part, Setting, refusal, worst_error
from tests.stability.splats.dense import NAMES, Camera, render

PART = Part("splats")

ALL = ("numba", "torch", "gsplat")
# A splat's exponent is at most 5.5 (255 e^-5.5 = 1) and has some ten roundings; gradients in quaternions are sums over
# pixels that cancel: some hundred roundings.
ORDINARY = 100 * EPS
Scene = dict[str, Tensor]


def _scene(n: int, *, seed: int = 0, depth: float = 4.0) -> Scene:
    """N ordinary Gaussians in front of the camera, float64 rounded to float32."""
    g = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=g, dtype=torch.float64)

    scene = {
        "means": (uniform(n, 3) - 0.5) * torch.tensor([2.0, 2.0, 1.0]) + torch.tensor([0.0, 0.0, depth]),
        "quats": torch.randn(n, 4, generator=g, dtype=torch.float64),
        "scales": torch.exp(-1.5 - uniform(n, 3)),
        "opacities": 0.2 + 0.6 * uniform(n),
        "colors": uniform(n, 3),
    }
    return {name: value.float().double() for name, value in scene.items()}


def _weights(camera: Camera) -> Tensor:
    g = torch.Generator().manual_seed(1)
    return torch.rand(camera.height, camera.width, 4, generator=g, dtype=torch.float64) + 0.5


def _rendered(setting: Setting, scene: Scene, camera: Camera, dtype: torch.dtype) -> list[Tensor]:
    """Image, alpha and five gradients, by the library."""
    device = "cuda" if setting.backend == "gsplat" else "cpu"
    leaves = {name: scene[name].detach().to(device, dtype).requires_grad_() for name in NAMES}
    means, quats, scales, opacities, colors = leaves.values()
    viewmat, K = torch.eye(4, dtype=dtype, device=device), camera.matrix(dtype).to(device)
    images, alphas, _ = rasterize(
        means, quats, scales, opacities, colors, viewmat[None], K[None], camera.width, camera.height,
        backend=setting.backend,
    )  # fmt: skip
    weights = _weights(camera).to(device, dtype)
    ((images[0] * weights[..., :3]).sum() + (alphas[0, ..., 0] * weights[..., 3]).sum()).backward()
    slopes = [torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for leaf in leaves.values()]
    return [images[0].detach(), alphas[0, ..., 0].detach(), *slopes]


def _exact(scene: Scene, camera: Camera) -> list[Tensor]:
    leaves = {name: scene[name].detach().clone().requires_grad_() for name in NAMES}
    means, quats, scales, opacities, colors = leaves.values()
    image, alpha = render(means, quats, scales, opacities, colors, camera)
    weights = _weights(camera)
    ((image * weights[..., :3]).sum() + (alpha * weights[..., 3]).sum()).backward()
    slopes = [torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for leaf in leaves.values()]
    return [image.detach(), alpha.detach(), *slopes]


def _error(setting: Setting, scene: Scene, camera: Camera, dtype: torch.dtype = torch.float32) -> float:
    return worst_error(zip(_rendered(setting, scene, camera, dtype), _exact(scene, camera), strict=True))


def _single(**changes: Tensor | list[float] | float) -> Scene:
    """One Gaussian in the middle of the image, turned, changed."""
    scene = {
        "means": [[0.1, -0.05, 4.0]], "quats": [[0.9, 0.2, -0.3, 0.1]], "scales": [[0.3, 0.2, 0.1]],
        "opacities": [0.7], "colors": [[0.2, 0.5, 0.9]],
    }  # fmt: skip
    made = {name: torch.tensor(value, dtype=torch.float64) for name, value in scene.items()}
    made |= {
        name: torch.as_tensor(value, dtype=torch.float64).reshape(made[name].shape) for name, value in changes.items()
    }
    return {name: value.float().double() for name, value in made.items()}


SMALL = Camera(20, 18, 30.0)


@PART.case("needles: near-singular covariances", bound=1e-4, unit=LARGEST, backends=("numba",))
def needles(setting: Setting) -> float:
    """Condition 1e10; up to 750 px long on the image and 0.5 px wide, the width that is added to every splat.

    c_xx c_yy - c_xy^2 would lose six of seven digits. What is left is the position across the needle: a rounding of its
    direction, times its length where it crosses the image.
    """
    lengths = [(100.0, 1e-3, 1e-3), (1.0, 1e-5, 1e-5), (10.0, 10.0, 1e-4), (3.0, 1e-3, 0.0)]
    return max(_error(setting, _single(scales=torch.tensor(length)), SMALL) for length in lengths)


@PART.case("needles by the readable rasteriser, in float64", bound=1e-8, unit=LARGEST, backends=("torch",))
def needles_in_float64(setting: Setting) -> float:
    """It inverts the covariance and so loses digits; float64, in which it is meant to check others, has 16 of them."""
    lengths = [(100.0, 1e-3, 1e-3), (1.0, 1e-5, 1e-5), (10.0, 10.0, 1e-4), (3.0, 1e-3, 0.0)]
    return max(_error(setting, _single(scales=torch.tensor(length)), SMALL, torch.float64) for length in lengths)


@PART.case("quaternions of length 1e-20, 1e20 and subnormal", bound=ORDINARY, unit=LARGEST, backends=ALL)
def quaternion_lengths(setting: Setting) -> float:
    """Their squares leave float32. The slope in a quaternion of length 1e-20 is 1e20 times the usual."""
    unit = torch.tensor([[0.9, 0.2, -0.3, 0.1]])
    return max(_error(setting, _single(quats=unit * length), SMALL) for length in (1e-20, 1e-30, 1e20, 1e-7, 1e5))


@PART.case("quaternions of length 0", bound=0, unit="refused", backends=ALL)
def no_quaternion(setting: Setting) -> float:
    """It is not a rotation."""
    scene = _scene(5)
    scene["quats"][3] = 0
    return refusal(lambda: _rendered(setting, scene, SMALL, torch.float32), "quats must not be zero", "Gaussian 3")


@PART.case("log scales -40 to 20", bound=ORDINARY, unit=LARGEST, backends=("numba", "torch"))
def log_scales(setting: Setting) -> float:
    """Dust that is a pixel all the same, and a giant that covers the image evenly.

    A giant's position and scale hardly matter: slopes are compared together, in units of log scales.
    """
    worst = 0.0
    for log_scale in (-40.0, -20.0, -5.0, 5.0, 20.0):
        scene = _single(scales=torch.full((1, 3), math.exp(log_scale)))
        found, wanted = _rendered(setting, scene, SMALL, torch.float32), _exact(scene, SMALL)
        slopes = []
        for values in (found, wanted):
            values[4] = values[4].double() * scene["scales"]
            slopes.append(torch.cat([value.flatten() for value in values[2:]]))
        worst = max(worst, worst_error([(found[0], wanted[0]), (found[1], wanted[1]), (slopes[0], slopes[1])]))
    return worst


@PART.case("log scale 40: right, or refused with its place", bound=ORDINARY, unit=LARGEST, backends=("numba", "torch"))
def giant(setting: Setting) -> float:
    """Its variance on the image is 1e36 px^2, the determinant 1e72."""
    scene = _single(scales=torch.full((1, 3), math.exp(40.0)))
    try:
        found = _rendered(setting, scene, SMALL, torch.float32)
    except ValueError as problem:
        return 0.0 if "overflow float32" in str(problem) and "scales 2.35e+17 at [0, 0]" in str(problem) else math.inf
    return worst_error(zip(found[:2], _exact(scene, SMALL)[:2], strict=True))


@PART.case("logits -100 to 100", bound=ORDINARY, unit=LARGEST, backends=ALL)
def logits(setting: Setting) -> float:
    """Opacities 0 and 1 exactly: not seen, and capped at 0.999 without a slope, in few pixels and in all."""
    worst = 0.0
    choices = ([0.0, 1.0, 0.5], [1.0, 1.0, 1.0], [1 / (1 + math.exp(100.0)), 1.0, 1 - 6e-8])
    for opacities, size in itertools.product(choices, (1.0, 40.0)):
        scene = _scene(3, seed=4)
        scene["scales"] *= size
        scene["opacities"] = torch.tensor(opacities).float().double()
        worst = max(worst, _error(setting, scene, SMALL))
    return worst


@PART.case("100,000 layers", bound=5e-4, unit=LARGEST, backends=ALL)
def layers(setting: Setting) -> float:
    """Faint ones, of which 2,300 are seen before a pixel stops, and as many that nothing is seen of.

    On its way back the kernel divides the transmittance by 1 - alpha 2,300 times: as many roundings, 1e-4. A pixel may
    stop one layer earlier or later, which is 4e-7 of alpha.
    """
    scene, exact = _many_layers()
    return worst_error(zip(_rendered(setting, scene, LAYERED, torch.float32), exact, strict=True))


LAYERED = Camera(4, 3, 6.0)


@lru_cache  # the settings share it
def _many_layers() -> tuple[Scene, list[Tensor]]:
    n, g = 100_000, torch.Generator().manual_seed(0)
    scene = {
        "means": torch.stack([torch.zeros(n), torch.zeros(n), torch.linspace(1, 50, n)], 1),
        "quats": torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        "scales": torch.linspace(1, 50, n)[:, None].repeat(1, 3) * 20,
        "opacities": torch.full((n,), 0.004),
        "colors": torch.rand(n, 3, generator=g),
    }
    scene = {name: value.float().double() for name, value in scene.items()}
    return scene, _exact(scene, LAYERED)


@PART.case("one ordinary scene, for comparison", bound=ORDINARY, unit=LARGEST, backends=ALL)
def ordinary(setting: Setting) -> float:
    """What is left where nothing is hard."""
    return _error(setting, _scene(6), SMALL)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_a_conic_that_cancels_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    # in float32 the readable rasteriser, which inverts the covariance, is what the kernels must not be
    monkeypatch.setattr(raster_numba, "render", raster_torch.render)
    assert fails("needles: near-singular covariances", "numba")


def test_squares_of_short_quaternions_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(raster_torch, "unit_largest", lambda quats: quats)
    assert fails("quaternions of length 1e-20, 1e20 and subnormal", "torch")


def test_layers_in_half_precision_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    composite = raster_torch.composite

    def coarse(means2d, covs2d, opacities, *others):
        return composite(means2d, covs2d, opacities.bfloat16().float(), *others)

    monkeypatch.setattr(raster_torch, "composite", coarse)
    for name in ("100,000 layers", "logits -100 to 100", "one ordinary scene, for comparison"):
        assert fails(name, "torch"), name


def test_a_slope_through_the_cap_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def leaking(x, largest):
        return x + (torch.minimum(x, torch.tensor(largest)) - x).detach()

    monkeypatch.setattr(torch, "clamp_max", leaking)
    assert fails("logits -100 to 100", "torch")


def test_dust_without_the_added_variance_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    dilated = raster_torch.dilated
    monkeypatch.setattr(raster_torch, "dilated", lambda M, eps2d: dilated(M, 0.2))
    assert fails("log scales -40 to 20", "torch")


def test_the_reference_equals_one_splat_at_fifty_digits() -> None:
    scene = _single(quats=[1.0, 0, 0, 0], scales=[100.0, 1e-3, 1e-3], means=[0.1, -0.05, 4.0])
    image, alpha = render(**scene, camera=SMALL)
    with mpmath.workdps(50):
        x, y, z, f = (mpmath.mpf(float(v)) for v in (*scene["means"][0], SMALL.focal))
        sx, sy, sz = (mpmath.mpf(float(v)) for v in scene["scales"][0])
        J = mpmath.matrix([[f / z, 0, -f * x / z**2], [0, f / z, -f * y / z**2]])
        S = mpmath.diag([sx**2, sy**2, sz**2])
        conic = (J * S * J.T + mpmath.mpf("0.3") * mpmath.eye(2)) ** -1
        d = mpmath.matrix([14.5 - f * x / z - SMALL.width / 2, 8.5 - f * y / z - SMALL.height / 2])
        expected = mpmath.mpf(float(scene["opacities"][0])) * mpmath.exp(-(d.T * conic * d)[0] / 2)
    assert float(alpha[8, 14]) == pytest.approx(float(expected), rel=1e-12)
    assert image[8, 14].tolist() == pytest.approx([float(expected * c) for c in scene["colors"][0].tolist()], rel=1e-12)
