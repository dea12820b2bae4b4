"""The two copies have uncorrelated noise, and the loss has its minimum at the mean."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from novags.methods.denoised import blend, denoiser
from novags.methods.denoised import recorrupted as module
from novags.methods.denoised.anscombe import Anscombe
from novags.methods.denoised.config import AdaptConfig, DenoiseConfig
from novags.methods.denoised.estimate import estimate, estimate_all
from novags.methods.denoised.measured import MeasuredPictures
from novags.methods.denoised.network import Network, NetworkConfig
from novags.methods.denoised.packing import mask_of, turned, turned_back
from novags.methods.denoised.recorrupted import Adaptation, adapt, recorrupted
from novags.methods.noise import Variance
from sensor_model import NoiseCurve
from sensor_model.params import Cfa

SAMPLES = 400_000
SMALL = NetworkConfig(widths=(8, 16), blocks=(1, 1))


def curve(read_variance: float) -> Variance:
    three = {name: (value,) * 3 for name, value in {
        "black": 0.0, "white": math.inf, "offset": read_variance, "slope": 1.0, "quadratic": 0.0, "switch": math.inf,
        "step": 0.0}.items()}  # fmt: skip
    return Variance(NoiseCurve(**three))


def capture(mean: torch.Tensor, read_variance: float, cfa: Cfa | None) -> MeasuredPictures:
    """Poisson-Gaussian electrons around means [C, 3, H, W]."""
    stream = torch.Generator().manual_seed(3)
    noise = math.sqrt(read_variance) * torch.randn(mean.shape, generator=stream)
    mask = mask_of(mean.shape[2:], cfa)
    one = torch.ones(3)
    return MeasuredPictures(
        (torch.poisson(mean, generator=stream) + noise) * mask, mask, curve(read_variance), one, None
    )


@pytest.mark.parametrize("strength", [0.5, 1.5])
def test_the_noise_of_the_two_copies_is_uncorrelated_and_both_keep_the_mean(strength: float) -> None:
    mean, read_variance = 6.0, 2.0
    rng = np.random.default_rng(0)
    data = torch.from_numpy(rng.poisson(mean, SAMPLES) + rng.normal(0, math.sqrt(read_variance), SAMPLES))
    variance = mean + read_variance
    deviation = torch.full_like(data, math.sqrt(variance))
    first, second = recorrupted(data, deviation, strength, torch.Generator().manual_seed(1))
    for copy, more in ((first, 1 + strength**2), (second, 1 + 1 / strength**2)):
        assert float(copy.mean()) == pytest.approx(mean, abs=5 * math.sqrt(more * variance / SAMPLES))
        assert float(copy.var()) == pytest.approx(more * variance, rel=0.02)
    spread = math.sqrt(float(first.var() * second.var()) / SAMPLES)
    assert abs(float(((first - first.mean()) * (second - second.mean())).mean())) < 5 * spread


def test_the_variance_of_what_is_added_is_the_known_one_at_the_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not at the data: their own noise would come back in it."""
    mean = torch.tensor([4.0, 20.0, 90.0])[:, None, None].expand(1, 3, 16, 16)
    guess = mean + 2.5
    monkeypatch.setattr(module, "estimate_all", lambda *given, **turns: guess)
    training = Adaptation(Network(SMALL), capture(mean, 3.0, None), AdaptConfig(crop=8), seed=0)
    torch.testing.assert_close(training.variance(training.first), guess + 3.0)


@pytest.mark.parametrize("cfa", [None, "GRBG"])
def test_the_true_mean_costs_one_and_what_an_estimate_is_off_costs_more(
    cfa: Cfa | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The squared distance from y2 is its own variance for the mean, and grows by the squared error beside it."""
    mean = torch.tensor([5.0, 12.0, 30.0])[:, None, None].expand(2, 3, 64, 64)
    pictures = capture(mean, 1.0, cfa)
    levels = torch.tensor([5.0, 12.0, 30.0])[:, None, None]
    off = 0.0
    config = AdaptConfig(batch=8, crop=64, strength=0.5)
    training = Adaptation(Network(SMALL), pictures, config, seed=0)
    monkeypatch.setattr(training, "variance", lambda first: first - 1.0)  # known
    training.first = mean + 2.0
    # what the loss is to compare: an estimate in the units of the noisier copy
    monkeypatch.setattr(module, "estimate", lambda _, electrons, *rest: (levels + off).expand_as(electrons) / 1.25)
    count = 8 * 64 * 64 * (3 if cfa is None else 1)
    weight, unit = pictures.mask.expand(2, -1, -1, -1), 5 * (mean + 1)
    # where nothing was measured, an estimate is compared with that of the network as it came, which here is 2 more
    held = float(((1 - weight) * 4 / unit).sum() / weight.sum())
    assert float(training.loss()) == pytest.approx(1 + held, abs=5 * math.sqrt(2 / count) + 0.01)
    off = 3.0
    more = float((weight * 9 / unit + (1 - weight) * 1 / unit).sum() / weight.sum())
    assert float(training.loss()) == pytest.approx(1 + more, rel=0.02)


def test_the_noisier_copy_is_estimated_as_an_exposure_of_less_light(monkeypatch: pytest.MonkeyPatch) -> None:
    """y1 / 1.25 has the shot noise of its own mean, and a read variance of 2 / 1.25, as its scatter shows."""
    seen: list[tuple[torch.Tensor, torch.Tensor]] = []

    def spy(_: Network, electrons: torch.Tensor, mask: torch.Tensor, read: torch.Tensor) -> torch.Tensor:
        seen.append((electrons, read))
        return electrons

    mean = torch.tensor([5.0, 12.0, 30.0])[:, None, None].expand(4, 3, 64, 64)
    training = Adaptation(Network(SMALL), capture(mean, 2.0, None), AdaptConfig(batch=16, crop=64), seed=0)
    training.first = mean
    monkeypatch.setattr(module, "estimate", spy)
    training.loss()
    electrons, read = seen[0]
    for c, level in enumerate((5.0, 12.0, 30.0)):
        assert float(electrons[:, c].mean()) == pytest.approx(level / 1.25, rel=0.02)
        assert float(electrons[:, c].var()) == pytest.approx(level / 1.25 + float(read[c]), rel=0.05)
    assert read.tolist() == pytest.approx([1.6] * 3)


def test_crops_show_the_same_pixels_in_all_that_is_compared() -> None:
    """Every value says where it lies."""
    places = torch.arange(3.0 * 3 * 20 * 26).reshape(3, 3, 20, 26)
    pictures = replace(capture(places, 1.0, "GRBG"), electrons=places)
    training = Adaptation(Network(SMALL), pictures, AdaptConfig(batch=60, crop=8), seed=0)
    training.first = 3 * places
    found, first, mask = training._crops()
    assert found.shape == (60, 3, 8, 8)
    assert torch.equal(first, 3 * found)
    assert torch.equal(mask, pictures.mask.expand(3, -1, -1, -1).flatten()[found.long()])
    assert found[:, 0].flatten(1).div(3 * 520).floor().unique().tolist() == [0, 1, 2]  # of all views


def test_an_adapted_network_is_followed_to_where_its_error_is_least(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before, an estimate that is the copy itself, with an error of variance v; after, one that is 2 off everywhere:
    the best share of the second is v / (v + 4)."""
    monkeypatch.setattr(blend, "LEVELS", 1)
    mean = torch.full((2, 3, 64, 64), 5.0)
    training = Adaptation(Network(SMALL), capture(mean, 1.0, "RGGB"), AdaptConfig(), seed=0)
    training.first = mean
    before, share = Network(SMALL), 1 / 1.25  # of the light, which the copy has the noise of

    def known(network: Network, electrons: torch.Tensor, *_: torch.Tensor, turns: int) -> torch.Tensor:
        return electrons if network is before else torch.full_like(electrons, share * (5.0 + 2.0))

    monkeypatch.setattr(module, "estimate_all", known)
    v, second = 1.25 * 6.0, 5 * 6.0
    found = training.blend(before)
    assert found.shares.tolist() == pytest.approx([v / (v + 4)], abs=5 * math.sqrt(second / (v + 4) / (2 * 64 * 64)))
    assert found.levels.tolist() == pytest.approx([5.0], abs=5 * math.sqrt(v / (2 * 64 * 64)))


def test_views_from_the_first_to_the_last_say_how_far_it_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each by its own variance; every view is as bright as its number."""
    mean = torch.arange(1.0, 16.0)[:, None, None, None].expand(15, 3, 8, 8).contiguous()
    training = Adaptation(Network(SMALL), replace(capture(mean, 1.0, None), electrons=mean), AdaptConfig(), seed=0)
    training.first = 2 * mean - 1
    asked: list[tuple[float, float]] = []

    def spy(data: torch.Tensor, deviation: torch.Tensor, *rest: object) -> tuple[torch.Tensor, torch.Tensor]:
        asked.append((float(data.mean()), float(deviation.square().mean())))
        return data, data

    monkeypatch.setattr(module, "recorrupted", spy)
    training.blend(Network(SMALL))
    assert [level for level, _ in asked] == [1, 3, 5, 7, 9, 11, 13, 15]
    assert [variance for _, variance in asked] == pytest.approx([2 * level for level, _ in asked])


def test_the_seed_chooses_the_crops_and_the_noise_that_is_added() -> None:
    pictures = capture(torch.rand(3, 3, 16, 16, generator=torch.Generator().manual_seed(0)) + 5, 1.0, None)
    network, config = Network(SMALL), AdaptConfig(steps=1, crop=8, batch=2)
    losses: list[float] = []
    for seed in (3, 3, 4):
        adapt(network, pictures, config, seed=seed, progress=lambda *said: losses.append(said[2]["denoiser"]))
    assert losses[0] == losses[1] != losses[2]
    crops = [Adaptation(network, pictures, config, seed)._crops()[0] for seed in (3, 3, 4)]
    assert torch.equal(crops[0], crops[1])
    assert not torch.equal(crops[0], crops[2])


def test_single_pictures_are_denoised_with_the_seed_and_all_turns_that_are_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pictures = capture(torch.full((1, 3, 16, 16), 9.0), 1.0, None)
    asked: list[int] = []

    def adapted(*_: object, seed: int, **__: object) -> SimpleNamespace:
        asked.append(seed)
        return SimpleNamespace(estimate_all=lambda pictures, turns: asked.append(turns) or pictures.electrons)

    monkeypatch.setattr(denoiser, "adapt", adapted)
    found = torch.stack(list(denoiser.denoised(pictures, DenoiseConfig(adapt=AdaptConfig(), turns=3), seed=7)))
    assert asked == [7, 3]
    torch.testing.assert_close(found, pictures.linear(pictures.electrons))


def test_the_rate_falls_from_all_of_it_along_half_a_cosine() -> None:
    mean = torch.full((1, 3, 16, 16), 9.0)
    training = Adaptation(Network(SMALL), capture(mean, 1.0, None), AdaptConfig(steps=4, crop=8, batch=1), seed=0)
    found = []
    for _ in range(4):
        training.advance()
        found.append(training.optimizer.param_groups[0]["lr"])
    half = math.sqrt(0.5)
    assert found == pytest.approx([5e-4 * share for share in (1, (1 + half) / 2, 0.5, (1 - half) / 2)])


def test_training_on_copies_brings_an_untrained_network_closer_to_the_truth() -> None:
    """No truth is used; the same seed gives the same network."""
    y, x = torch.meshgrid(torch.linspace(0, 3, 48), torch.linspace(0, 3, 48), indexing="ij")
    mean = (12 + 8 * torch.sin(y + 2 * x)).expand(4, 3, 48, 48).contiguous()
    pictures = capture(mean, 1.0, None)
    config = AdaptConfig(steps=40, learning_rate=8e-3, batch=4, crop=24)

    def trained() -> torch.Tensor:
        torch.manual_seed(0)
        network = Network(SMALL)
        return adapt(network, pictures, config, seed=0).estimate_all(pictures, turns=1)

    found = trained()
    before, after = (float((e - mean).square().mean()) for e in (pictures.electrons, found))
    assert after < 0.75 * before
    assert torch.equal(found, trained())


def test_an_estimate_over_all_turns_is_the_mean_of_each_ones_own() -> None:
    torch.manual_seed(1)
    network = Network(SMALL)
    torch.nn.init.normal_(network.leave.weight, std=0.1)
    picture = torch.rand(1, 3, 16, 12) * 30
    mask, variance = mask_of((16, 12), "RGGB"), torch.tensor([0.5, 2.0, 9.0])
    with torch.no_grad():
        one = estimate(network, picture * mask, mask, variance)
    torch.testing.assert_close(estimate_all(network, picture * mask, mask, variance, turns=1), one)
    eight = estimate_all(network, picture * mask, mask, variance, turns=8)
    stabilised, total = Anscombe(variance[None, :, None, None]), torch.zeros(1, 3, 16, 12)
    for turn in range(8):  # averaged where the noise is even, not in electrons
        with torch.no_grad():
            seen = estimate(network, turned(picture * mask, turn), turned(mask, turn), variance)
        total += turned_back(stabilised(seen), turn)
    torch.testing.assert_close(eight, stabilised.inverse(total / 8), rtol=1e-4, atol=1e-3)
    assert not torch.allclose(one, eight, rtol=1e-3)


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"steps": 0}, "steps"),
        ({"crop": 31}, "crop"),
        ({"strength": 0.0}, "strength"),
        ({"learning_rate": -1.0}, "learning_rate"),
    ],
)
def test_settings_that_cannot_work_are_refused(wrong: dict[str, float], word: str) -> None:
    with pytest.raises(ValueError, match=word):
        AdaptConfig(**wrong)
