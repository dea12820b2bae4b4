"""Whether the functions of a sensor effect from outside agree with each other."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from sensor_model.effect_list import OwnEffect
    from sensor_model.frame.own import Pixels

SHAPE = (24, 32, 3)
BLOCKS = 4  # along each side of the frame: a pattern must be right in every part of it
ERRORS = 5.0  # standard errors


def assert_effect(
    effect: "OwnEffect", settings: Any = None, *, signals: Sequence[float] = (0, 5, 50, 500), time: float = 1 / 30,
    frames: int = 400, seed: int = 0,
) -> None:  # fmt: skip
    """The samples must have the stated mean and variance, must not depend on the noise of the signal, and `cost` must
    cover both.

    Every part of the frame is compared within five standard errors, at each signal.

    Args:
        effect: The row.
        settings: An instance of its `config`; None: the defaults.
        signals: Mean signals to try, e-.
        time: Of the exposure, s.
        frames: How many are drawn at each signal.
        seed: Of the draws.
    """
    __tracebackhide__ = True
    settings = effect.config() if settings is None else settings
    means, variances = [], []
    for level in signals:
        still = np.full(SHAPE, float(level))
        of_all = _pixels(time, None)
        mean = _whole(effect.mean(still, of_all, settings), "mean")
        variance = _whole(effect.variance(still, of_all, settings), "variance")
        assert (variance >= 0).all(), f"variance must be >= 0, got {variance.min():g} at {level:g} e-"
        found = [_frame(effect, settings, float(level), mean, variance, time, seed, k) for k in range(frames)]
        kinds = ("mean", "covariance with the noise of the signal", "variance")
        for what, sums in zip(kinds, zip(*found, strict=True), strict=True):
            _assert_zero(np.stack(sums), f"{what} at {level:g} e-", float(np.abs(mean).max() + variance.max()))
        means.append(np.abs(mean).max())
        variances.append(variance.max())
    levels = np.array(signals, float)
    kept = levels + 4  # read noise of 2 e-
    sd, bias = effect.cost(levels, kept, of_all.exposure, settings)
    _assert_covered("standard deviation", sd, np.sqrt(1 + np.array(variances) / kept) - 1, levels)
    _assert_covered("mean, e-,", bias, np.array(means), levels)


def _frame(
    effect: "OwnEffect", settings: Any, level: float, mean: NDArray, variance: NDArray, time: float, seed: int, k: int
) -> tuple[NDArray, NDArray, NDArray]:
    """Of one frame, in each block: sums whose expectation is 0 where the statements hold."""
    noise = np.random.default_rng((seed, k)).poisson(level, SHAPE) - level
    added = _whole(effect.sample(level + noise, _pixels(time, (seed, k)), settings), "sample")
    away = added - mean
    return _blocks(away), _blocks(away * noise), _blocks(away**2 - variance)


def _pixels(time: float, drawn: tuple[int, int] | None) -> "Pixels":
    from sensor_model.frame.own import Pixels
    from sensor_model.frame.streams import Draws
    from sensor_model.params import Exposure

    draws = None if drawn is None else Draws(seed=drawn[0], frame=drawn[1])
    return Pixels(shape=SHAPE, sensor_shape=SHAPE[:2], exposure=Exposure(time=time), _name="effect", _serial=1,
                  _draws=draws)  # fmt: skip


def _whole(value: Any, what: str) -> NDArray:
    found = np.broadcast_to(np.asarray(value, np.float64), SHAPE)
    assert np.isfinite(found).all(), f"{what} must be finite"
    return found


def _blocks(values: NDArray) -> NDArray:
    h, w, channels = SHAPE
    return values.reshape(BLOCKS, h // BLOCKS, BLOCKS, w // BLOCKS, channels).sum((1, 3, 4))


def _assert_zero(sums: NDArray, what: str, scale: float) -> None:
    """The average over frames [frames, blocks, blocks] must be 0 within its standard error."""
    average, error = sums.mean(0), sums.std(0, ddof=1) / len(sums) ** 0.5
    allowed = ERRORS * error + 1e-9 * scale  # rounding, where nothing is random
    worst = np.unravel_index(np.argmax(np.abs(average) - allowed), average.shape)
    pixels = SHAPE[0] * SHAPE[1] * SHAPE[2] / BLOCKS**2
    assert abs(average[worst]) <= allowed[worst], (
        f"the {what} is not as stated: samples differ by {average[worst] / pixels:.3g} +- {error[worst] / pixels:.2g} "
        f"per pixel in block {tuple(int(i) for i in worst)} of {BLOCKS} x {BLOCKS}"
    )


def _assert_covered(what: str, stated: Any, needed: NDArray, levels: NDArray) -> None:
    stated = np.broadcast_to(np.asarray(stated, np.float64), levels.shape)
    for level, told, least in zip(levels, stated, needed, strict=True):
        assert told >= least * (1 - 1e-9), (
            f"cost: the {what} errs by {least:.3g} at {level:g} e-, and {told:.3g} is stated"
        )
