"""Curves and axes of Luminance-GS against slow versions, pixel by pixel and number by number."""

import math
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.rivals.luminance_curve import (
    BINS,
    CurveAttention,
    ViewCurves,
    equalising_curve,
    mapped,
    orthogonal_axes,
    power_then_s,
)


def picture(height: int = 9, width: int = 7) -> torch.Tensor:
    return torch.rand(height, width, 3, generator=torch.Generator().manual_seed(2))


def test_axes_are_orthogonal_and_the_second_has_the_green_and_blue_it_was_given() -> None:
    first, second = torch.tensor([0.9, -0.2, 0.3]).double(), torch.tensor([1.1, 0.4]).double()
    axes = orthogonal_axes(first, second).numpy()
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(axes[0], first.numpy() / np.linalg.norm(first.numpy()))
    assert axes[1][1] / axes[1][2] == pytest.approx(1.1 / 0.4)
    assert np.linalg.det(axes) == pytest.approx(1)
    ahead = orthogonal_axes(torch.tensor([1.0, 0, 0]), torch.tensor([1.0, 0]))
    assert torch.equal(ahead, torch.eye(3))


def test_a_picture_is_mapped_pixel_by_pixel_along_the_axes() -> None:
    axes = orthogonal_axes(torch.tensor([0.8, 0.3, -0.2]), torch.tensor([0.9, 0.2]))
    curve = torch.linspace(0, 1, BINS) ** 0.4
    found = mapped(picture(), axes, curve).numpy()
    rows, table = axes.numpy().astype(float), curve.numpy().astype(float)
    for (y, x), _ in np.ndenumerate(found[..., 0]):
        pixel, want = picture()[y, x].numpy().astype(float), np.zeros(3)
        for axis in rows:
            low, high = sum(min(a, 0) for a in axis), sum(max(a, 0) for a in axis)
            place = (pixel @ axis - low) / (high - low)
            index = place * (BINS - 1)
            if abs(index - round(index)) < 1e-3:  # where rounding decides which bin it is
                break
            want += (table[math.floor(index)] * (high - low) + low) * axis
        else:
            np.testing.assert_allclose(found[y, x], want, atol=1e-5)


def test_the_straight_curve_changes_a_picture_by_less_than_a_bin() -> None:
    same = mapped(picture(), torch.eye(3), torch.linspace(0, 1, BINS))
    assert float((picture() - same).min()) > -1e-6
    assert float((picture() - same).max()) < 1 / (BINS - 1) + 1e-6


def test_gradients_reach_the_curve_where_the_picture_has_colours_and_the_axes() -> None:
    curve = torch.linspace(0, 1, BINS).requires_grad_()
    first = torch.tensor([1.0, 0.1, 0.0], requires_grad=True)
    mapped(picture(), orthogonal_axes(first, torch.tensor([1.0, 0.0])), curve).sum().backward()
    assert curve.grad is not None
    used = curve.grad.nonzero()[:, 0]
    assert 0 < len(used) <= 3 * 63
    assert first.grad is not None
    assert float(first.grad.abs().sum()) > 0


@pytest.mark.parametrize(("gamma", "alpha", "beta"), [(1.0, 0.5, 1.0), (0.6, 0.4, 1.8), (1.7, 0.7, 0.6)])
def test_a_power_law_is_followed_by_an_s_curve(gamma: float, alpha: float, beta: float) -> None:
    found = power_then_s(*(torch.tensor(v) for v in (gamma, alpha, beta))).numpy()
    for i, value in enumerate(found):
        x = max(i / (BINS - 1), 1e-3) ** gamma
        if x <= alpha:
            want = alpha - alpha * (1 - min(x / alpha, 1 - 1e-3)) ** beta
        else:
            want = alpha + (1 - alpha) * min(max((x - alpha) / (1 - alpha), 1e-3), 1 - 1e-3) ** beta
        assert value == pytest.approx(want, abs=1e-5)


def test_the_equalising_curve_is_the_cumulative_histogram() -> None:
    image = picture(21, 33) ** 2
    grey = image[::4, ::4].numpy().mean(-1).reshape(-1)
    counts, _ = np.histogram(grey, BINS, (0, 1))
    np.testing.assert_allclose(equalising_curve(image).numpy(), np.cumsum(counts) / len(grey), atol=1e-6)


def test_the_attention_is_that_of_its_definition() -> None:
    torch.manual_seed(0)
    network = CurveAttention(5).double()
    for parameter in network.parameters():  # as if it had trained: weights and biases that count
        parameter.data = torch.randn(parameter.shape).double() * 0.3
    image, pose = torch.rand(3, 8, 8).double(), torch.rand(4, 4).double()
    w = {name: p.detach().numpy() for name, p in network.named_parameters()}

    def convolved(x: np.ndarray, layer: str) -> np.ndarray:
        weight, bias = w[f"{layer}.weight"], w[f"{layer}.bias"]
        wide = np.pad(x, ((0, 0), (1, 1), (1, 1)))
        out = np.zeros((len(weight), *x.shape[1:]))
        for y in range(x.shape[1]):
            for z in range(x.shape[2]):
                out[:, y, z] = (weight * wide[None, :, y : y + 3, z : z + 3]).sum((1, 2, 3)) + bias
        return np.maximum(out, 0)

    near = convolved(image.numpy(), "near").reshape(64, 4, 2, 4, 2).max((2, 4))
    cells = convolved(near, "far").reshape(128, 16).T  # 4 x 4 already
    keys = cells @ w["key.weight"].T + w["key.bias"]
    values = cells @ w["value.weight"].T + w["value.bias"]
    query = w["query.weight"] @ pose.numpy().reshape(-1) + w["query.bias"]
    scores = np.exp((keys @ query - (keys @ query).max()) / math.sqrt(128))
    want = w["out.weight"] @ (scores / scores.sum() @ values) + w["out.bias"]
    np.testing.assert_allclose(network(image, pose).detach().numpy(), want, rtol=1e-9)


def test_views_begin_with_curves_that_change_next_to_nothing_and_know_their_pose(monkeypatch: Any) -> None:
    pictures = torch.stack([picture(40, 30), picture(40, 30) / 2])
    viewmats = torch.eye(4).repeat(2, 1, 1)
    viewmats[1, 0, 3] = 3.0
    torch.manual_seed(1)
    curves = ViewCurves(pictures, viewmats, 16)
    assert curves.small.shape == (2, 3, 16, 12)
    torch.testing.assert_close(curves.poses[1][:3, 3], torch.tensor([-3.0, 0, 0]))  # camera to world
    curve, shape = curves.curves(1)
    torch.testing.assert_close(curve, torch.linspace(0, 1, BINS), rtol=0, atol=5e-3)
    torch.testing.assert_close(shape, torch.linspace(0, 1, BINS), rtol=0, atol=5e-3)
    torch.testing.assert_close(curves.brightened(1, curve), pictures[1], rtol=0, atol=1 / 100)
    with torch.no_grad():
        curves.curve += 2.0
    assert float(curves.curves(0)[0].detach().max()) == 1


def test_what_the_second_attention_says_bends_the_shape_by_small_shares_of_it() -> None:
    curves = ViewCurves(torch.stack([picture(16, 16)]), torch.eye(4)[None], 16)
    with torch.no_grad():
        curves.shape.out.weight.zero_()
        curves.shape.out.bias.copy_(torch.tensor([2.0, 50.0, -100.0]))
    want = power_then_s(*(torch.tensor(v) for v in (1.2, 0.6, 0.8)))
    torch.testing.assert_close(curves.curves(0)[1].detach(), want, rtol=1e-5, atol=1e-6)


def test_every_view_has_a_curve_a_shape_and_axes_of_its_own() -> None:
    """From its own picture, pose and axes; what a curve lacks to 0 or has above 1 is cut."""
    g = torch.Generator().manual_seed(5)
    pictures, viewmats = torch.rand(3, 8, 6, 3, generator=g), torch.eye(4).repeat(3, 1, 1)
    viewmats[:, :3, 3] = torch.rand(3, 3, generator=g)
    curves = ViewCurves(pictures, viewmats, 64).requires_grad_(False)
    for parameter in curves.parameters():
        parameter.copy_(0.3 * torch.randn(parameter.shape, generator=g))
    for view in range(3):
        # smaller than `size`: the attention sees the picture as it is
        image, pose = pictures[view].movedim(-1, 0), torch.linalg.inv(viewmats[view])
        whole, (gamma, alpha, beta) = curves.curve + curves.bend(image, pose), curves.shape(image, pose)
        curve, shape = curves.curves(view)
        assert float(whole.min()) < 0
        assert float(whole.max()) > 1
        torch.testing.assert_close(curve, whole.clamp(0, 1))
        torch.testing.assert_close(shape, power_then_s(1 + 0.1 * gamma, 0.5 + 0.002 * alpha, 1 + 0.002 * beta))
        ahead = torch.tensor([1.0, 0, 0])
        axes = orthogonal_axes(curves.first[view] + ahead, curves.second[view] + ahead[:2])
        torch.testing.assert_close(curves.brightened(view, curve), mapped(pictures[view], axes, curve))
