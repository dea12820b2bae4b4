"""Zero-DCE against its layers and losses written out in numpy, and what it does to dark pictures."""

import numpy as np
import pytest
import torch

from novags.methods.enhancers import network_of
from novags.methods.enhancers.files.weights import read_weights
from novags.methods.enhancers.networks import zero_dce as part
from novags.methods.enhancers.networks.kind import crops
from novags.methods.enhancers.networks.rows.zero_dce import ZeroDceConfig
from novags.methods.enhancers.networks.zero_dce import ZERO_DCE, ZeroDce


def network(seed: int = 0, scale: float = 0.15) -> ZeroDce:
    """Weights so large that every layer counts."""
    made = ZeroDce().double()
    generator = torch.Generator().manual_seed(seed)
    for value in made.parameters():
        value.data = scale * torch.randn(value.shape, generator=generator, dtype=torch.float64)
    return made


def picture(height: int = 5, width: int = 6, seed: int = 0) -> np.ndarray:
    """[3, h, w]."""
    return np.random.default_rng(seed).uniform(0, 0.4, (3, height, width))


def by_hand(made: ZeroDce, x: np.ndarray, conv) -> tuple[np.ndarray, np.ndarray]:
    def layer(i: int, *inputs: np.ndarray) -> np.ndarray:
        own = getattr(made, f"e_conv{i}")
        return conv(np.concatenate(inputs), own.weight.detach().numpy(), own.bias.detach().numpy(), 1)

    one = np.maximum(layer(1, x), 0)
    two = np.maximum(layer(2, one), 0)
    three = np.maximum(layer(3, two), 0)
    four = np.maximum(layer(4, three), 0)
    five = np.maximum(layer(5, three, four), 0)
    six = np.maximum(layer(6, two, five), 0)
    maps = np.tanh(layer(7, one, six))
    for k in range(8):
        x = x + maps[3 * k : 3 * k + 3] * (x**2 - x)
    return x, maps


def test_the_network_is_seven_convolutions_and_eight_curves(conv_by_hand):
    made, x = network(), picture(4, 5)
    found, maps = made(torch.from_numpy(x)[None])
    wanted, wanted_maps = by_hand(made, x, conv_by_hand)
    assert np.abs(wanted - x).max() > 0.05
    np.testing.assert_allclose(found[0].detach(), wanted, atol=1e-12)
    np.testing.assert_allclose(maps[0].detach(), wanted_maps, atol=1e-12)


def test_curves_keep_black_and_white_and_the_order_of_levels():
    levels = torch.linspace(0, 1, 33, dtype=torch.float64).expand(3, 1, 33)[None]
    made = network()
    made.e_conv7.weight.data.zero_()  # maps that are the same in every pixel
    found = made(levels)[0][0].detach()
    np.testing.assert_allclose(found[:, 0, [0, -1]], [[0, 1]] * 3, atol=1e-12)
    assert (found.diff(dim=2) > 0).all()


def test_the_four_losses_are_the_published_ones():
    rng = np.random.default_rng(1)
    maps, dark, bright = (
        rng.normal(0, 1, (2, 24, 8, 9)),
        rng.uniform(0, 0.3, (2, 3, 8, 9)),
        rng.uniform(0, 1, (2, 3, 8, 9)),
    )
    total = 0.0
    for b in range(2):
        for c in range(24):
            rows = [(maps[b, c, i + 1, j] - maps[b, c, i, j]) ** 2 for i in range(7) for j in range(9)]
            columns = [(maps[b, c, i, j + 1] - maps[b, c, i, j]) ** 2 for i in range(8) for j in range(8)]
            total += 2 * (np.mean(rows) + np.mean(columns)) / 2
    given = [torch.from_numpy(v) for v in (maps, dark, bright)]
    assert float(part.smoothness(given[0])) == pytest.approx(total)

    colors = []
    for each in bright:
        r, g, b = (float(np.mean(channel)) for channel in each)
        colors.append(np.sqrt(((r - g) ** 2) ** 2 + ((r - b) ** 2) ** 2 + ((g - b) ** 2) ** 2))
    assert float(part.constancy(given[2])) == pytest.approx(np.mean(colors))

    # patches shrink to the picture: one of 8 x 9
    assert float(part.exposure(given[2])) == pytest.approx(np.mean([(each.mean() - 0.6) ** 2 for each in bright]))
    large = rng.uniform(0, 1, (2, 3, 20, 35))  # holds two whole ones of 16 x 16
    patches = [large[b, :, :16, left : left + 16].mean() for b in range(2) for left in (0, 16)]
    assert float(part.exposure(torch.from_numpy(large))) == pytest.approx(np.mean((np.array(patches) - 0.6) ** 2))

    sums = []
    for before, after in zip(dark, bright, strict=True):
        grid = [np.array([[p[:, 4 * i : 4 * i + 4, 4 * j : 4 * j + 4].mean() for j in range(2)] for i in range(2)])
                for p in (before, after)]  # fmt: skip
        for i, j in np.ndindex(2, 2):
            near = [(i + v, j + u) for v, u in ((1, 0), (-1, 0), (0, 1), (0, -1)) if 0 <= i + v < 2 and 0 <= j + u < 2]
            sums.append(sum(((grid[1][i, j] - grid[1][n]) - (grid[0][i, j] - grid[0][n])) ** 2 for n in near))
    assert float(part.spatial(given[1], given[2])) == pytest.approx(np.mean(sums))


def test_the_losses_are_weighted_200_1_5_10():
    class Fixed(torch.nn.Module):
        def forward(self, x):
            return self.bright, self.maps

    fixed, rng = Fixed(), np.random.default_rng(2)
    dark, fixed.bright, fixed.maps = (
        torch.from_numpy(rng.uniform(0, 1, (1, d, 16, 16))) for d in (3, 3, 24)
    )  # fmt: skip
    wanted = 200 * part.smoothness(fixed.maps) + part.spatial(dark, fixed.bright)
    wanted = wanted + 5 * part.constancy(fixed.bright) + 10 * part.exposure(fixed.bright)
    assert float(part.loss(fixed, dark, ZeroDceConfig())) == pytest.approx(float(wanted))


def test_it_begins_and_learns_as_published():
    torch.manual_seed(0)
    made, config = ZeroDce(), ZeroDceConfig()
    weights = torch.cat([value.detach().flatten() for value in made.parameters() if value.ndim == 4])
    # 79,200 weights: the standard error of their deviation is 0.25 %
    assert float(weights.std()) == pytest.approx(0.02, rel=0.0125)
    (group,) = ZERO_DCE.rehearsal.optimizer(made, config).param_groups
    assert (group["lr"], group["weight_decay"], group["betas"]) == (1e-4, 1e-4, (0.9, 0.999))
    assert ZERO_DCE.rehearsal.clip == 0.1
    assert ZERO_DCE.rehearsal.batch(config)[0] == 8


def test_grey_pictures_have_slopes():
    """Rationale: the root of the colour loss has an infinite slope at 0."""
    grey = torch.full((1, 3, 16, 16), 0.3, requires_grad=True)
    part.constancy(grey).backward()
    assert torch.isfinite(grey.grad).all()


def test_a_training_makes_dark_pictures_of_one_level_as_bright_as_asked():
    """Every patch of the mean 0.12 shall have 0.6, and nothing else pulls; large rates, to be quick."""
    dark = torch.full((2, 16, 16, 3), 0.12)
    config = ZeroDceConfig(steps=60, rate=5e-3, batch=1, crop=16)
    torch.manual_seed(0)
    made, rehearsal = ZERO_DCE.make(config), ZERO_DCE.rehearsal
    adam = rehearsal.optimizer(made, config)
    for step in range(config.steps):
        adam.zero_grad()
        part.loss(made, crops(dark, 1, 16, np.random.default_rng(step)), config).backward()
        adam.step()
    assert float(ZERO_DCE.picture(made, dark[0], config)[0].mean()) == pytest.approx(0.6, abs=0.04)


def test_the_official_file_has_these_tensors_and_no_others(official):
    tensors = read_weights((official("zero_dce_epoch99.pth"),))
    own = ZeroDce().state_dict()
    assert {name: value.shape for name, value in tensors.items()} == {name: value.shape for name, value in own.items()}
    assert sum(value.numel() for value in own.values()) == 79_416
    assert network_of(ZeroDceConfig()) is ZERO_DCE


def test_official_weights_make_dark_photographs_bright(official, dark_fox, plausible):
    config = ZeroDceConfig(weights=(official("zero_dce_epoch99.pth"),))
    for dark, bright in dark_fox:
        found, params = ZERO_DCE.enhance(torch.from_numpy(dark), config, None, None)
        assert params is None
        plausible(dark, found.numpy(), bright)


def test_colour_and_exposure_are_asked_of_the_enhanced_picture_alone() -> None:
    """Expectation: grey at the published exposure has no loss, however coloured and dark its original is."""
    dark = torch.tensor([0.02, 0.1, 0.05]).view(1, 3, 1, 1).expand(2, 3, 32, 32)
    still = torch.zeros(2, 24, 32, 32)
    bright = {name: torch.full((2, 3, 32, 32), 0.6) for name in ("good", "dim", "red", "rough")}
    bright["dim"] *= 0.5
    bright["red"] *= torch.tensor([1.2, 0.9, 0.9]).view(1, 3, 1, 1)
    rough = torch.tensor([0.9, 1.1]).repeat(4).repeat_interleave(part.REGION)
    bright["rough"] *= rough
    lost = {name: float(part.loss(lambda _, b=b: (b, still), dark, ZeroDceConfig())) for name, b in bright.items()}
    assert lost["good"] == pytest.approx(0, abs=1e-6)
    assert min(lost[name] for name in ("dim", "red", "rough")) > 1e-3
