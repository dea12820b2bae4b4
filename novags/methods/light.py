"""A camera's measurements, as light of known variance: for methods that work on data instead of pictures."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from novags.methods.inputs import LacksInput
from novags.methods.noise import Noise, Variance, over
from novags.methods.problem import Problem, RawPictures, Start, gathered
from sensor_model.isp import srgb_to_linear
from sensor_model.mosaicking import channel_index
from sensor_model.noise import NoiseCurve

BRIGHT = 0.99  # quantile of the green data that becomes a colour of 1


@dataclass(frozen=True, kw_only=True)
class MeasuredLight:
    """Pictures as measurements of white-balanced light, 0 = black, 1 = white, never clipped at black.

    Attributes:
        light: Measurements, float32 [C, H, W, 3]; nan where nothing was measured.
        noise: Their variance as a function of the mean, in the square of their unit.
        white: Light at which each channel saturates, [3].
        matrix: [3, 3] from this light to linear sRGB; None: the identity.
        shared: Why noise is not independent from datum to datum; empty if it is.
    """

    light: Tensor
    noise: Variance
    white: Tensor
    matrix: Tensor | None
    shared: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.light)

    @property
    def measured(self) -> Tensor:
        """Which data there are, bool [C, H, W, 3]."""
        return ~self.light.isnan()

    def mean(self) -> float:
        """Mean of all data; nan without any."""
        sums = [(float(view.nansum(dtype=torch.float64)), int((~view.isnan()).sum())) for view in self.light]
        total, count = map(sum, zip(*sums, strict=True))
        return total / count if count else float("nan")


def measured_light(
    noise: Noise, raw: RawPictures | None, linear16: Tensor | None, shared: tuple[str, ...]
) -> MeasuredLight:
    """The measurements of a capture: raw frames, else the linear 16-bit pictures.

    Zero is the black level that the noise model states; the files of a camera with a black-level error state another.
    Raw frames of another size than the pictures, or of unknown white balance, are left alone.

    Args:
        noise: Of its pictures.
        raw: As in `Problem`.
        linear16: As in `Problem`.
        shared: Why the noise of `linear16` is not independent: `channels_share` and `pixels_share` of the Problem.

    Raises:
        LacksInput: If the capture has neither, or raw frames alone that cannot be used.
    """
    fits = raw is not None and (linear16 is None or raw.dn.shape[:3] == linear16.shape[:3])
    if raw is not None and fits and raw.balance is not None and noise.raw is not None:
        light, curve, zero = _of_raw(raw, noise.raw.curve)
        matrix = None if raw.matrix is None else light.new_tensor(raw.matrix)
        white = light.new_tensor(raw.balance) - zero
        return MeasuredLight(light=light, noise=Variance(curve), white=white, matrix=matrix)
    if linear16 is None:
        lacking = "this capture has neither" if raw is None else "its raw frames have no known white balance or noise"
        raise LacksInput(f"this method needs raw frames or 16-bit linear pictures, and {lacking}")
    curve = noise.linear16.curve
    shared = shared or (("demosaicing",) if curve.interpolated else ())
    zero = linear16.new_tensor(curve.black)
    if curve.matrix is not None:
        zero = linear16.new_tensor(curve.matrix) @ zero
    white = linear16.new_tensor(curve.white).clamp_max(1.0) - zero  # the files end at 1, for any balance
    curve = over(curve, [1.0] * 3, curve.black) if curve.matrix is None else _of_grey(noise.linear16, zero)
    return MeasuredLight(light=linear16 - zero, noise=Variance(curve), white=white, matrix=None, shared=shared)


def problem_light(problem: Problem, noise: Noise, shared: tuple[str, ...]) -> MeasuredLight:
    """`measured_light` of a problem, whose 16-bit pictures are not read where raw frames do."""
    raw = problem.raw
    if raw is None or raw.balance is None or noise.raw is None:
        return measured_light(noise, raw, problem.linear16, shared)
    raw = replace(raw, dn=raw.dn)  # read once
    same = raw.dn.shape[:3] == (len(problem.views), problem.views.height, problem.views.width)
    return measured_light(noise, raw, None if same else problem.linear16, shared)


def _of_raw(raw: RawPictures, curve: NoiseCurve) -> tuple[Tensor, NoiseCurve, Tensor]:
    """Light [C, H, W, 3] of raw frames, nan in the channels that a pixel's filter hides, its noise, and its zero [3]
    as light over the black level of the files.
    """
    assert raw.balance is not None
    unit = [(raw.white - raw.black) / factor for factor in raw.balance]  # DN of light 1
    dn = raw.dn
    dn = dn if dn.ndim == 4 else dn[..., None].expand(*dn.shape, 3)
    lights = ((view - dn.new_tensor(curve.black)) / dn.new_tensor(unit) for view in dn)
    if raw.cfa is not None:
        height, width = dn.shape[1:3]
        index = torch.from_numpy(channel_index((height, width), raw.cfa)).long().to(dn.device)
        seen = torch.nn.functional.one_hot(index, 3).bool()
        lights = (torch.where(seen, light, torch.nan) for light in lights)
    light = gathered(lights, dn.new_empty(dn.shape))
    zero = (dn.new_tensor(curve.black) - raw.black) / dn.new_tensor(unit)
    return light, over(curve, unit, curve.black), zero


def _of_grey(variance: Variance, zero: Tensor) -> NoiseCurve:
    """The noise of pictures after a colour matrix, from their `zero` [3] on, as the noise of a camera without a matrix:
    right where the light is grey.
    """
    ends = torch.tensor([0.0, 0.5]).double()[:, None].expand(2, 3) + zero.cpu()
    dark, middle = variance(ends).tolist()
    slope = tuple(2 * (m - d) for d, m in zip(dark, middle, strict=True))
    nothing, never = (0.0,) * 3, (float("inf"),) * 3
    return NoiseCurve(
        black=nothing, white=(1.0,) * 3, offset=tuple(dark), slope=slope, quadratic=nothing, switch=never, step=nothing
    )


def brightness(light: Tensor) -> float:
    """The bright light of pictures [C, H, W, 3], which becomes a colour of 1; nan is left out.

    Raises:
        ValueError: If it is not above black.
    """
    greens = (view[..., 1] for view in light)  # one by one: places of all data take ten times their memory
    green = torch.cat([view[~view.isnan()] for view in greens])
    unit = float(torch.quantile(green[:: max(1, len(green) // 4_000_000)].double(), BRIGHT))
    if not unit > 0:
        raise ValueError(
            f"the {BRIGHT:.0%} quantile of the green pixels must be above black, got {unit:.3g}: these pictures "
            "hold no light, or the black level of the camera is wrong"
        )
    return unit


def first_light(start: Start, data: MeasuredLight) -> Tensor:
    """The light that the dark pictures show at the first points, in the unit and the space of the data: [P, 3]."""
    light = torch.from_numpy(np.asarray(srgb_to_linear(start.colors.cpu().numpy()), np.float32))
    return light if data.matrix is None else light @ torch.linalg.inv(data.matrix.cpu()).T


def raw_loss(render: Tensor, data: Tensor, epsilon: float, white: Tensor | None = None) -> Tensor:
    """Mean of ((min(render, white) - data) / (sg(render) + epsilon))^2, where sg holds its argument fixed.

    Mildenhall et al. 2022 (RawNeRF), section 4.1.

    Args:
        render: [..., 3].
        data: The same shape; nan is left out.
        epsilon: Without it, black renders would be divided by zero.
        white: Where each channel saturates, [3]; None: nowhere.
    """
    there = ~data.isnan()
    # torch.minimum would halve the slope where both are equal
    shown = render if white is None else torch.where(render > white, white, render)
    residual = torch.where(there, shown - data, 0.0) / (render.detach() + epsilon)
    return residual.square().sum() / there.sum().clamp_min(1)
