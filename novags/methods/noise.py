"""The variance of each datum as a function of its mean, from the camera; `noise_estimate` has it from the pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from sensor_model.isp import Demosaic
from sensor_model.noise import Bend, NoiseCurve, linear_noise, raw_noise
from sensor_model.params import Exposure, Sensor


@dataclass(frozen=True)
class Variance:
    """`sensor_model.NoiseCurve` for tensors: differentiable, on any device."""

    curve: NoiseCurve

    def __call__(self, mean: Tensor, channels: Tensor | None = None) -> Tensor:
        """Variance of data of this mean, in the square of its unit.

        Args:
            mean: Expected value, [..., 3] for three channels; of a mosaic any shape.
            channels: Of a mosaic: the channel of each datum, integer, the shape of `mean`.
        """
        c = self.curve
        if c.matrix is None:
            return self._camera(mean, channels) + c.rounding
        matrix = mean.new_tensor(c.matrix)
        return self._camera(mean @ torch.linalg.inv(matrix).T, None) @ matrix.square().T + c.rounding

    def _camera(self, mean: Tensor, channels: Tensor | None) -> Tensor:
        c = self.curve

        def of(values: tuple[float, ...]) -> Tensor:
            each = mean.new_tensor(values)
            return each if channels is None else each[channels]

        black = of(c.black)
        x = torch.minimum((mean - black).clamp_min(0), of(c.white) - black)
        low = torch.where(mean > of(c.switch), of(c.step), 0.0)
        if c.bend is None:
            return of(c.offset) + (of(c.slope) + of(c.quadratic) * x) * x + low
        fall = 4 * of(c.bend.factor) * x
        square = (1 - fall).clamp_min(1e-12)  # the gradient of the root is infinite at 0
        y = 2 * x / (1 + square.sqrt())
        return of(c.offset) - of(c.bend.offset) * fall + (of(c.slope) + of(c.quadratic) * y) * y * square + low


@dataclass(frozen=True)
class Noise:
    """Known facts about the noise of a capture.

    Attributes:
        linear16: Of the linear 16-bit pictures. Without such pictures: of the light that the 8-bit ones encode, before
            it was clipped and rounded.
        raw: Of the raw frames, in DN; None where only the pictures are known.
        origin: "camera" for the analytic moments of a known camera, "pictures" for an estimate.
    """

    linear16: Variance
    raw: Variance | None
    origin: Literal["camera", "pictures"]

    def at(self, exposure: float) -> "Noise":
        """That of a view that was exposed so many times as long, and whose pictures were divided by that.

        White balance does not count: it scales light and noise alike, and is divided out of both.
        """
        if exposure == 1:
            return self
        return replace(self, linear16=Variance(over(self.linear16.curve, [exposure] * 3, (0.0,) * 3)), raw=None)


def over(curve: NoiseCurve, unit: Sequence[float], zero: Sequence[float]) -> NoiseCurve:
    """The noise of (datum - zero) / unit, for each channel; behind a matrix all channels have one unit, and zero 0."""

    def each(values: tuple[float, ...], power: int, shift: Sequence[float] = (0.0,) * 3) -> tuple[float, ...]:
        return tuple((value - s) / u**power for value, s, u in zip(values, shift, unit, strict=True))

    return replace(
        curve, black=each(curve.black, 1, zero), white=each(curve.white, 1, zero), switch=each(curve.switch, 1, zero),
        offset=each(curve.offset, 2), slope=each(curve.slope, 1), step=each(curve.step, 2),
        bend=curve.bend and Bend(factor=each(curve.bend.factor, -1), offset=each(curve.bend.offset, 2)),
        rounding=curve.rounding / unit[0] ** 2,
    )  # fmt: skip


def camera_noise(
    sensor: Sensor, exposure: Exposure, *, demosaic: Demosaic, color_matrix: list[list[float]] | None, frames: int = 1
) -> Noise:
    """The noise of a known camera, fixed pattern included; of a burst of so many `frames`, of its mean."""
    linear = linear_noise(sensor, exposure, demosaic=demosaic, color_matrix=color_matrix, frames=frames)
    return Noise(Variance(linear), Variance(raw_noise(sensor, exposure, frames=frames)), "camera")
