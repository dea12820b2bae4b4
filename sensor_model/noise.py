"""The noise of a known camera, as methods may see it: the variance of each datum as a function of its mean.

Sources: the terms of `moments.frame_moments` far from any clipping, and of the fixed pattern. With x the mean over the
black level in DN, K the gain, a the droop of the response, y = K mu_e the charge, x = y - (a / K) y**2, and s the slope
of the response there, s**2 = 1 - 4 (a / K) x:

    variance = s**2 K y                                             shot noise, through a bent response
             + K**2 (sigma_d**2 + sigma_row**2 + sigma_column**2 + banding**2 / 2) + 1/12    readout, rounding
             + K**2 dsnu**2 + s**2 prnu**2 (y - K dark_e)**2        fixed pattern
             + effects from outside, as a quadratic of y: `frame.own.curve`

Dark charge raises the mean, so its shot noise is part of K y. Left out: near black and white clipping lowers the
variance; hot and telegraph pixels are outliers, not noise of every pixel; row, column and banding noise count in full,
although neighbours share them. Below 0.5 DN of noise, 1/12 is the squared rounding error on average over signals that
lie anywhere between two codes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sensor_model.frame import own
from sensor_model.isp import DEMOSAIC, LINEAR16_BLACK, Demosaic, white_balance
from sensor_model.params import ROUNDING, Exposure, Sensor, require
from sensor_model.plan import Plan
from sensor_model.planner import simplify

Channels = tuple[float, ...]  # one number per channel: red, green, blue; or one for a monochrome sensor


@dataclass(frozen=True, kw_only=True)
class Bend:
    """A response x = y - factor y**2 behind some of the noise, which shrinks by its slope."""

    factor: Channels
    offset: Channels  # part of the offset of the curve that arises before the bend


@dataclass(frozen=True, kw_only=True)
class NoiseCurve:
    """offset + slope x + quadratic x**2 with x = mean - black, cut to [0, white - black]; units of the datum.

    Behind a bend: offset - bend.offset + (bend.offset + slope y + quadratic y**2) (1 - 4 bend.factor x).
    """

    black: Channels  # mean of a pixel without any charge
    white: Channels  # mean at which it saturates; brighter ones count as this
    offset: Channels
    slope: Channels
    quadratic: Channels
    switch: Channels  # mean from which a dual gain reads at the low gain; infinite without
    step: Channels  # variance that the low gain adds there
    matrix: tuple[Channels, ...] | None = None  # [3, 3]: the datum is this matrix times the channels described above
    rounding: float = 0.0  # variance of storing the datum in 16 bits
    interpolated: bool = False  # of each pixel only the channel of its own filter was measured: see `linear_noise`
    bend: Bend | None = None

    def variance(self, mean: ArrayLike, channels: NDArray[np.intp] | None = None) -> NDArray[np.float64]:
        """Variance of data of this mean.

        Args:
            mean: Expected value of the datum, dark charge included: [..., 3] for three channels, any shape for one, or
                the shape of `channels`.
            channels: Of a mosaic: the channel of each datum, from `mosaic.channel_index`.

        Returns:
            The shape of `mean`, in the square of its unit.

        Raises:
            ValueError: if the last axis of `mean` does not hold the channels.
        """
        mean = np.asarray(mean, np.float64)
        count = len(self.slope)
        if channels is None:
            require(count == 1 or mean.shape[-1:] == (count,), "mean", f"of shape [..., {count}]", mean.shape)
            pick: NDArray[np.intp] = np.arange(count) if count > 1 else np.zeros((), np.intp)
        else:
            require(self.matrix is None, "channels", "None for pictures after a colour matrix", np.shape(channels))
            require(channels.shape == mean.shape, "channels", f"of shape {mean.shape}", channels.shape)
            pick = channels
        if self.matrix is None:
            return self._camera_variance(mean, pick) + self.rounding
        matrix = np.asarray(self.matrix)
        return self._camera_variance(mean @ np.linalg.inv(matrix).T, pick) @ (matrix**2).T + self.rounding

    def _camera_variance(self, mean: NDArray[np.float64], pick: NDArray[np.intp]) -> NDArray[np.float64]:
        black, white, offset, slope, quadratic, switch, step = (
            np.asarray(values)[pick]
            for values in (self.black, self.white, self.offset, self.slope, self.quadratic, self.switch, self.step)
        )
        x = np.clip(mean - black, 0, white - black)
        low = np.where(mean > switch, step, 0.0)
        if self.bend is None:
            return offset + (slope + quadratic * x) * x + low
        fall = 4 * np.asarray(self.bend.factor)[pick] * x
        square = np.maximum(1 - fall, 0)  # of the slope; a negative bias of black lifts white over the top of a bend
        y = 2 * x / (1 + np.sqrt(square))
        return offset - np.asarray(self.bend.offset)[pick] * fall + (slope + quadratic * y) * y * square + low


def raw_noise(
    sensor: Sensor, exposure: Exposure, *, channels: int = 3, plan: Plan | None = None, fixed_pattern: bool = True,
    frames: int = 1,
) -> NoiseCurve:  # fmt: skip
    """The noise of raw codes, DN.

    Args:
        sensor: The camera.
        exposure: How it is used.
        channels: 3 for a mosaic or three chips, 1 for a monochrome sensor.
        plan: The plan of `expose`, with the effects it left out; None: nothing.
        fixed_pattern: Whether the offsets and responses of single pixels (DSNU, PRNU) count as noise: True for the
            distance of a datum from an even camera's, False for the spread over frames of one view.
        frames: Of a burst, whose rounded mean the codes are.

    Raises:
        ValueError: if `channels` does not fit the sensor.
    """
    fits = channels == 3 or (channels == 1 and sensor.cfa is None)
    require(fits, "channels", "3, or 1 without colour filter array", channels)
    if frames > 1:
        how: dict[str, Any] = {"channels": channels, "plan": plan}
        whole = raw_noise(sensor, exposure, fixed_pattern=fixed_pattern, **how)
        return _averaged(whole, raw_noise(sensor, exposure, fixed_pattern=False, **how), frames)
    s = simplify(sensor, plan)
    shot = plan is None or plan.is_on("photon_shot")
    blur = (1 - 4 * s.coupling) ** 2 + 4 * s.coupling**2  # coupling averages the charges of five pixels
    response = blur * s.prnu**2 if fixed_pattern else 0.0
    dark = s.gain * s.dark_e(exposure)
    bands = s.banding.amplitude**2 / 2 if s.banding else 0.0
    lines = s.sigma_row**2 + s.sigma_column**2 + bands
    readout = s.sigma_d**2 + lines + (s.dsnu**2 if fixed_pattern else 0.0)
    offset = s.gain**2 * readout + _rounding(s, lines) + response * dark**2
    slope = s.gain * blur * shot - 2 * response * dark
    start, further = own.curve(s, exposure, fixed_pattern)  # in electrons
    offset, slope = offset + s.gain**2 * further[0], slope + s.gain * further[1]
    quadratic = response + further[2]
    bend = Bend(factor=(s.droop / s.gain,) * channels, offset=(response * dark**2,) * channels) if s.droop else None
    low = s.dual_gain
    step = s.gain**2 * (low.sigma_d**2 - s.sigma_d**2) + (low.ratio**2 - 1) / 12 if low else 0.0
    biases = s.rgb_bias if channels == 3 else s.rgb_bias[1:2]
    black = [s.black_level + bias + s.gain * start for bias in biases]
    switch = s.gain * (low.threshold - s.droop * min(low.threshold, s.mu_e_sat) ** 2) if low else inf
    return NoiseCurve(
        black=tuple(black),
        white=(s.white_dn,) * channels,
        offset=(float(offset),) * channels,
        slope=(float(slope),) * channels,
        quadratic=(float(quadratic),) * channels,
        switch=tuple(b + switch for b in black),
        step=(step,) * channels,
        bend=bend,
    )


def _averaged(whole: NoiseCurve, temporal: NoiseCurve, frames: int) -> NoiseCurve:
    """The noise of the rounded mean of a burst: of `whole`, the part that is `temporal` shrinks."""

    def shrunk(name: str, more: float = 0.0) -> Channels:
        pairs = zip(getattr(whole, name), getattr(temporal, name), strict=True)
        return tuple(all_of_it - part * (1 - 1 / frames) + more for all_of_it, part in pairs)

    return replace(
        whole, offset=shrunk("offset", ROUNDING), slope=shrunk("slope"), quadratic=shrunk("quadratic"),
        step=shrunk("step"),
    )  # fmt: skip


def _rounding(s: Sensor, lines: float) -> float:
    """1/12 DN**2; nothing where whole electrons are whole codes and no other noise comes between."""
    silent = s.sigma_d == 0 and lines == 0 and s.dsnu == 0 and s.droop == 0 and s.coupling == 0 and not s.effects
    return 0.0 if silent and s.gain % 1 == 0 and s.black_level % 1 == 0 else ROUNDING


def linear_noise(
    sensor: Sensor,
    exposure: Exposure,
    *,
    channels: int = 3,
    demosaic: Demosaic = "menon",
    color_matrix: ArrayLike | None = None,
    digital_gain: float = 1.0,
    plan: Plan | None = None,
    fixed_pattern: bool = True,
    frames: int = 1,
) -> NoiseCurve:
    """The noise of `linear16` pictures as `from_linear16` reads them: black at 0, white at 1, not clipped at black.

    White balance scales each channel. Of a picture made from a colour filter array the curve holds for the values that
    were measured: channel `mosaic.channel_index` of each pixel, which all methods of interpolation keep. The others are
    averages of neighbours: their noise is usually smaller, and correlated. After "half" it holds everywhere: the green
    of a cell is the mean of two pixels. A colour matrix M mixes the channels: the curve gives M**2 (element by element)
    times their variances, each at the mean that the inverse of M says, as if the channels were independent, which they
    are for three chips and for "half"; of interpolated pictures it is an estimate. `linear16` itself ends at -6.7 % of
    white: noise that reaches further, as with the loudest presets and a digital gain, is cut there.

    Args:
        sensor: The camera.
        exposure: How it is used.
        channels: As in `raw_noise`.
        demosaic: As in `develop`.
        color_matrix: As in `develop`.
        digital_gain: As in `develop`.
        plan: As in `raw_noise`.
        fixed_pattern: As in `raw_noise`.
        frames: As in `raw_noise`.

    Raises:
        ValueError: if an option is out of range or does not fit the sensor.
    """
    require(demosaic in DEMOSAIC, "demosaic", f"one of {DEMOSAIC}", demosaic)
    require(digital_gain > 0, "digital_gain", "> 0", digital_gain)
    raw = raw_noise(sensor, exposure, channels=channels, plan=plan, fixed_pattern=fixed_pattern, frames=frames)
    halves = sensor.cfa is not None and demosaic == "half"
    balance = white_balance(sensor) if channels == 3 else np.ones(1)
    gain = balance * (digital_gain if color_matrix is None else 1.0) / (sensor.white_dn - sensor.black_level)
    samples = np.array([1.0, 2.0, 1.0]) if halves else np.ones(channels)  # that each value is the mean of
    white = np.ones(3) if color_matrix is not None else gain * (np.asarray(raw.white) - sensor.black_level)
    curve = NoiseCurve(
        black=_channels(gain * (np.asarray(raw.black) - sensor.black_level)),
        white=_channels(white),
        offset=_channels(gain**2 * raw.offset / samples),
        slope=_channels(gain * raw.slope / samples),
        quadratic=_channels(raw.quadratic / samples),
        switch=_channels(gain * (np.asarray(raw.switch) - sensor.black_level)),
        step=_channels(gain**2 * raw.step / samples),
        rounding=1 / 12 / (65535 - LINEAR16_BLACK) ** 2,
        interpolated=sensor.cfa is not None and not halves,
        bend=raw.bend
        and Bend(factor=_channels(raw.bend.factor / gain), offset=_channels(gain**2 * raw.bend.offset / samples)),
    )
    if color_matrix is None:
        return curve
    return replace(curve, matrix=_matrix(np.asarray(color_matrix, np.float64), channels, digital_gain))


def _matrix(matrix: NDArray[np.float64], channels: int, digital_gain: float) -> tuple[Channels, ...]:
    ok = matrix.shape == (3, 3) and channels == 3
    require(ok, "color_matrix", "[3, 3], for RGB only", (matrix.shape, channels))
    rank = int(np.linalg.matrix_rank(matrix)) if np.isfinite(matrix).all() else nan
    require(rank == 3, "color_matrix", "finite and of rank 3", rank, "the curve needs its inverse")
    return tuple(_channels(row) for row in digital_gain * matrix)


def _channels(values: NDArray[np.float64]) -> Channels:
    return tuple(float(v) for v in values)
