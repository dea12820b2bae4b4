"""Claims about the assertion for sensor effects of others: what agrees passes, and each kind of mistake does not."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from novags.testing import assert_effect
from novags.testing.effects import SHAPE
from sensor_model.effect_list import OwnEffect
from sensor_model.effects import standard_normal

SIGNALS, FRAMES = (0.0, 20.0, 300.0), 60
ROWS = np.linspace(0, 1, SHAPE[0])[:, None, None]


@dataclass(frozen=True, kw_only=True)
class Slope:
    """Noise that grows from the first row to the last."""

    most: float = 3.0  # e-


def variance(signal: Any, pixels: Any, settings: Slope) -> Any:
    return (settings.most * ROWS) ** 2 + 0.1 * ROWS * signal


def of_level(level: float) -> Callable[..., Any]:
    """The sample at a known mean signal, which a frame with shot noise does not say."""

    def drawn(signal: Any, pixels: Any, settings: Slope) -> Any:
        deviation = np.sqrt(variance(np.full(SHAPE, level), pixels, settings))
        return ROWS + deviation * standard_normal(pixels.uniforms())

    return drawn


def cost(signal: Any, kept: Any, exposure: Any, settings: Slope) -> Any:
    return np.sqrt(1 + (settings.most**2 + 0.1 * signal) / kept) - 1, np.ones_like(signal)


def effect(level: float, **other: Any) -> OwnEffect:
    parts = {"sample": of_level(level), "mean": lambda *_: ROWS, "variance": variance, "cost": cost}
    return OwnEffect(title="slope", config=Slope, **{**parts, **other})


def tried(level: float, **other: Any) -> None:
    assert_effect(effect(level, **other), signals=(level,), frames=FRAMES)


@pytest.mark.parametrize("level", SIGNALS)
def test_an_effect_whose_parts_agree_passes(level: float) -> None:
    tried(level)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"mean": lambda *_: 1 - ROWS}, "the mean at 20 e- is not as stated"),
        ({"variance": lambda *given: 1.5 * variance(*given)}, "the variance at 20 e- is not as stated"),
        ({"variance": lambda *given: variance(*given) - 5}, "variance must be >= 0"),
        ({"mean": lambda *_: ROWS / 0}, "mean must be finite"),
        ({"sample": lambda signal, *rest: of_level(20.0)(signal, *rest) + 0.3 * (signal - 20)}, "the covariance"),
        ({"cost": lambda *given: (0.9 * cost(*given)[0], cost(*given)[1])}, "cost: the standard deviation errs"),
        ({"cost": lambda *given: (cost(*given)[0], 0.9 * cost(*given)[1])}, "cost: the mean, e-, errs"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_a_part_that_does_not_agree_with_the_others_is_found_out(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(AssertionError, match=said):
        tried(20.0, **wrong)


def test_every_signal_is_tried() -> None:
    """Right at 0 e- and at 20 e-, and wrong at 300 e-."""

    def still(signal: Any, pixels: Any, settings: Slope) -> Any:
        return np.where(signal > 200, 2.0, 0.0) * np.ones(SHAPE)

    quiet = {"mean": lambda signal, *_: 0 * signal, "variance": lambda signal, *_: 0 * signal, "sample": still}
    nothing = effect(0.0, **quiet)
    assert_effect(nothing, signals=(0.0, 20.0), frames=FRAMES)
    with pytest.raises(AssertionError, match="the mean at 300 e- is not as stated"):
        assert_effect(nothing, signals=SIGNALS, frames=FRAMES)


def test_the_seed_and_the_frame_vary_the_noise_of_the_signal_and_that_of_the_effect() -> None:
    seen: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
    for seed in (1, 2):

        def watched(signal: Any, pixels: Any, settings: Slope, seed: int = seed) -> Any:
            seen.setdefault(seed, []).append((signal, pixels.uniforms()))
            return of_level(20.0)(signal, pixels, settings)

        assert_effect(effect(20.0, sample=watched), signals=(20.0,), frames=FRAMES, seed=seed)
    for number in range(2):
        of_both = [draws[number] for frames in seen.values() for draws in frames[:2]]
        assert not any(np.array_equal(a, b) for i, a in enumerate(of_both) for b in of_both[:i])


def test_rounding_where_nothing_is_random_is_no_mistake() -> None:
    """A mean of 1e9 whose last digit differs; and jumps up or down by 1.1 in half of the rows, whose squares do."""
    large = effect(0.0, mean=lambda *_: 1e9, sample=lambda *_: np.nextafter(1e9, 2e9), variance=lambda *_: 0.0,
                   cost=lambda signal, *_: (0 * signal, 1e9 + 0 * signal))  # fmt: skip
    assert_effect(large, signals=(0.0,), frames=FRAMES)
    with pytest.raises(AssertionError, match="the mean at 0 e- is not as stated: samples differ by 1e"):
        assert_effect(replace(large, sample=lambda *_: 1e9 + 1e3), signals=(0.0,), frames=FRAMES)  # a millionth
    half = ROWS > 0.5
    jumps = replace(
        large, mean=lambda *_: 0.0, variance=lambda *_: 1.21 * half,
        cost=lambda signal, *_: (1 + 0 * signal, 0 * signal),
        sample=lambda signal, pixels, settings: 1.1 * half * np.sign(pixels.uniforms() - 0.5),
    )  # fmt: skip
    assert 1.1**2 != 1.21
    assert_effect(jumps, signals=(0.0,), frames=FRAMES)
