"""The measurements of a capture, in electrons: the data that a denoiser works on, from any camera."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from novags.methods.inputs import LacksInput
from novags.methods.light import MeasuredLight, measured_light, problem_light
from novags.methods.noise import Noise, Variance
from novags.methods.problem import Problem, RawPictures, gathered, refuse_uneven

# Data whose noise does not grow with the signal have no electrons. They are taken as so many that the transform is
# straight over the whole range: the variance of this many electrons is the read variance.
STRAIGHT = 1e4


@dataclass(frozen=True)
class MeasuredPictures:
    """Pictures in electrons, and the way to linear light.

    "Electrons" are the unit in which shot noise has the variance of its mean: the datum over the slope of its variance.

    Attributes:
        electrons: [C, 3, H, W] float32, 0 = black, not clipped; 0 where nothing was measured.
        mask: [1, 3, H, W], 1 where a channel was measured.
        noise: Variance of the data as the source states it, for means [..., 3].
        unit: [3], linear light per electron, before the matrix.
        matrix: [3, 3], or None: the colour matrix of the linear pictures.
    """

    electrons: Tensor
    mask: Tensor
    noise: Variance
    unit: Tensor
    matrix: Tensor | None

    @property
    def read_variance(self) -> Tensor:
        """[3], electrons**2."""
        return self.electrons.new_tensor(self.noise.curve.offset) / self.unit**2

    def to(self, device: torch.device | str) -> "MeasuredPictures":
        """The same on another device."""
        moved = {f.name: value.to(device) for f in fields(self) if isinstance(value := getattr(self, f.name), Tensor)}
        return replace(self, **moved)  # type: ignore[arg-type]  # only tensors are replaced

    def variance(self, mean: Tensor) -> Tensor:
        """Variance of every channel at these means, both [..., 3, H, W] in electrons."""
        last = mean.movedim(-3, -1)
        return (self.noise(last * self.unit) / self.unit**2).movedim(-1, -3)

    def linear(self, electrons: Tensor) -> Tensor:
        """Electrons [C, 3, H, W] -> linear light [C, H, W, 3] in the unit of `Problem.linear16`.

        Not clipped, but for values above 1 before a colour matrix: development clips there too.
        """
        light = electrons.movedim(1, -1) * self.unit
        return light if self.matrix is None else light.clamp_max(1.0) @ self.matrix.T


def measured(problem: Problem) -> MeasuredPictures:
    """The data of a problem in electrons.

    Raises:
        LacksInput: If the data have no noise, their noise is unknown, neighbouring data share it, or views differ in
            exposure.
    """
    refuse_uneven(problem.exposures, "denoising")
    noise = _known(problem.noise)
    return in_electrons(problem_light(problem, noise, problem.channels_share + problem.pixels_share))


def of_capture(
    noise: Noise | None, raw: RawPictures | None, linear16: Tensor | None, shared: tuple[str, ...]
) -> MeasuredPictures:
    """The data of a capture in electrons, from the fields of a `Problem`; see `measured`."""
    return in_electrons(measured_light(_known(noise), raw, linear16, shared))


def _known(noise: Noise | None) -> Noise:
    if noise is None:
        raise LacksInput(
            "denoising needs the noise of the data, and of this capture it is not known: name its camera, or take a "
            "method that works on the pictures alone"
        )
    return noise


def in_electrons(data: MeasuredLight, light: Iterable[Tensor] | None = None) -> MeasuredPictures:
    """Measurements in electrons.

    Args:
        data: The measurements.
        light: Pictures [H, W, 3], one by one, in place of theirs.

    Raises:
        LacksInput: For noise that neighbouring data share, and for data without noise.
    """
    if data.shared:
        raise LacksInput(
            f"denoising needs data whose noise is independent, and without raw frames neighbouring pixels' noise is "
            f"shared through {' and '.join(data.shared)}: take a method that works on the pictures alone"
        )
    curve, like = data.noise.curve, data.light
    offset, slope = (like.new_tensor(values) for values in (curve.offset, curve.slope))
    if not bool(((offset > 0) | (slope > 0)).all()) or bool((offset < 0).any()):
        raise LacksInput(
            f"denoising needs a variance > 0 in every channel, got {tuple(curve.offset)} at black and a slope of "
            f"{tuple(curve.slope)}: data without noise need no denoiser"
        )
    unit = torch.maximum(slope, (offset / STRAIGHT).sqrt())
    count, height, width, channels = like.shape
    planes = ((view / unit).nan_to_num(0.0).movedim(-1, 0) for view in (like if light is None else light))
    electrons = gathered(planes, like.new_empty(count, channels, height, width))
    mask = (~like[:1].isnan()).movedim(-1, 1).to(like)
    return MeasuredPictures(electrons, mask, data.noise, unit, data.matrix)
