"""Naka-GS's correction against its layers written out in numpy, and the authors' files."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from scipy.special import erf

from novags.methods import METHODS
from novags.methods.enhancers import ENHANCERS
from novags.methods.enhancers.curves.naka import naka
from novags.methods.enhancers.networks.naka import (
    NAKA_NET,
    Convolved,
    Correction,
    Down,
    Residual,
    Up,
    Weighed,
    blurred,
    even,
    response,
)
from novags.methods.enhancers.networks.rows.naka_net import NakaNetConfig
from novags.methods.enhancers.rows.naka import NakaConfig
from novags.methods.inputs import LacksInput
from novags.settings import changed
from tests.novags.methods.rivals.le3d.photographed import photographed

Conv = Callable[..., np.ndarray]


def randomised(module: torch.nn.Module) -> torch.nn.Module:
    generator = torch.Generator().manual_seed(0)
    module = module.double()
    for value in module.parameters():
        value.data = 0.3 * torch.randn(value.shape, generator=generator, dtype=torch.float64)
    return module


def numbers(value: torch.Tensor) -> np.ndarray:
    return value.detach().numpy()


def batched(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(values)[None]


def gelu(x: np.ndarray) -> np.ndarray:
    return x * (1 + erf(x / np.sqrt(2))) / 2


def convolved(x: np.ndarray, made: Convolved, conv: Conv, stride: int = 1, *, bent: bool = True) -> np.ndarray:
    """A convolution whose channels are normalised in eight groups."""
    found = conv(x, numbers(made.block[0].weight), None, 1, stride)
    groups = found.reshape(8, -1)
    groups = (groups - groups.mean(1, keepdims=True)) / np.sqrt(groups.var(1, keepdims=True) + 1e-5)
    gain, shift = (numbers(value)[:, None, None] for value in (made.block[1].weight, made.block[1].bias))
    found = groups.reshape(found.shape) * gain + shift
    return gelu(found) if bent else found


def residual(x: np.ndarray, made: Residual, conv: Conv) -> np.ndarray:
    return gelu(convolved(convolved(x, made.conv1, conv), made.conv2, conv, bent=False) + x)


def weighed(x: np.ndarray, made: Weighed) -> np.ndarray:
    first, _, second, _ = made.fc
    middle = gelu(numbers(first.weight)[..., 0, 0] @ x.mean((1, 2)) + numbers(first.bias))
    weights = 1 / (1 + np.exp(-(numbers(second.weight)[..., 0, 0] @ middle + numbers(second.bias))))
    return x * weights[:, None, None]


def test_a_level_on_the_way_down_keeps_its_features_and_halves_them(conv_by_hand: Conv) -> None:
    made = randomised(Down(8, 16, 1))
    x = np.random.default_rng(0).normal(size=(8, 5, 4))
    first, block, last = made.block
    wanted = weighed(residual(convolved(x, first, conv_by_hand), block, conv_by_hand), last)
    found, half = made(batched(x))
    np.testing.assert_allclose(numbers(found)[0], wanted, atol=1e-11)
    np.testing.assert_allclose(numbers(half)[0], convolved(wanted, made.down, conv_by_hand, 2), atol=1e-11)
    assert half.shape == (1, 16, 3, 2)


def test_a_level_on_the_way_up_joins_both_ways(conv_by_hand: Conv) -> None:
    made = randomised(Up(16, 8, 8))
    rng = np.random.default_rng(1)
    below, beside = rng.normal(size=(16, 3, 2)), rng.normal(size=(8, 5, 4))
    enlarged = below
    for axis, size in ((1, 5), (2, 4)):  # between middles of pixels, as they are behind the last middle
        places = (np.arange(size) + 0.5) * enlarged.shape[axis] / size - 0.5
        middles = np.arange(enlarged.shape[axis])
        enlarged = np.apply_along_axis(lambda line: np.interp(places, middles, line), axis, enlarged)  # noqa: B023
    wanted = convolved(np.concatenate([enlarged, beside]), made.reduce, conv_by_hand)
    for block in made.block[:2]:
        wanted = residual(wanted, block, conv_by_hand)
    found = made(batched(below), batched(beside))
    np.testing.assert_allclose(numbers(found)[0], weighed(wanted, made.block[2]), atol=1e-10)


@pytest.mark.parametrize("shape", [(13, 10), (3, 2)])
def test_the_whole_corrects_the_blurred_part_of_the_raised_picture(conv_by_hand: Conv, shape: tuple[int, int]) -> None:
    """The levels by the parts above; what goes in and what comes out by hand."""
    made = randomised(Correction(8))
    dark = np.random.default_rng(2).uniform(0, 0.2, (3, *shape))
    raised, _ = naka(torch.from_numpy(dark).movedim(0, -1), NakaConfig(), None, None)
    raised = raised.movedim(-1, 0).numpy()
    seen = [dark, raised, raised - dark]
    seen += [(each - each.mean((1, 2), keepdims=True)) / each.std((1, 2), keepdims=True) for each in seen]
    x = batched(convolved(np.concatenate(seen), made.stem, conv_by_hand))
    kept = []
    for level in (made.down1, made.down2, made.down3):
        found, x = level(x)
        kept.append(found)
    x = made.bottleneck(x)
    for level, beside in ((made.up3, kept[2]), (made.up2, kept[1]), (made.up1, kept[0])):
        x = level(x, beside)
    x = numbers(made.fuse(x))[0]
    heads = [conv_by_hand(x, numbers(head.weight), numbers(head.bias), 1) for head in (made.mul_head, made.add_head)]
    factor, summand = 1 + 0.6 * np.tanh(heads[0]), 0.25 * np.tanh(heads[1])
    smooth = np.stack([cv2.GaussianBlur(each, (5, 5), 1.0, borderType=cv2.BORDER_CONSTANT) for each in raised])
    wanted = smooth * factor + summand + raised - smooth
    np.testing.assert_allclose(numbers(made(batched(dark)))[0], wanted, atol=1e-10)
    assert np.abs(wanted - raised).max() > 0.1


def test_each_picture_of_a_batch_is_a_picture_by_itself() -> None:
    made = randomised(Correction(8))
    pictures = torch.rand(3, 3, 9, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    pictures *= torch.tensor([0.02, 0.2, 0.9], dtype=torch.float64)[:, None, None, None]
    alone = torch.cat([made(each[None]) for each in pictures])
    torch.testing.assert_close(made(pictures), alone, rtol=0, atol=1e-12)


def test_the_response_is_the_curve_of_the_row_without_a_network() -> None:
    dark = 0.3 * torch.rand(2, 3, 7, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(4))
    for each, found in zip(dark, response(dark), strict=True):
        wanted, _ = naka(each.movedim(0, -1), NakaConfig(), None, None)
        torch.testing.assert_close(found.movedim(0, -1), wanted, rtol=0, atol=1e-12)


def test_a_flat_picture_stays_finite_and_has_finite_slopes() -> None:
    made, flat = randomised(Correction(8)), torch.full((1, 3, 8, 8), 0.25, dtype=torch.float64)
    assert torch.equal(response(flat), flat)
    assert torch.equal(even(flat), torch.zeros_like(flat))
    found = made(flat.requires_grad_())
    found.sum().backward()
    assert found.isfinite().all()
    assert flat.grad is not None
    assert flat.grad.isfinite().all()


def test_black_lies_around_the_blur() -> None:
    white = torch.ones(1, 3, 7, 7, dtype=torch.float64)
    found = blurred(white)
    assert found[0, 1, 3, 3] == pytest.approx(1.0)
    line = np.exp(-(np.arange(-2, 3) ** 2) / 2.0)
    assert found[0, 2, 0, 3] == pytest.approx(line[2:].sum() / line.sum())


def as_published(network: Correction) -> dict[str, object]:
    """A checkpoint as the authors' program saves it."""
    optimizer = {"state": {0: {"step": torch.tensor(3.0)}}, "param_groups": [{"lr": 2e-4}]}
    return {"epoch": 7, "model": network.state_dict(), "optimizer": optimizer, "args": {"seed": 42}}


def test_a_file_of_the_authors_is_read_as_it_is(tmp_path: Path) -> None:
    torch.manual_seed(5)
    made = Correction()
    assert sum(value.numel() for value in made.parameters()) == 5_443_620  # the authors' class has as many
    torch.save(as_published(made), tmp_path / "best.pth")
    config = NakaNetConfig(weights=(tmp_path / "best.pth",))
    dark = 0.1 * torch.rand(10, 12, 3)
    wanted = made.eval()(dark.movedim(-1, 0)[None])[0].movedim(0, -1).clamp(0, 1)
    found, params = ENHANCERS["naka-net"].enhance(dark, config, None, None)
    assert params is None
    assert torch.equal(found, wanted.detach())


def test_an_older_file_has_a_factor_for_each_channel(tmp_path: Path) -> None:
    made = Correction()
    saved = as_published(made)
    weights = {name: value.clone() for name, value in made.state_dict().items()}
    weights["mul_head.weight"], weights["mul_head.bias"] = torch.randn(3, 32, 3, 3), torch.tensor([0.0, 1.0, 5.0])
    torch.save(saved | {"model": weights}, tmp_path / "best.pth")
    read = NAKA_NET.load(NakaNetConfig(weights=(tmp_path / "best.pth",)))
    assert isinstance(read, Correction)
    torch.testing.assert_close(read.mul_head.weight[0], weights["mul_head.weight"].mean(0))
    assert float(read.mul_head.bias[0]) == 2.0


def test_a_file_of_another_network_is_refused(tmp_path: Path) -> None:
    torch.save({"model": Correction(16).state_dict()}, tmp_path / "other.pth")
    with pytest.raises(
        ValueError, match="other.pth: the network needs a tensor stem.block.0.weight of .*another network"
    ):
        NAKA_NET.load(NakaNetConfig(weights=(tmp_path / "other.pth",)))


def test_a_scene_is_fitted_to_the_corrected_pictures(tmp_path: Path) -> None:
    torch.manual_seed(6)
    torch.save(as_published(Correction()), tmp_path / "best.pth")
    inputs, _ = photographed("a7s2-iso6400-3chip")  # 96 px
    config = changed(METHODS["naka-net-gs"].config(), {"fit.iterations": 2}, what="x")
    enhance = NakaNetConfig(weights=(tmp_path / "best.pth",))
    result = METHODS["naka-net-gs"].train(inputs, dataclasses.replace(config, enhance=enhance))
    network = NAKA_NET.load(enhance)  # one picture after the other: all at once float32 rounds otherwise
    pictures = torch.cat([network(view[None].movedim(-1, 1)).movedim(1, -1) for view in inputs.srgb8]).clamp(0, 1)
    assert result.targets is not None
    torch.testing.assert_close(result.targets, pictures, rtol=0, atol=1e-5)
    assert result.render(inputs.views)[0].isfinite().all()
    with pytest.raises(LacksInput, match="Naka-GS has no weights: set enhance.weights to the authors' best.pth"):
        METHODS["naka-net-gs"].train(inputs, config)
