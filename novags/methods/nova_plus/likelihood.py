"""Stage 1: the Gaussians under which this camera would most likely have recorded these data.

With the tone r of a pixel, its light mu = lin(r), the slope g = d lin / d r and the variance v(mu) of a datum y:

    loss = mean of  w ((y - mu) / g)**2,    n = v(mu) / g**2,    w = FLOOR / (n + FLOOR),    w and g held fixed

w = 1 / n would be the chi-squared of the data, in which bright parts, measured best, outweigh the rest of the picture;
w = 1 would let in the noise of dark parts. FLOOR is the variance, in squared tone, that counts as exact enough.
"""

# mypy: allow-untyped-defs

import math

import numpy as np
import torch
from torch import Tensor

from novags.methods.nova_plus.data import FULL, LightMeasurements
from novags.methods.tone import ToneCurve
from novags.splats.cpu.compiler import kernel
from novags.splats.first_order import first_order
from novags.splats.training.step import Step
from sensor_model.noise import NoiseCurve

FLOOR = 0.01


def exactness(variance: Tensor, slope: Tensor) -> Tensor:
    """The weight w of light with this variance, at this slope of the curve: 1 of exact light, 0 of mere noise."""
    return FLOOR / (variance / slope.square() + FLOOR)


class Likelihood:
    """The loss of a picture of tones against data; nan data are left out. A `PixelLoss`."""

    def __init__(self, data: LightMeasurements, curve: ToneCurve) -> None:
        self.data, self.curve = data, curve
        self.share = float(
            (data.measured & ~data.held[..., None]).float().mean()
        )  # of a picture's values that are data
        self.camera = table(data.noise.curve, data.white)

    def __call__(self, step: Step, target: Tensor) -> Tensor:
        """The loss by autograd, on any device.

        Args:
            step: Whose render is a picture of tones.
            target: Light [H, W, 3]; nan where nothing was measured, or the pixel is held out.
        """
        if step.render.device.type == "cpu":
            return _ByKernel.apply(step.render, target, self)
        tone = step.render.detach()
        light, slope = self.curve.light(tone), self.curve.slope(tone)
        there = ~target.isnan() & ~((target >= FULL * self.data.white) & (light > target))
        weight = exactness(self.data.noise(light), slope)
        residual = torch.where(there, (target - light) / slope, 0.0)
        # render - tone is 0 and only carries the gradient: this is the loss, with its gradient for fixed w and g
        return (weight * there * (step.render - tone - residual).square()).mean() / self.share

    def compare(self, image: np.ndarray, target: np.ndarray) -> tuple[np.float32, np.ndarray]:
        """The same without autograd: the loss, and its gradient for the picture."""
        v_image = np.empty_like(image)
        scale = 1 / (image.size * self.share)
        total = compare_tones(
            image.reshape(-1, 3), target.reshape(-1, 3), self.curve.knee, self.curve.k, ToneCurve.STEEPEST, self.camera,
            FLOOR, scale,
            v_image.reshape(-1, 3),
        )  # fmt: skip
        return np.float32(total), v_image


def table(curve: NoiseCurve, white: Tensor) -> np.ndarray:
    """Black, largest signal, offset, slope, quadratic, switch, step, saturation, bend (factor, offset) of each channel,
    [10, 3].
    """
    black, straight = np.array(curve.black), np.zeros((2, 3))
    rows = (black, np.array(curve.white) - black, curve.offset, curve.slope, curve.quadratic, curve.switch, curve.step)
    bend = straight if curve.bend is None else (curve.bend.factor, curve.bend.offset)
    return np.array([*rows, FULL * white.double().cpu().numpy(), *bend])


@kernel
def compare_tones(tones, light, knee, k, steepest, camera, floor, scale, v_tones):
    """Loss of tones [n, 3] against data [n, 3], and its gradient into v_tones [n, 3]."""
    total = 0.0
    for i in range(len(tones)):
        for c in range(3):
            v_tones[i, c] = 0
            datum = light[i, c]
            if math.isnan(datum):
                continue
            rise = math.exp(min(k * tones[i, c], steepest))
            mean, slope = knee * (rise - 1), knee * k * rise
            if datum >= camera[7, c] and mean > datum:
                continue  # a saturated datum is only a lower bound
            signal = min(max(mean - camera[0, c], 0.0), camera[1, c])
            if camera[8, c] > 0:
                fall = 4 * camera[8, c] * signal
                square = max(1 - fall, 0.0)
                charge = 2 * signal / (1 + math.sqrt(square))
                variance = (camera[3, c] + camera[4, c] * charge) * charge * square
                variance += camera[2, c] - camera[9, c] * fall
            else:
                variance = camera[2, c] + (camera[3, c] + camera[4, c] * signal) * signal
            if mean > camera[5, c]:
                variance += camera[6, c]
            weight = floor / (variance / (slope * slope) + floor)
            residual = (mean - datum) / slope
            total += weight * residual * residual
            v_tones[i, c] = 2 * scale * weight * residual
    return scale * total


class _ByKernel(torch.autograd.Function):
    @staticmethod
    def forward(ctx, tones, target, loss):
        value, v_tones = loss.compare(tones.detach().contiguous().numpy(), target.contiguous().numpy())
        ctx.v_tones = torch.from_numpy(v_tones)
        return tones.new_tensor(value)

    @staticmethod
    @first_order
    def backward(ctx, v_loss):
        return v_loss * ctx.v_tones, None, None
