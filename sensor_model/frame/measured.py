"""One copy of a camera, pixel by pixel: maps of its fixed pattern, and dark frames, in place of drawn numbers.

Row r and column c of these arrays is row r and column c of the sensor, counted as `Exposure.origin` does: every view
sees the same part of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from sensor_model.characterisation import HOT, QUANTISATION, UNDERFLOW, Stack, noise_parts
from sensor_model.frame import streams
from sensor_model.mosaicking import channel_index
from sensor_model.params import Sensor, require
from sensor_model.plan import Plan

Array = NDArray[np.float64]

FEWEST = 4  # frames: fewer would give every few views the same noise
FAR = 0.1  # of the range of codes, by which dark frames may lie over the black level: dark charge; below it, 4 sigma
SILENT = 1 / 16  # DN**2: variance from which frames of less noise are told apart no further
TAIL = 6.0  # standard deviations, beyond which differences of the normal distribution lose their digits
IN_FRAMES = ("dark_current", "hot_pixels", "read_noise", "read_tails", "telegraph_noise", "dsnu", "row_noise",
             "column_noise", "banding", "black_bias")  # fmt: skip
WITHOUT: dict[str, Any] = {  # fields of a camera without these effects
    "dark_current": 0.0, "sigma_d": 0.0, "tukey_lambda": None, "defects": None, "dsnu": 0.0, "sigma_row": 0.0,
    "sigma_column": 0.0, "banding": None, "rgb_bias": (0.0, 0.0, 0.0),
}  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class DarkFrames:
    """Dark frames of a camera; each frame that is taken draws one of them, for everything that is there without light.

    A frame is rounded already, and will be again with the light. So each code becomes a voltage that it may have been
    before, drawn from a normal distribution around the pixel's mean, of the frames' noise, within half a code: without
    light a capture is the dark frame itself, and little light is not lost between codes.

    Attributes:
        codes: DN, [n, h, w].
        sensor: The camera that takes them, as described by numbers.
        gain: At which they were taken, DN/e-, where it is another one; their noise in electrons is kept.
    """

    codes: NDArray[Any]
    sensor: Sensor
    gain: float | None = None

    def __post_init__(self) -> None:
        """Refuse frames that are not this camera's."""
        s, shape = self.sensor, np.shape(self.codes)
        require(len(shape) == 3 and min(shape[1:]) >= 8, "dark frames", "[n, h >= 8, w >= 8]", shape)
        require(shape[0] >= FEWEST, "dark frames", f"{FEWEST} or more", shape[0], "take ten or more")
        require(self.codes.dtype.kind in "ui", "dark frames", "integer codes", self.codes.dtype)
        require(s.dual_gain is None, "dual_gain", "None beside dark frames", s.dual_gain,
                "they show the noise of one gain alone")  # fmt: skip
        top, cut = int(self.codes.max()), float((self.codes <= 0).mean())
        require(top <= s.max_dn, "codes of dark frames", f"at most {s.max_dn} by the camera's {s.bits} bits", top,
                "they are probably of another bit depth, or shifted to the top")  # fmt: skip
        require(cut <= UNDERFLOW, "the share of dark pixels at 0 DN", f"at most {UNDERFLOW}", round(cut, 4),
                "noise is cut off there: raise the black level (offset) of the camera")  # fmt: skip
        over = float(self.codes.mean(dtype=np.float64)) - s.black_level
        low, high = -4 * self.noise**0.5 - 1, FAR * (s.max_dn - s.black_level)
        require(low <= over <= high, "the mean of dark frames over the black level",
                f"from {low:.3g} to {high:.3g} DN", round(over, 2),
                "they are probably of another camera, mode or bit depth, or saw light")  # fmt: skip

    @cached_property
    def noise(self) -> float:
        """Mean over the pixels of their variance over the frames, DN**2."""
        return float(self._squares.mean())

    @cached_property
    def _average(self) -> Array:
        return np.asarray(self.codes.mean(0, dtype=np.float64))

    @cached_property
    def _squares(self) -> Array:
        """Variance of each pixel over the frames, [h, w], DN**2."""
        return np.asarray(sum(np.square(codes - self._average) for codes in self.codes)) / len(self.codes)

    @property
    def _before(self) -> float:
        """The same before rounding, DN**2."""
        return max(self.noise - QUANTISATION, SILENT)

    @property
    def _per_code(self) -> float:
        """Electrons."""
        return 1 / (self.gain or self.sensor.gain)

    @cached_property
    def mean(self) -> Array:
        """Mean over the frames that are drawn, over the black level [h, w], e-."""
        return (self._average - self.sensor.black_level) * self._per_code

    @cached_property
    def variance(self) -> Array:
        """Variance over the frames that are drawn, before rounding [h, w], e-**2.

        Source: Sheppard. Voltages regress on codes with the slope s = V / (V + 1/12) of their variances, and scatter
        about that line by s / 12.
        """
        slope = self._before / (self._before + QUANTISATION)
        return self._per_code**2 * (slope**2 * self._squares + slope * QUANTISATION)

    def drawn(self, draws: streams.Draws, shape: tuple[int, ...]) -> Array:
        """What is there without light in one frame of this shape [h, w, c], e-; each channel draws a frame of its own.

        Every frame is as likely as any other, so that two of n views share theirs with a probability of 1/n.
        """
        one = replace(draws, origin=(0, 0)).uniforms((1, 1, shape[2]), streams.DARK_FRAME)[0, 0]
        chosen = self.codes[(one * len(self.codes)).astype(int)]
        codes, average = (cut(array, shape, draws.origin) for array in (np.moveaxis(chosen, 0, 2), self._average))
        sd = self._before**0.5
        away = np.clip((codes - average) / sd, -TAIL, TAIL)
        low, high = (scipy.special.ndtr(away + half / sd) for half in (-0.5, 0.5))
        within = scipy.special.ndtri(low + draws.uniforms(shape, streams.DARK_STEP) * (high - low)) - away
        return np.asarray((codes + sd * within - self.sensor.black_level) * self._per_code)

    @cached_property
    def described(self) -> Sensor:
        """The camera with the noise of the frames as numbers, which plans and methods go by.

        Hot pixels are left out of the fixed pattern's number, as in `noise`.
        """
        s, over = self.sensor, (self._average - self.sensor.black_level) * self._per_code * self.sensor.gain
        kinds = np.zeros(over.shape, int) if s.cfa is None else channel_index(over.shape, s.cfa)
        bias = np.array([over[kinds == c].mean() for c in np.unique(kinds)])
        away = np.abs(over - bias[kinds])
        usual = away <= HOT * max(1.4826 * float(np.median(away)), QUANTISATION**0.5)
        row, column, pixel = noise_parts([Stack(self.codes, 0.0)], self.noise)
        sigma_d, sigma_row, sigma_column = (
            self._per_code * max(variance, 0.0) ** 0.5 for variance in (pixel - QUANTISATION, row, column)
        )
        return replace(s, **WITHOUT | {
            "sigma_d": sigma_d, "sigma_row": sigma_row, "sigma_column": sigma_column,
            "dsnu": float(np.square(away[usual]).mean()) ** 0.5 / s.gain,
            "rgb_bias": tuple(np.resize(bias, 3).tolist()),
        })  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """Arrays that take the place of drawn numbers; None: those are drawn."""

    offset: NDArray[np.float32] | None = None  # of each pixel in the dark [h, w], e-: in place of `Sensor.dsnu`
    response: NDArray[np.float32] | None = None  # of each pixel, 1 on average [h, w]: in place of `Sensor.prnu`
    dark: DarkFrames | None = None
    time: float | None = None  # s, that the offset was exposed for; None: not known

    def said(self, plan: Plan) -> Plan:
        """The plan, with what these take the place of: it is never left out."""
        by = {"dsnu": self.offset, "prnu": self.response}
        reasons = {name: "by the map of this copy of the camera" for name, given in by.items() if given is not None}
        if self.dark is not None:
            reasons |= dict.fromkeys(IN_FRAMES, f"in {len(self.dark.codes)} dark frames, which take its place")
        told = [replace(e, on=True, reason=reasons[e.name]) if e.name in reasons else e for e in plan.effects]
        return replace(plan, effects=tuple(told))


def middle(array: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """The part [..., h, w] in the middle of an array, from an even row and column on, as colour filters begin."""
    y, x = (max(0, (side - of) // 2) // 2 * 2 for side, of in zip(array.shape[-2:], size, strict=True))
    return array[..., y : y + size[0], x : x + size[1]]


def cut(array: NDArray[Any], shape: tuple[int, ...], origin: tuple[int, int]) -> NDArray[Any]:
    """The part of an array [H, W] or [H, W, c] that a frame of this shape [h, w, c] sees, for each of its channels.

    Raises:
        ValueError: If the frame reaches further.
    """
    bottom, right = origin[0] + shape[0], origin[1] + shape[1]
    fits = bottom <= array.shape[0] and right <= array.shape[1]
    require(fits, "a frame of a camera whose pixels were measured", f"within their {array.shape[:2]}", (bottom, right),
            "take smaller pictures, or measure more pixels")  # fmt: skip
    part = array[origin[0] : bottom, origin[1] : right]
    return np.broadcast_to(part if part.ndim == 3 else part[..., None], shape)
