"""Effects from outside, `Sensor.effects`: what they add to a frame, to its moments and to the camera's noise curve."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sensor_model.effect_list import EFFECT_LIST, OwnEffect
from sensor_model.files.outside import BrokenRow, Origin
from sensor_model.frame import streams
from sensor_model.params import Exposure, Sensor, require

Array = NDArray[np.float64]
Each = Literal["pixel", "row", "column", "frame"]

COARSE = (32, 32)  # pixels that stand for the whole sensor where no frame is given
LEVELS = 33  # signals between black and white that the quadratic of a noise curve is fitted to
FIT = 0.05  # of the standard deviation: an error of that quadratic which is worth a warning


@dataclass(frozen=True, kw_only=True)
class Pixels:
    """The pixels of one frame, as an effect from outside sees them.

    Attributes:
        shape: Rows, columns and channels of the frame.
        sensor_shape: Rows and columns of the whole sensor.
        exposure: How the frame is taken; `exposure.origin` is where its first pixel lies on the sensor.
    """

    shape: tuple[int, int, int]
    sensor_shape: tuple[int, int]
    exposure: Exposure
    _name: str
    _serial: int
    _draws: streams.Draws | None  # None where moments are asked for

    @property
    def rows(self) -> Array:
        """Number of each row on the sensor, [h, 1, 1]."""
        return (np.arange(self.shape[0], dtype=np.float64) + self.exposure.origin[0])[:, None, None]

    @property
    def columns(self) -> Array:
        """Number of each column on the sensor, [1, w, 1]."""
        return (np.arange(self.shape[1], dtype=np.float64) + self.exposure.origin[1])[None, :, None]

    def uniforms(self, each: Each = "pixel", number: int = 0) -> Array:
        """Random numbers in (0, 1) that differ from frame to frame, from the stream of the effect's name.

        Args:
            each: One for each pixel and channel [h, w, c], row [h, 1, c] or column [1, w, c], or one [1, 1, 1].
            number: Different numbers are independent draws.

        Raises:
            ValueError: In `mean`, `variance` and `cost`, which are over all frames.
        """
        require(self._draws is not None, "uniforms", "asked for in sample alone", self._name, "use pattern for maps")
        assert self._draws is not None
        return self._drawn(self._draws, each, f"{self._name} {number}")

    def pattern(self, each: Each = "pixel", number: int = 0) -> Array:
        """Random numbers as of `uniforms` that belong to the camera: the same in every frame, by its serial."""
        draws = streams.Draws(seed=self._serial, origin=self.exposure.origin)
        return self._drawn(draws, each, f"{self._name} {number} of the camera")

    def _drawn(self, draws: streams.Draws, each: Each, name: str) -> Array:
        h, w, channels = self.shape
        stream = streams.named(name)
        if each == "frame":
            return replace(draws, origin=(0, 0)).uniforms((1, 1, 1), stream)
        if each == "row":
            return draws.row_uniforms(h, channels, stream)[:, None]
        if each == "column":
            return draws.column_uniforms(w, channels, stream)[None]
        require(each == "pixel", "each", "pixel, row, column or frame", each)
        return draws.uniforms(self.shape, stream)


def check(sensor: Sensor) -> None:
    """Load the effects from outside of a camera.

    Raises:
        ValueError: If one is not known, or a setting is unknown or out of range.
    """
    for _ in _active(sensor):
        pass


def modules(sensor: Sensor | None) -> tuple[str, ...]:
    """The modules of a camera's effects from outside: results depend on them.

    Raises:
        ValueError: If one is not known: before a stage begins, and so before it replaces anything.
    """
    named = [name for name, _, _ in _active(sensor)] if sensor else []
    return tuple(module for name in named if (module := EFFECT_LIST.module_of(name)))


def missing(names: Iterable[str]) -> str | None:
    """Why one of these effects cannot be used here; None where all can."""
    for name in names:
        try:
            _row(name)
        except ValueError as error:
            return str(error)
    return None


def origin(name: str) -> Origin | None:
    """The package or file that an effect comes from; None of ours."""
    return EFFECT_LIST.origin_of(name)


def added(signal: Array, sensor: Sensor, exposure: Exposure, draws: streams.Draws) -> Array:
    """Electrons that all of them add to a frame of this signal [h, w, c], e-."""
    found = np.zeros(signal.shape)
    for name, row, settings in _active(sensor):
        pixels = _pixels(name, signal.shape, sensor, exposure, draws)
        found += _checked(name, "sample", row.sample(signal, pixels, settings), signal)
    return found


def moments(signal: Array, sensor: Sensor, exposure: Exposure) -> tuple[Array, Array]:
    """What all of them add to the mean (e-) and to the variance (e-**2) over frames of this mean signal [h, w, c]."""
    mean, variance = np.zeros(signal.shape), np.zeros(signal.shape)
    for name, row, settings in _active(sensor):
        pixels = _pixels(name, signal.shape, sensor, exposure, None)
        mean += _checked(name, "mean", row.mean(signal, pixels, settings), signal)
        more = _checked(name, "variance", row.variance(signal, pixels, settings), signal)
        require(bool((more >= 0).all()), f"the variance of the effect {name}", ">= 0", float(more.min()))
        variance += more
    return mean, variance


def reach(sensor: Sensor, exposure: Exposure, signal: float, deviations: float = 20) -> float:
    """The most by which they move any pixel of this signal, at so many standard deviations. e-."""
    if not sensor.effects:
        return 0.0
    mean, variance = moments(np.full((*COARSE, 1), signal), sensor, exposure)
    return float((np.abs(mean) + deviations * np.sqrt(variance)).max())


def costs(sensor: Sensor, exposure: Exposure, signal: Array, kept: Array) -> dict[str, tuple[float, float, str]]:
    """By effect: the error of the standard deviation (relative) and of the mean (e-) without it, and its title."""
    found = {}
    for name, row, settings in _active(sensor):
        errors = row.cost(signal, kept, exposure, settings)
        sd, mean = (float(np.abs(_checked(name, "cost", error, signal)).max()) for error in errors)
        found[name] = sd, mean, f"{row.title} (from {origin(name)}), in the plain chain"
    return found


def curve(sensor: Sensor, exposure: Exposure, fixed_pattern: bool) -> tuple[float, Array]:
    """What they add to a noise curve, over all places of the sensor.

    Returns:
        The mean that they add without any signal, e-; and a, b, c of their variance a + (b q + c q**2) s**2, e-**2, at
        the charge q, where s is the slope of the response.
    """
    if not sensor.effects:
        return 0.0, np.zeros(3)
    charge = sensor.capacity_e * np.linspace(0, 1, LEVELS) ** 2
    found, start = np.empty(LEVELS), 0.0
    for k, q in enumerate(charge):
        mean, variance = moments(np.full((*COARSE, 1), q - sensor.droop * q * q), sensor, exposure)
        found[k] = variance.mean() + (mean.var() if fixed_pattern else 0.0)
        start = float(mean.mean()) if k == 0 else start
    square = (1 - 2 * sensor.droop * charge) ** 2
    share = charge / charge[-1]  # of order 1: the squares of charges would spoil the fit
    basis = np.stack([np.ones(LEVELS), share * square, share**2 * square], 1)
    whole = charge * square + sensor.sigma_d**2 + 1 / (12 * sensor.gain**2) + found
    fit, *_ = np.linalg.lstsq(basis / whole[:, None], found / whole, rcond=None)
    error = np.abs(basis @ fit - found) / (2 * whole)
    if error.max() > FIT:
        at = int(error.argmax())
        warnings.warn(
            f"the variance of the effects {', '.join(sorted(sensor.effects))} is no quadratic of the signal: methods "
            f"are told a standard deviation that errs by {error[at]:.0%} at {charge[at]:.3g} e-",
            stacklevel=3,
        )  # fmt: skip
    return start, fit / charge[-1] ** np.arange(3)


def _active(sensor: Sensor) -> Iterator[tuple[str, OwnEffect, Any]]:
    """Name, row and settings of each, in the order of the names: what one adds does not depend on another."""
    for name in sorted(sensor.effects):
        row = _row(name)
        yield name, row, _settings(name, row, sensor.effects[name])


def _row(name: str) -> OwnEffect:
    try:
        row = EFFECT_LIST[name]
    except BrokenRow as error:
        raise ValueError(str(error)) from error
    except KeyError:
        others = [other for other in EFFECT_LIST if origin(other)]
        raise ValueError(
            f"the camera has an effect {name!r:.80} that is not known here: name its file with --plugin, or install "
            f"its package; known from outside: {', '.join(others) or 'none'}"
        ) from None
    if not isinstance(row, OwnEffect):
        raise ValueError(f"{name} is an effect of novags, which fields of the camera set: give {', '.join(row.fields)}")
    return row


def _settings(name: str, row: OwnEffect, values: Any) -> Any:
    known = [field.name for field in fields(row.config)]
    for key in sorted(values.keys() - set(known)):
        near = get_close_matches(key, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known) or 'none'}"
        require(False, "key", f"a setting of the effect {name}", f"effects.{name}.{key}", hint)
    try:
        return row.config(**values)
    except (TypeError, ValueError) as error:
        raise ValueError(f"the effect {name} of the camera: {error}") from error


def _pixels(
    name: str, shape: tuple[int, ...], sensor: Sensor, exposure: Exposure, draws: streams.Draws | None
) -> Pixels:
    h, w, channels = shape
    whole = sensor.optics.sensor_shape if sensor.optics else None
    end = (exposure.origin[0] + h, exposure.origin[1] + w)
    return Pixels(
        shape=(h, w, channels), sensor_shape=whole or end, exposure=exposure, _name=name, _serial=sensor.serial,
        _draws=draws,
    )  # fmt: skip


def _checked(name: str, function: str, value: Any, signal: Array) -> Array:
    """What a function from outside gave, in the shape of the signal."""
    what, array = f"{function} of the effect {name}", np.asarray(value, np.float64)
    fits = array.ndim <= signal.ndim and all(
        a in (1, b) for a, b in zip(array.shape[::-1], signal.shape[::-1], strict=False)
    )
    require(fits, what, f"of a shape that broadcasts to {signal.shape}", array.shape)
    bad = array[~np.isfinite(array)]
    require(bad.size == 0, what, "finite", bad[:1])
    return np.broadcast_to(array, signal.shape)
