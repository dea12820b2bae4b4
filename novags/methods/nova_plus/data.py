"""What the camera measured, with the variance of its noise: all that this method is ever fitted to."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from novags.methods.noise import Noise, Variance
from novags.methods.problem import LacksInput, Problem, RawPictures
from sensor_model import NoiseCurve
from sensor_model.mosaic import channel_index

FULL = 0.98  # of white: a datum above it is taken for saturated


@dataclass(frozen=True)
class Exposures:
    """The training pictures as measurements of white-balanced light, 0 = black, 1 = white, never clipped at black.

    Attributes:
        light: Measurements, float32 [C, H, W, 3]; nan where nothing was measured.
        held: Pixels that no fit sees, bool [C, H, W]: they judge.
        noise: Their variance as a function of the mean, in the square of their unit.
        white: Light at which each channel saturates, [3].
        matrix: [3, 3] from this light to linear sRGB; None: the identity.
        independent: Whether neither pixels nor channels share noise.
    """

    light: Tensor
    held: Tensor
    noise: Variance
    white: Tensor
    matrix: Tensor | None
    independent: bool = True

    def __len__(self) -> int:
        return len(self.light)

    @property
    def measured(self) -> Tensor:
        """Which data there are, bool [C, H, W, 3]."""
        return ~self.light.isnan()

    @property
    def fitted(self) -> Tensor:
        """The data that fits may see, [C, H, W, 3], nan elsewhere."""
        return torch.where(self.held[..., None], torch.nan, self.light)

    @property
    def greens(self) -> Tensor:
        """All measurements of green, [n]."""
        green = self.light[..., 1]
        return green[~green.isnan()]


def exposures(problem: Problem, noise: Noise, held_share: float) -> Exposures:
    """The measurements of a problem: raw frames where they can be used, else the linear 16-bit pictures.

    Args:
        problem: The problem.
        noise: Of its pictures.
        held_share: Of the pixels, drawn by the problem's seed, to be held out; 0..1.

    Raises:
        LacksInput: If there are neither.
    """
    raw = problem.raw
    if raw is not None and raw.balance is not None and noise.raw is not None:
        light, curve = _of_raw(raw, noise.raw.curve)
        white, matrix, independent = torch.tensor(raw.balance), raw.matrix, True
    elif problem.linear16 is not None:
        light, curve = problem.linear16, noise.linear16.curve
        white, matrix = light.new_tensor(curve.white), None
        independent = not (curve.interpolated or problem.channels_share)
        if curve.matrix is not None:
            curve = _of_grey(noise.linear16)
    else:
        raise LacksInput("this method needs raw frames or 16-bit linear pictures, and this capture has neither")
    generator = torch.Generator().manual_seed(problem.seed)
    held = torch.rand(light.shape[:3], generator=generator) < held_share
    return Exposures(
        light=light, held=held.to(light.device), noise=Variance(curve), white=white.to(light),
        matrix=None if matrix is None else light.new_tensor(matrix), independent=independent,
    )  # fmt: skip


def _of_raw(raw: RawPictures, curve: NoiseCurve) -> tuple[Tensor, NoiseCurve]:
    """Light [C, H, W, 3] of raw frames, nan in the channels that a pixel's filter hides, and its noise."""
    assert raw.balance is not None
    unit = [(raw.white - raw.black) / factor for factor in raw.balance]  # DN of light 1
    dn = raw.dn if raw.dn.ndim == 4 else raw.dn[..., None].expand(*raw.dn.shape, 3)
    light = (dn - raw.black) / dn.new_tensor(unit)
    if raw.cfa is not None:
        height, width = dn.shape[1:3]
        index = torch.from_numpy(channel_index((height, width), raw.cfa)).long().to(dn.device)
        light = torch.where(torch.nn.functional.one_hot(index, 3).bool(), light, torch.nan)
    return light, _scaled(curve, raw.black, unit)


def _scaled(curve: NoiseCurve, black: float, unit: list[float]) -> NoiseCurve:
    """The noise of (datum - black) / unit."""

    def each(values: tuple[float, ...], power: int, shift: float = 0.0) -> tuple[float, ...]:
        return tuple((value - shift) / u**power for value, u in zip(values, unit, strict=True))

    return replace(
        curve, black=each(curve.black, 1, black), white=each(curve.white, 1, black),
        switch=each(curve.switch, 1, black), offset=each(curve.offset, 2), slope=each(curve.slope, 1),
        step=each(curve.step, 2),
    )  # fmt: skip


def _of_grey(variance: Variance) -> NoiseCurve:
    """The noise of pictures after a colour matrix as that of a camera without one: right where the light is grey."""
    ends = torch.tensor([0.0, 0.5]).double()[:, None].expand(2, 3)
    dark, middle = variance(ends).tolist()
    slope = tuple(2 * (m - d) for d, m in zip(dark, middle, strict=True))
    zero, never = (0.0,) * 3, (float("inf"),) * 3
    return NoiseCurve(
        black=zero, white=(1.0,) * 3, offset=tuple(dark), slope=slope, quadratic=zero, switch=never, step=zero
    )
