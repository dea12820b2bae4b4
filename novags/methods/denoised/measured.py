"""What a capture has measured, in electrons: the data that a denoiser works on, whatever camera they come from."""

import math
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from novags.methods.denoised.packing import mask_of, spread
from novags.methods.noise import Noise, Variance
from novags.methods.problem import LacksInput, Problem, RawPictures
from sensor_model import NoiseCurve

# Data whose noise does not grow with the signal have no electrons. They are taken as so many that the transform is
# straight over the whole range: the variance of this many electrons is the read variance.
STRAIGHT = 1e4


@dataclass(frozen=True)
class Measured:
    """Pictures in electrons, and the way to linear light.

    "Electrons" are the unit in which shot noise has the variance of its mean: the datum over the slope of its variance.

    Attributes:
        electrons: [C, 3, H, W] float32, 0 = black, not clipped; 0 where nothing was measured.
        mask: [1, 3, H, W], 1 where a channel was measured.
        noise: Variance of the data as the source states it, for means [..., 3].
        black: [3], of the data.
        slope: [3], data per electron.
        to_linear: [3], linear light per electron, before the matrix.
        matrix: [3, 3], or None: the colour matrix of the linear pictures.
    """

    electrons: Tensor
    mask: Tensor
    noise: Variance
    black: Tensor
    slope: Tensor
    to_linear: Tensor
    matrix: Tensor | None

    @property
    def read_variance(self) -> Tensor:
        """[3], electrons**2."""
        return self.electrons.new_tensor(self.noise.curve.offset) / self.slope**2

    def to(self, device: torch.device | str) -> "Measured":
        """The same on another device."""
        moved = {f.name: value.to(device) for f in fields(self) if isinstance(value := getattr(self, f.name), Tensor)}
        return replace(self, **moved)  # type: ignore[arg-type]  # only tensors are replaced

    def variance(self, mean: Tensor) -> Tensor:
        """Variance of every channel at these means, both [..., 3, H, W] in electrons."""
        last = mean.movedim(-3, -1)
        return (self.noise(last * self.slope + self.black) / self.slope**2).movedim(-1, -3)

    def linear(self, electrons: Tensor) -> Tensor:
        """Electrons [C, 3, H, W] -> linear light [C, H, W, 3] in the unit of `Problem.linear16`, not clipped."""
        light = electrons.movedim(1, -1) * self.to_linear
        return light if self.matrix is None else light.clamp_max(1.0) @ self.matrix.T


def measured(problem: Problem) -> Measured:
    """The data of a problem; see `in_electrons`."""
    return in_electrons(
        noise=problem.noise, raw=problem.raw, linear16=problem.linear16, channels_share=problem.channels_share
    )


def in_electrons(
    *, noise: Noise | None, raw: RawPictures | None, linear16: Tensor | None, channels_share: tuple[str, ...]
) -> Measured:
    """Raw frames in electrons, or linear pictures where those were measured pixel by pixel.

    Args:
        noise: As in `Problem`.
        raw: As in `Problem`.
        linear16: As in `Problem`.
        channels_share: As in `Problem`.

    Raises:
        LacksInput: If the noise is not known, or is that of pictures whose pixels share it.
    """
    if noise is None:
        raise LacksInput(
            "denoising needs the noise of the data, and of this capture it is not known: name its camera, or take a "
            "method that works on the pictures alone"
        )
    linear = noise.linear16.curve
    if raw is not None and noise.raw is not None and (linear16 is None or raw.dn.shape[:3] == linear16.shape[:3]):
        mask = mask_of(raw.dn.shape[1:3], raw.cfa).to(raw.dn)
        dn = spread(raw.dn, mask) if raw.dn.ndim == 3 else raw.dn.movedim(-1, 1)
        matrix = None if linear.matrix is None else dn.new_tensor(linear.matrix)
        return electrons_of(dn, mask, noise.raw, _gain(noise.raw.curve, linear, dn), matrix)
    if linear16 is None:
        raise LacksInput("denoising needs raw frames or 16-bit linear pictures, and this capture has neither")
    if linear.interpolated or channels_share:
        shared = " and ".join(channels_share) or "demosaicing"
        raise LacksInput(
            f"denoising needs data whose noise is independent, and without raw frames that of neighbouring pixels is "
            f"shared through {shared}: take a method that works on the pictures alone"
        )
    pictures = linear16.movedim(-1, 1)
    mask = mask_of(pictures.shape[2:], None).to(pictures)
    return electrons_of(pictures, mask, noise.linear16, pictures.new_ones(3), None)


def _gain(raw: NoiseCurve, linear: NoiseCurve, like: Tensor) -> Tensor:
    """Linear light per DN [3], white balance included: the two curves describe the same noise in two units."""
    shot = [b / a if a > 0 else 0.0 for a, b in zip(raw.slope, linear.slope, strict=True)]
    read = [math.sqrt(b / a) if a > 0 else 0.0 for a, b in zip(raw.offset, linear.offset, strict=True)]
    return like.new_tensor([a if a > 0 else b for a, b in zip(shot, read, strict=True)])


def electrons_of(data: Tensor, mask: Tensor, noise: Variance, gain: Tensor, matrix: Tensor | None) -> Measured:
    """Data as `Measured`.

    Args:
        data: [C, 3, H, W], anything where the mask is 0.
        mask: [1, 3, H, W], 1 where a channel was measured.
        noise: Variance of the data.
        gain: Linear light per unit of the data [3], before the matrix.
        matrix: The colour matrix, or None.

    Raises:
        LacksInput: For data without noise.
    """
    curve = noise.curve
    offset, slope, black = (data.new_tensor(values) for values in (curve.offset, curve.slope, curve.black))
    if not bool(((offset > 0) | (slope > 0)).all()) or bool((offset < 0).any()):
        raise LacksInput(
            f"denoising needs a variance > 0 in every channel, got {tuple(curve.offset)} at black and a slope of "
            f"{tuple(curve.slope)}: data without noise need no denoiser"
        )
    unit = torch.maximum(slope, (offset / STRAIGHT).sqrt())
    electrons = (data - black[:, None, None]) / unit[:, None, None] * mask
    return Measured(electrons, mask, noise, black, unit, gain * unit, matrix)
