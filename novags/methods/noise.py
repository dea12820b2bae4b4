"""The variance of each datum as a function of its mean, from the camera; `noise_estimate` has it from the pictures."""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from sensor_model.isp import Demosaic
from sensor_model.noise import NoiseCurve, linear_noise, raw_noise
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


def camera_noise(
    sensor: Sensor, exposure: Exposure, *, demosaic: Demosaic, color_matrix: list[list[float]] | None
) -> Noise:
    """The noise of a known camera, fixed pattern included."""
    linear = linear_noise(sensor, exposure, demosaic=demosaic, color_matrix=color_matrix)
    return Noise(Variance(linear), Variance(raw_noise(sensor, exposure)), "camera")
