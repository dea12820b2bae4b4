"""Hard cases of the radiance field: opaque and empty rays, cameras in odd places, colours and illuminations of zero.

References go sample by sample with Python's own numbers, or through plain torch in float64.
"""

import math
import sys

import numpy as np
import pytest
import torch

from novags.fields.box import Box, contracted
from novags.fields.cpu import encode
from novags.fields.evaluate import evaluate, gradients
from novags.fields.field import first_field
from novags.fields.layout import SIDE, FieldLayout
from novags.fields.march import Proposal, Rays, sampled, weights_of
from novags.fields.reference import evaluate_reference
from novags.methods.nerf import aleth
from novags.methods.nerf.shading import DARKEST, LEAST_LEVEL, SRGB_GAMMA, brightened
from tests.stability.case import EPS, LARGEST, Case, Error, Fails, Part, Setting, relative_error, worst_error

PART = Part("fields")
HERE = sys.modules[__name__]  # where the cases find what a test replaces


def _weights(log_density: list[list[float]], widths: list[list[float]]) -> float:
    """Error of the weights, and of the slope of their weighted sum along each log density."""
    raw, steps = torch.tensor(log_density, requires_grad=True), torch.tensor(widths)
    shares = torch.arange(1.0, raw.shape[1] + 1)
    found = weights_of(raw, steps)
    (found * shares).sum().backward()
    depths = [[math.exp(min(x, 15.0)) * w for x, w in zip(*row, strict=True)]
              for row in zip(raw.tolist(), steps.tolist(), strict=True)]  # fmt: skip
    wanted, slopes = [], []
    for row, logs in zip(depths, raw.tolist(), strict=True):
        before = [math.fsum(row[:i]) for i in range(len(row))]
        w = [math.exp(-b) * -math.expm1(-d) for b, d in zip(before, row, strict=True)]
        wanted.append(w)
        later = [math.fsum((j + 1) * w[j] for j in range(i + 1, len(row))) for i in range(len(row))]
        slopes.append([0.0 if x > 15 else d * ((i + 1) * math.exp(-b - d) - later[i])
                       for i, (x, b, d) in enumerate(zip(logs, before, row, strict=True))])  # fmt: skip
    assert raw.grad is not None
    return worst_error(((found.detach(), np.array(wanted)), (raw.grad, np.array(slopes))))


@PART.case("rays that are empty, or end in the first sample", bound=64 * EPS, unit=LARGEST)
def opaque_and_empty(setting: Setting) -> float:
    """Nothing weighs nothing, an opaque first sample all; a density beyond the limit has no slope."""
    return max(
        _weights([[80.0, 80.0, 1.0]], [[0.5, 0.5, 0.5]]),
        _weights([[14.0, 0.0, 14.0]], [[0.5, 0.5, 0.5]]),
        _weights([[-2.0, 14.9, 3.0], [-2.0, -1.0, 14.9]], [[0.1, 1e-3, 1.0], [0.0, 0.2, 0.0]]),
    )


@PART.case("rays through almost nothing", bound=64 * EPS, unit=LARGEST)
def thin(setting: Setting) -> float:
    """1 - exp(-x) for x down to 1e-30: the difference of two numbers near 1 would be 0."""
    return _weights([[-60.0, -69.0, -65.0]], [[1.0, 1.0, 1.0]])


@PART.case("positions on faces and corners of cells", bound=1e-5, unit=LARGEST, backends=("numba",))
def on_corners(setting: Setting) -> float:
    """Exactly on grid corners, and on the border of the cube: a cell too far would read another level's rows."""
    layout = FieldLayout(coarsest=4, finest=64, log2_rows=10)
    field = first_field(layout, 0, np.zeros(SIDE**3, bool))
    field.table.uniform_(-1, 1, generator=torch.Generator().manual_seed(0))
    ends = np.array([0.0, 0.25, 0.5, 1.0], np.float32)
    positions = np.stack(np.meshgrid(ends, ends, ends), -1).reshape(-1, 3)
    basis = np.array([[1, 0.6, 0, -0.8]], np.float32)
    raw, encoded = evaluate(field, positions, basis)
    tensors = {name: t.double().requires_grad_() for name, t in field.tensors().items()}
    exact = evaluate_reference(layout, tensors, field.seeded, torch.from_numpy(positions),
                               torch.from_numpy(basis).double())  # fmt: skip
    exact.sum().backward()
    found = gradients(field, positions, basis, encoded, np.ones_like(raw))
    pairs = [(raw, exact.detach()), *((found[name], t.grad) for name, t in tensors.items())]
    return worst_error(pairs)


@PART.case("cameras inside the box, far away, and of a scene a million units wide", bound=1e-4, unit=LARGEST,
           backends=("numba",))  # fmt: skip
def odd_cameras(setting: Setting) -> float:
    """Samples stay ordered, in the cube, and where the geometry says."""
    worst = 0.0
    for scale, place in (
        (1.0, (0.0, 0.0, 0.0)),
        (1.0, (0.0, 0.0, -900.0)),
        (1e6, (0.3e6, 0.0, -2e6)),
        (1e-4, (0, 0, 0)),
    ):
        box = Box(center=(0, 0, 0), half=(scale, scale, 0.4 * scale), near=0.01 * scale, middle=2 * scale,
                  far=1000 * scale)  # fmt: skip
        directions = torch.nn.functional.normalize(torch.tensor([[0.0, 0, 1], [1, 0, 0], [1e-20, -1, 1]]), dim=1)
        rays = Rays(torch.tensor([place] * 3, dtype=torch.float32), directions, torch.ones(3))
        for density in (0.0, 1e6):
            proposal = Proposal(np.full(SIDE**3, density, np.float32))
            found = sampled(rays, box, proposal, np.full((3, 17), 0.5, np.float32), 0.2)
            world = rays.origins[:, None].double() + found.distances[..., None].double() * directions[:, None].double()
            exact = contracted(world, box).reshape(-1, 3)
            ordered = bool((found.distances.diff(dim=1) >= 0).all() and (found.widths >= 0).all())
            worst = max(worst, relative_error(found.positions, exact.numpy()) if ordered else math.inf)
    return worst


@PART.case("aleth-nerf: the tone curve at 0, 1 and beyond", bound=2e-3, unit=LARGEST)
def tone_ends(setting: Setting) -> float:
    """The slope of the arc sine has no end there; the curve is held 5e-6 away from both, where it errs by 1.3e-3."""
    x = torch.tensor([-0.1, 0.0, 1e-6, 0.5, 1.0, 1.1], requires_grad=True)
    found = aleth.tone(x)
    found.sum().backward()
    if x.grad is None or not bool(torch.isfinite(x.grad).all()):
        return math.inf
    wanted = [0.5 - math.sin(math.asin(1 - 2 * min(max(v, 0.0), 1.0)) / 3) for v in x.tolist()]
    return relative_error(found.detach(), np.array(wanted))


@PART.case("ll-nerf: an illumination of zero, and a level of zero", bound=64 * EPS, unit=LARGEST)
def no_illumination(setting: Setting) -> float:
    """The power's slope at 0 has no end, and a level of 0 would divide by it."""
    light = torch.tensor([0.0, 1e-9, 1.0, 0.5], requires_grad=True)
    level = torch.tensor([0.0, 1.0, 0.0, 0.5], requires_grad=True)
    gamma = torch.tensor([0.0, 1.0, 0.0, 0.3])
    found = brightened(light, level, gamma)
    found.sum().backward()
    wanted, slopes = [], []
    for v, a, g in zip(light.tolist(), level.tolist(), gamma.tolist(), strict=True):
        power = 1 / (g + SRGB_GAMMA)
        wanted.append(((v + DARKEST) / (a + LEAST_LEVEL)) ** power)
        slopes.append(power * wanted[-1] / (v + DARKEST))
    return worst_error(((found.detach(), np.array(wanted)), (light.grad, np.array(slopes))))


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_a_difference_of_numbers_near_one_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def plain(log_density: torch.Tensor, widths: torch.Tensor) -> torch.Tensor:
        left = torch.exp(-torch.exp(log_density.clamp_max(15.0)) * widths)
        through = torch.cumprod(torch.cat([torch.ones_like(left[:, :1]), left[:, :-1]], 1), 1)
        return through * (1 - left)

    monkeypatch.setattr(HERE, "weights_of", plain)
    assert fails("rays through almost nothing")


def test_a_density_without_a_limit_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def unlimited(log_density: torch.Tensor, widths: torch.Tensor) -> torch.Tensor:
        depth = torch.exp(1.2 * log_density) * widths
        return torch.exp(-(torch.cumsum(depth, 1) - depth)) * -torch.expm1(-depth)

    monkeypatch.setattr(HERE, "weights_of", unlimited)
    assert fails("rays that are empty, or end in the first sample")


def test_a_tone_curve_without_ends_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aleth, "tone", lambda x: 0.5 - torch.sin(torch.asin(1 - 2 * x) / 3))
    assert fails("aleth-nerf: the tone curve at 0, 1 and beyond")


def test_levels_of_one_row_less_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    real = encode.forward

    def shifted(begin: int, end: int, positions: object, table: object, resolutions: object, *rest: object) -> None:
        real(begin, end, positions, table, resolutions - 1, *rest)

    monkeypatch.setattr(encode, "forward", shifted)
    assert fails("positions on faces and corners of cells")


def test_transmittance_as_a_difference_of_sums_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def cancelling(log_density: torch.Tensor, widths: torch.Tensor) -> torch.Tensor:
        depth = torch.exp(log_density.clamp_max(15.0)) * widths
        return torch.exp(-(torch.cumsum(depth, 1) - depth)) * -torch.expm1(-depth)

    monkeypatch.setattr(HERE, "weights_of", cancelling)
    assert fails("rays that are empty, or end in the first sample")
