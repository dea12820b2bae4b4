"""The methods with a field find what they claim to find, where it is known.

Of the light of a wall an eighth is left, for a concealing field, an illumination or a medium to account for.
"""

import dataclasses
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from novags.fields.layout import FieldLayout
from novags.fields.training.config import FieldFitConfig
from novags.methods.inputs import LacksInput
from novags.methods.nerf import aleth, i2, llnerf, raw
from novags.methods.nerf.rows.aleth_nerf import AlethConfig
from novags.methods.nerf.rows.i2_nerf import I2Config
from novags.methods.nerf.rows.ll_nerf import LlnerfConfig
from novags.methods.nerf.rows.raw_nerf import RawNerfConfig
from novags.methods.problem import Problem

DIM = 0.12  # what the fixture `problem` leaves of the light
QUICK = FieldFitConfig(
    iterations=220,
    rays=256,
    samples=12,
    rate=0.03,
    patch=2,
    near_scale=0.0,
    layout=FieldLayout(finest=64, log2_rows=12),
)
SeenDark = Callable[..., tuple[Problem, Tensor]]


def correlation(one: Tensor, other: Tensor) -> float:
    return float(torch.corrcoef(torch.stack([one.flatten(), other.flatten()]))[0, 1])


def test_raw_nerf_finds_the_light_behind_noise_without_bias(dark: SeenDark) -> None:
    problem, light = dark()
    result = raw.train(problem, RawNerfConfig(fit=QUICK))
    image = result.render(problem.views)[0]
    assert result.space == "linear"
    assert float(image.mean() / light.mean()) == pytest.approx(1, abs=0.1)
    assert correlation(image, light) > 0.8


def test_raw_nerf_needs_no_known_noise(dark: SeenDark) -> None:
    problem, _ = dark()
    config = RawNerfConfig(fit=dataclasses.replace(QUICK, iterations=4))
    known, unknown = (raw.train(dataclasses.replace(problem, noise=noise), config) for noise in (problem.noise, None))
    assert torch.equal(known.render(problem.views)[0], unknown.render(problem.views)[0])


def test_aleth_finds_how_much_light_is_concealed(problem: Callable[..., Problem]) -> None:
    seen = problem(sigma=0.0)
    lit = seen.clean / DIM
    # mean and contrast of the lit wall are known here, and strong weights make few steps enough
    mean = float(lit.mean())
    config = AlethConfig(fit=QUICK, target=mean, contrast=1 / DIM / mean, control=0.3, structure=1.0)
    result = aleth.train(seen, config)
    image = result.render(seen.views)[0]
    assert result.space == "lit"
    assert result.found["let_through"] == pytest.approx(DIM, rel=0.25)
    assert float(image.mean()) == pytest.approx(float(lit.mean()), rel=0.15)
    assert correlation(image, lit) > 0.7


def test_llnerf_keeps_the_dark_picture_as_its_product_and_lights_the_illumination(
    problem: Callable[..., Problem],
) -> None:
    seen = problem(sigma=0.0)
    config = LlnerfConfig(fit=dataclasses.replace(QUICK, iterations=300), learnt=0.4, exposure=1.0)
    result = llnerf.train(seen, config)
    image = result.render(seen.views)[0]
    assert result.space == "lit"
    assert float(image.mean()) == pytest.approx(0.55, abs=0.06)
    assert correlation(image, seen.clean) > 0.7
    shown = dataclasses.replace(result.scene, shading="product").render(seen.views)[0]
    assert float(shown.mean() / seen.clean.mean()) == pytest.approx(1, abs=0.05)


def test_i2_finds_how_much_light_the_medium_absorbs(problem: Callable[..., Problem]) -> None:
    seen = problem(sigma=0.0)
    lit = seen.clean / DIM
    luminance = float((lit @ torch.tensor([0.299, 0.587, 0.114])).mean())
    config = I2Config(fit=QUICK, mean=luminance, contrast=1 / DIM)  # the mapping that gives the lit wall
    result = i2.train(seen, config)
    image = result.render(seen.views)[0]
    assert result.space == "lit"
    assert float(image.mean()) == pytest.approx(float(lit.mean()), rel=0.15)
    assert correlation(image, lit) > 0.7
    assert result.found["through"] == pytest.approx(DIM, rel=0.3)


def test_i2_takes_statistics_of_the_truth_only_where_it_is_told_to(problem: Callable[..., Problem]) -> None:
    seen = problem()
    config = I2Config(fit=dataclasses.replace(QUICK, iterations=1), truth_statistics=True)
    with pytest.raises(LacksInput, match="truth_statistics needs well-lit pictures"):
        i2.train(seen, config)
    told = dataclasses.replace(seen, lit_mean=0.3)
    assert i2.train(told, config).found["mean"] == 0.3
    assert i2.train(told, dataclasses.replace(config, truth_statistics=False)).found["mean"] == 0.45


def test_raw_nerfs_epsilon_is_a_share_of_white_whatever_the_unit_of_the_field(
    dark: SeenDark, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, real = [], raw.raw_loss
    monkeypatch.setattr(raw, "first_unit", lambda data: 0.25)
    monkeypatch.setattr(raw, "raw_loss", lambda *given: asked.append(given[2]) or real(*given))
    raw.train(dark()[0], RawNerfConfig(fit=dataclasses.replace(QUICK, iterations=1), epsilon=1e-3))
    assert asked == [pytest.approx(4e-3)]


@pytest.mark.parametrize(("truth", "mean"), [(True, 0.3), (False, 0.45)])
def test_i2_aims_at_the_true_mean_only_where_it_may_know_it(
    problem: Callable[..., Problem], monkeypatch: pytest.MonkeyPatch, truth: bool, mean: float
) -> None:
    asked, real = [], i2.mapped
    monkeypatch.setattr(i2, "mapped", lambda *given: asked.append(given[2]) or real(*given))
    config = I2Config(fit=dataclasses.replace(QUICK, iterations=1), truth_statistics=truth, mean=0.45)
    i2.train(dataclasses.replace(problem(), lit_mean=0.3), config)
    assert asked == [mean]


def test_i2_brings_the_luminance_of_coloured_pictures_to_its_mean(
    problem: Callable[..., Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    aims, real = [], i2.mapped
    monkeypatch.setattr(i2, "mapped", lambda *given: aims.append(real(*given)) or aims[-1])
    seen = problem()
    red = dataclasses.replace(seen, srgb8=seen.srgb8 * torch.tensor([1.0, 0.3, 0.1]))
    i2.train(red, I2Config(fit=dataclasses.replace(QUICK, iterations=1), mean=0.4, contrast=1.0))
    luminance = sum(share * float(aims[0][..., c].mean()) for c, share in enumerate((0.299, 0.587, 0.114)))
    assert luminance == pytest.approx(0.4, abs=1e-4)
