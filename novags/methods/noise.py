"""The variance of each datum as a function of its mean: from the camera, or estimated from the pictures."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from sensor_model import Exposure, NoiseCurve, Sensor, linear_noise, raw_noise
from sensor_model.isp import Demosaic

BINS = 16  # of brightness, each with its own estimate of the variance
FLAT_SHARE = 0.3  # of the pixels of a bin, the flattest ones: texture would count as noise
# Second differences in x and in y: exactly zero on any plane. Their squares add up to 36.
_MASK = torch.tensor([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])


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
        return of(c.offset) + (of(c.slope) + of(c.quadratic) * x) * x + low


@dataclass(frozen=True)
class Noise:
    """What is known about the noise of a capture.

    Attributes:
        linear16: Of the linear 16-bit pictures.
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


def estimate_noise(linear: Tensor) -> Noise:
    """Estimate variance = offset + slope * mean from the pictures alone.

    In each of `BINS` ranges of local brightness the flattest pixels are chosen by a smoothed gradient; the median
    magnitude of a Laplacian difference there gives the standard deviation (Immerkaer 1996, made robust), and a
    weighted line through the bins gives the curve. Noise that neighbours share, as after demosaicing, is
    underestimated.

    Args:
        linear: [C, H, W, 3], linear, at least 16 px a side.

    Raises:
        ValueError: For pictures that are too small.
    """
    if linear.ndim != 4 or linear.shape[-1] != 3 or min(linear.shape[1:3]) < 16:
        raise ValueError(f"linear must be [C, H >= 16, W >= 16, 3], got {list(linear.shape)}")
    curves = [_line(*_binned(linear[..., c].double())) for c in range(3)]
    offset, slope = (tuple(float(curve[k]) for curve in curves) for k in range(2))
    zero, one, never = (0.0,) * 3, (1.0,) * 3, (math.inf,) * 3
    curve = NoiseCurve(black=zero, white=one, offset=offset, slope=slope, quadratic=zero, switch=never, step=zero)
    return Noise(Variance(curve), None, "pictures")


def _binned(plane: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and noise variance of flat pixels of every range of brightness, for a stack [C, H, W]."""
    stack = plane[:, None]
    response = F.conv2d(stack, _MASK.to(plane)[None, None]).abs().flatten()
    smooth = F.avg_pool2d(stack, 5, stride=1)
    # The smoothed picture is 4 px smaller, its gradients another 2; the response is cut to the same centre.
    dx = (smooth[..., 1:-1, 2:] - smooth[..., 1:-1, :-2]).flatten()
    dy = (smooth[..., 2:, 1:-1] - smooth[..., :-2, 1:-1]).flatten()
    mean = smooth[..., 1:-1, 1:-1].flatten()
    height, width = plane.shape[-2:]
    response = response.reshape(len(plane), height - 2, width - 2)[:, 2:-2, 2:-2].flatten()
    steep = dx.square() + dy.square()
    order = mean.argsort()
    means, variances = [], []
    for part in order.tensor_split(BINS):
        flat = part[steep[part].argsort()[: max(8, int(FLAT_SHARE * len(part)))]]
        means.append(mean[flat].mean())
        variances.append((response[flat].median() / (0.67449 * 6)).square())
    return torch.stack(means), torch.stack(variances)


def _line(mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """Offset and slope >= 0 of the line through the bins; a bin's estimate scatters in proportion to its value."""
    # Floor: a constant picture has no noise, and weights of 1 / 0.
    weight = 1 / variance.clamp_min(1e-16)
    design = torch.stack([torch.ones_like(mean), mean.clamp_min(0)], 1) * weight[:, None]
    offset, slope = torch.linalg.lstsq(design, (variance * weight)[:, None], driver="gelsd").solution[:, 0]
    if slope < 0:
        return variance.median(), torch.zeros_like(slope)
    return offset.clamp_min(0), slope
