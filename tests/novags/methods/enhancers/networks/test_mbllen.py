"""MBLLEN against its layers written out in numpy, the adjustment of its result, and the official Keras file."""

import colorsys

import numpy as np
import pytest
import torch

from novags.methods.enhancers.files.weights import read_weights
from novags.methods.enhancers.networks.mbllen import MBLLEN, Mbllen, adjust, from_keras, run, typical
from novags.methods.enhancers.networks.rows.mbllen import MbllenConfig


def network() -> Mbllen:
    made = Mbllen().double()
    generator = torch.Generator().manual_seed(0)
    for value in made.parameters():
        value.data = 0.05 + 0.12 * torch.randn(value.shape, generator=generator, dtype=torch.float64)
    return made


def transposed(x: np.ndarray, weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Every value of x adds the kernel times itself where it lies."""
    height, width, size = x.shape[1], x.shape[2], weight.shape[2]
    found = np.zeros((weight.shape[1], height + size - 1, width + size - 1))
    for c, i, j in np.ndindex(x.shape):
        found[:, i : i + size, j : j + size] += x[c, i, j] * weight[c]
    return found + bias[:, None, None]


def by_hand(made: Mbllen, x: np.ndarray, conv) -> np.ndarray:
    def layer(name: str, seen: np.ndarray, pad: int | None = None) -> np.ndarray:
        own = made.get_submodule(name)
        weight, bias = own.weight.detach().numpy(), own.bias.detach().numpy()
        return np.maximum(transposed(seen, weight, bias) if pad is None else conv(seen, weight, bias, pad), 0)

    pictures, number, number_up = [], 1, 1
    for _ in range(10):
        x = layer(f"conv2d_{number}", x, 1)
        branch = layer(f"conv2d_{number + 1}", x, 1)
        for i in (2, 3, 4):
            branch = layer(f"conv2d_{number + i}", branch, 0)
        for i in range(3):
            branch = layer(f"conv2d_transpose_{number_up + i}", branch)
        pictures.append(branch)
        number, number_up = number + 5, number_up + 3
    return layer("conv2d_51", np.concatenate(pictures), 0)


def test_the_network_is_ten_branches_mixed(conv_by_hand):
    made, x = network(), np.random.default_rng(0).uniform(0, 0.3, (3, 13, 14))
    wanted = by_hand(made, x, conv_by_hand)
    assert wanted.std() > 1e-3
    np.testing.assert_allclose(made(torch.from_numpy(x)[None])[0].detach(), wanted, rtol=1e-9, atol=1e-12)


def test_small_pictures_are_extended_by_their_border_and_cut_back():
    made, x = network(), torch.rand(1, 3, 2, 20, dtype=torch.float64)
    whole = torch.cat([x, x[:, :, -1:].expand(-1, -1, 11, -1)], 2)
    assert torch.equal(run(made, x, MbllenConfig()), made(whole)[:, :, :2])


def grey(pixel: np.ndarray) -> float:
    return 0.299 * pixel[0] + 0.587 * pixel[1] + 0.114 * pixel[2]


def test_the_result_is_stretched_and_its_saturation_raised_as_the_authors_program_does():
    rng = np.random.default_rng(1)
    bright = rng.uniform(0.05, 0.5, (9, 11, 3))
    bright[0, 0] = 0.3  # grey: no saturation
    found, params = adjust(torch.from_numpy(bright).movedim(-1, 0)[None], MbllenConfig(), None)
    factor = 0.8 / np.quantile([grey(p) for p in bright.reshape(-1, 3)], 0.95)
    scaled = np.minimum(bright * factor, 1)
    black = np.quantile([grey(p) for p in scaled.reshape(-1, 3)], 0.05)
    np.testing.assert_allclose(params, [factor, black])
    for p, shown in zip(scaled.reshape(-1, 3), found[0].movedim(0, -1).reshape(-1, 3).numpy(), strict=True):
        hue, saturation, value = colorsys.rgb_to_hsv(*np.clip((p - black) / (1 - black), 0, 1))
        np.testing.assert_allclose(shown, colorsys.hsv_to_rgb(hue, saturation**0.8, value), atol=1e-9)


def test_a_result_with_enough_bright_pixels_is_not_multiplied():
    bright = torch.full((1, 3, 10, 10), 0.3, dtype=torch.float64)
    bright[..., 0, :6] = 0.9  # 6 %
    assert adjust(bright, MbllenConfig(), None)[1].tolist() == [1.0, 0.3]
    bright[..., 0, 4:] = 0.3  # 4 %
    assert adjust(bright, MbllenConfig(), None)[1][0] == pytest.approx(0.8 / 0.3)


def test_pixels_above_white_count_as_bright_and_not_among_the_others():
    bright = torch.full((1, 3, 25, 40), 0.3, dtype=torch.float64)
    bright[:, :, 0] = 1.5
    bright[:, :, 1, :8] = 1.5  # 48 of 1,000; 5 % of the other 952 are 47.6
    assert adjust(bright, MbllenConfig(), None)[1][0] == 1.0
    bright[:, :, 1, :8] = 0.3
    assert adjust(bright, MbllenConfig(), None)[1][0] == pytest.approx(0.8 / 0.3)


def test_a_white_result_stays_white():
    white = torch.ones(1, 3, 6, 7)
    torch.testing.assert_close(adjust(white, MbllenConfig(), None)[0], white)


def test_a_twin_is_adjusted_by_the_parameters_of_its_picture():
    a, b = (0.1 + 0.4 * torch.rand(1, 3, 8, 9, generator=torch.Generator().manual_seed(i)) for i in (0, 1))
    found, params = adjust(a, MbllenConfig(), None)
    mixed = torch.cat([a[:, :, :4], 0.5 * b[:, :, 4:]], 2)
    assert torch.equal(adjust(mixed, MbllenConfig(), params)[0][:, :, :4], found[:, :, :4])
    assert torch.equal(adjust(a, MbllenConfig(adjusted=False), None)[0], a)
    np.testing.assert_allclose(typical([np.array([1.0, 0.2]), np.array([3.0, 0.4])]), [2.0, 0.3])


def test_the_official_file_converts_name_by_name(official):
    tensors = from_keras(read_weights((official("mbllen_lowlight_withnoise.h5"),)))
    own = Mbllen().state_dict()
    assert {n: v.shape for n, v in tensors.items()} == {n: v.shape for n, v in own.items()}
    assert sum(value.numel() for value in own.values()) == 450_171


def test_official_weights_make_dark_photographs_bright(official, dark_fox, plausible):
    config = MbllenConfig(weights=(official("mbllen_lowlight_withnoise.h5"),), adjusted=False)
    for dark, bright in dark_fox:
        plausible(dark, MBLLEN.enhance(torch.from_numpy(dark), config, None, None)[0].numpy(), bright)
