"""The noise of a camera from its dark pictures alone: variance against mean, gain, black level, read noise.

All views are of one camera, so their pixels are pooled. In each of `BINS` ranges of local brightness the flattest
pixels are chosen by a smoothed gradient; there the mean square of a second difference, which vanishes on any plane
(Immerkaer 1996), gives the variance, and a weighted line through the bins is the curve. Texture that is as fine as a
pixel counts as noise.
"""

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from novags.methods.noise import Noise, Variance
from novags.methods.problem import Problem, RawPictures, refuse_uneven
from sensor_model.isp import srgb_to_linear
from sensor_model.noise import NoiseCurve

BINS = 16  # of brightness, each with its own estimate of the variance
FLAT_SHARE = 0.3  # of the pixels of a bin, the flattest ones: texture would count as noise
LEAST = 16  # px a side of a measured plane
SMALLEST = 2 * LEAST  # px a side of pictures behind a colour filter array, whose colours are measured each by itself
OUTLIER = 4.0  # standard deviations: larger differences are edges, and a normal's loss by this cut is made good
KEPT = 0.99887  # of the variance of a normal that is cut at OUTLIER standard deviations
# Second differences in x and in y: exactly zero on any plane. Their squares add up to 36.
_MASK = torch.tensor([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
# Neighbours share the noise of interpolated and of compressed pictures, so the variance seems to grow with the distance
# of the compared pixels. Measured with pictures of 2 to 80 electrons: from one to two pixels by 0.95 to 1.41 where they
# do not (more with more texture), by 1.8 to 2.6 after Menon's interpolation, by 3.7 and more after others and after
# JPEG.
SHARED, SHARED_MORE = 1.6, 3.0
BELOW_A_CODE = 3.0  # variances of rounding: noise of less than half a code is lost in the rounding to 8 bits
PIXELS = 4_000_000  # of all views together: more make no estimate better that texture limits


@dataclass(frozen=True)
class CameraFigures:
    """Facts about a camera from its raw frames.

    Attributes:
        gain: DN per electron.
        black: DN without light.
        read_noise: Standard deviation without light, electrons: read noise, and all other noise that does not grow with
            the light.
    """

    gain: float
    black: float
    read_noise: float


def noise_of(problem: Problem, source: Literal["camera", "pictures"] = "camera") -> Noise:
    """The noise of a problem's pictures.

    Args:
        problem: The problem.
        source: "camera": by the camera where it is known, else from the pictures; "pictures": from them in any case.

    Raises:
        LacksInput: For an estimate of views of several exposures.
        ValueError: For pictures that are too small to tell.
    """
    if source not in ("camera", "pictures"):
        raise ValueError(f"source must be camera or pictures, got {source!r}")
    if source == "camera" and problem.noise is not None:
        return problem.noise
    refuse_uneven(problem.exposures, "an estimate of the noise")
    mixed = "a colour matrix" in problem.channels_share
    key = ("noise from pictures", problem.names)
    return problem.once(key, lambda: noise_from(problem.srgb8, problem.linear16, problem.raw, mixed=mixed))


def noise_from(srgb8: Tensor, linear16: Tensor | None, raw: RawPictures | None, *, mixed: bool) -> Noise:
    """The noise of the pictures of one camera, estimated from them alone.

    Args:
        srgb8: The 8-bit pictures [C, H, W, 3], sRGB-encoded in 0..1; used where there are no 16-bit ones.
        linear16: The linear ones [C, H, W, 3], or None.
        raw: The raw frames, or None.
        mixed: Whether a colour matrix mixed the channels: then no pixel shows its own filter's measurement.
    """
    cfa = None if raw is None or mixed else raw.cfa
    if linear16 is not None:
        return estimate_noise(linear16, cfa=cfa, raw=raw)
    decoded = torch.from_numpy(np.asarray(srgb_to_linear(srgb8.cpu().double().numpy())))
    return estimate_noise(decoded, cfa=cfa, raw=raw, eight_bit=True)


def estimate_noise(
    linear: Tensor, *, cfa: str | None = None, raw: RawPictures | None = None, eight_bit: bool = False
) -> Noise:
    """Estimate variance = offset + slope * mean of each channel from linear pictures.

    Args:
        linear: [C, H, W, 3], at least 16 px a side (32 with `cfa`).
        cfa: The colour filter array that the pictures were interpolated from, if known and the channels were not mixed
            since: the curve then describes the measured values, whose noise neighbours do not share. Without it such
            sharing is found in the pictures, and differences are taken over two or three pixels.
        raw: The raw frames, whose curve is estimated too.
        eight_bit: Whether the pictures were 8-bit sRGB: the effect of clipping at black and of rounding on the noise is
            undone, so that the curve describes the light before.

    Raises:
        ValueError: For pictures that are too small.
    """
    least = LEAST if cfa is None else SMALLEST
    if linear.ndim != 4 or linear.shape[-1] != 3 or min(linear.shape[1:3]) < least:
        raise ValueError(f"linear must be [C, H >= {least}, W >= {least}, 3], got {list(linear.shape)}")
    planes = [linear[..., c].cpu().double() for c in range(3)]
    parts = [_measured(plane, cfa, "RGB"[c]) for c, plane in enumerate(planes)]
    reach = 1 if cfa is not None else max(_reach(plane, eight_bit) for plane in planes)
    lines = []
    for part in parts:
        mean, variance = _binned(part, reach)
        lines.append(_line(*(_before_8_bits(mean, variance) if eight_bit else (mean, variance))))
    offset, slope = (tuple(float(line[k]) for line in lines) for k in range(2))
    curve = _curve(0.0, 1.0, offset, slope)
    return Noise(Variance(curve), None if raw is None else Variance(estimate_raw_noise(raw)), "pictures")


def estimate_raw_noise(raw: RawPictures) -> NoiseCurve:
    """The noise of raw frames, DN², with the black and white level that they state. One curve for all channels."""
    mean, variance = _raw_bins(raw)
    offset, slope = (float(value) for value in _line(mean - raw.black, variance))
    return _curve(raw.black, raw.white, (offset,) * 3, (slope,) * 3)


def camera_figures(raw: RawPictures, *, black_known: bool = True) -> CameraFigures:
    """Gain, black level and read noise of a camera from raw frames of dark scenes.

    Args:
        raw: The frames.
        black_known: False: the black level that they state is not used, and the mean of the darkest hundredth takes its
            place. That is right where the scene has places without light, and too high by their light elsewhere.
    """
    mean, variance = _raw_bins(raw)
    black = raw.black if black_known else _darkest(raw)
    offset, slope = (float(value) for value in _line(mean - black, variance))
    if slope == 0:
        raise ValueError("gain: the variance of these frames does not grow with the light, so that they have none to "
                         "tell it from: use frames with more light")  # fmt: skip
    # 1/12: rounding to whole codes
    return CameraFigures(gain=slope, black=black, read_noise=math.sqrt(max(offset - 1 / 12, 0.0)) / slope)


def _curve(black: float, white: float, offset: tuple[float, ...], slope: tuple[float, ...]) -> NoiseCurve:
    zero, never = (0.0,) * 3, (math.inf,) * 3
    return NoiseCurve(
        black=(black,) * 3, white=(white,) * 3, offset=offset, slope=slope, quadratic=zero, switch=never, step=zero
    )


def _raw_bins(raw: RawPictures) -> tuple[Tensor, Tensor]:
    """Bins of all colours together: one amplifier reads them all."""
    found = [_binned(plane, 1) for plane in _raw_planes(raw)]
    return torch.cat([mean for mean, _ in found]), torch.cat([variance for _, variance in found])


def _raw_planes(raw: RawPictures) -> list[Tensor]:
    """Stacks [n, h, w] of pixels of one colour."""
    dn = raw.dn.cpu().double()
    if raw.cfa is None:
        planes = [dn[..., c] for c in range(3)] if dn.ndim == 4 else [dn]
    else:
        planes = [_measured(dn, raw.cfa, letter) for letter in "RGB"]
    if min(planes[0].shape[1:]) < LEAST:
        raise ValueError(f"raw frames must have {LEAST} px a side of each colour or more, got {list(planes[0].shape)}")
    return planes


def _measured(plane: Tensor, cfa: str | None, letter: str) -> Tensor:
    """The pixels of a plane [C, H, W] behind filters of one colour, as pictures of their own [n, h, w]."""
    if cfa is None:
        return plane
    height, width = (size - size % 2 for size in plane.shape[1:])
    places = [divmod(place, 2) for place in range(4) if cfa[place] == letter]
    return torch.cat([plane[:, y:height:2, x:width:2] for y, x in places])


def _darkest(raw: RawPictures) -> float:
    """Mean of the darkest hundredth of the places, each the mean of 9 x 9 pixels of one colour, DN."""
    means = torch.cat([F.avg_pool2d(plane[:, None], 9, stride=3).flatten() for plane in _raw_planes(raw)])
    return float(means.sort().values[: max(1, len(means) // 100)].mean())


def _reach(plane: Tensor, eight_bit: bool) -> int:
    """Over how many pixels differences are to be taken so that the noise of compared values is independent."""
    (mean, near), (_, far) = (_binned(plane, reach) for reach in (1, 2))
    clipped = int((mean < 2 * near.sqrt()).sum()) if eight_bit else 0
    first = min(clipped, BINS - 4)
    kept = slice(first, first + max(4, (BINS - first) // 2))  # the brighter ones show more texture
    if not float(near[kept].min()) > 0:
        return 3 if float(far[kept].sum()) > 0 else 1  # interpolated without noise in between; or no noise at all
    ratio = float((far / near)[kept].log().mean().exp())
    return 3 if ratio > SHARED_MORE else 2 if ratio > SHARED else 1


def _binned(plane: Tensor, reach: int) -> tuple[Tensor, Tensor]:
    """Mean and noise variance of flat pixels of every range of brightness, for a stack [C, H, W].

    Where neighbours are compared, pixels are sorted by the 16 around the 3 x 3 whose mean is taken: with one mean for
    both, the darkest bin would hold pixels that noise has darkened, and the line would be too flat. Pixels compared
    over a longer `reach` (px) are themselves among the 16, so that there all 25 serve for both.
    """
    stack = plane[:, None]
    response = F.conv2d(stack, _MASK.to(plane)[None, None], dilation=reach)[:, 0]
    smooth = F.avg_pool2d(stack, 5, stride=1)[:, 0]
    dx, dy = smooth[:, 1:-1, 2:] - smooth[:, 1:-1, :-2], smooth[:, 2:, 1:-1] - smooth[:, :-2, 1:-1]
    # The smoothed picture is 4 px smaller and its gradients another 2: all are cut to the pixels that have all of them.
    edge = max(reach, 3)
    steep = _inner(dx.square() + dy.square(), edge - 3).flatten()
    key = mean = _inner(smooth, edge - 2).flatten()
    if reach == 1:
        mean = _inner(F.avg_pool2d(stack, 3, stride=1)[:, 0], edge - 1).flatten()
        key = (25 * key - 9 * mean) / 16
    square = _inner(response, edge - reach).flatten().square() / 36
    means, variances = [], []
    for part in key.argsort().tensor_split(BINS):
        flat = part[steep[part].argsort()[: max(8, int(FLAT_SHARE * len(part)))]]
        means.append(mean[flat].mean())
        variances.append(_mean_square(square[flat]))
    return torch.stack(means), torch.stack(variances)


def _inner(values: Tensor, edge: int) -> Tensor:
    return values[:, edge : values.shape[1] - edge, edge : values.shape[2] - edge]


def _mean_square(square: Tensor) -> Tensor:
    """Mean of squares without outliers.

    The median alone would be fooled by noise that is not normal: a few electrons, the tails of read noise.
    """
    limit = square.median() / 0.45494  # of squares of a standard normal
    if limit == 0:
        return square.mean()  # most pixels are equal: a constant, or clipped at black
    for _ in range(4):
        limit = square[square <= OUTLIER**2 * limit].mean() / KEPT
    return limit


def _line(mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """Offset and slope >= 0 of the line through the bins; a bin's estimate scatters in proportion to its value."""
    # Floor: a constant picture has no noise, and weights of 1 / 0.
    weight = 1 / variance.clamp_min(1e-16)
    design = torch.stack([torch.ones_like(mean), mean.clamp_min(0)], 1) * weight[:, None]
    offset, slope = torch.linalg.lstsq(design, (variance * weight)[:, None], driver="gelsd").solution[:, 0]
    if slope < 0:
        return variance.median(), torch.zeros_like(slope)
    if offset < 0:  # the line through zero light and no noise
        slope = (design[:, 1] * variance * weight).sum() / design[:, 1].square().sum()
        return torch.zeros_like(offset), slope
    return offset, slope


def _before_8_bits(mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and variance of normals whose values, clipped at 0 and rounded to 8-bit sRGB, have these.

    Foi et al. 2008 in closed form: of max(X, 0) the ratio of mean and standard deviation says where X lies.
    """
    slope = torch.where(mean <= 0.0031308, 12.92, 1.055 / 2.4 * mean.clamp_min(0.0031308) ** (1 / 2.4 - 1))
    rounding = 1 / 12 / (255 * slope).square()
    told = variance > BELOW_A_CODE * rounding
    if int(told.sum()) < 2:
        told = torch.ones_like(told)
    mean, variance, rounding = mean[told], variance[told], rounding[told]
    spread = torch.where(variance > BELOW_A_CODE * rounding, variance - rounding, variance).sqrt()
    z, ratio, clipped_mean = _clipped_normal()
    # Floor: all codes alike, as far from clipping as can be
    at = (mean / spread.clamp_min(1e-30)).clamp(float(ratio[0]), float(ratio[-1]))
    where = torch.from_numpy(np.interp(at.numpy(), ratio, z))
    sigma = mean / torch.from_numpy(np.interp(where.numpy(), z, clipped_mean))
    known = (at > ratio[0]) & (at < ratio[-1])  # others are clipped away as good as whole, or not at all
    sigma = torch.where(known, sigma, spread)
    kept = at > ratio[0]
    if int(kept.sum()) < 2:
        kept = torch.ones_like(kept)
    return torch.where(known, where * sigma, mean)[kept], sigma.square()[kept]


@cache
def _clipped_normal() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """z; mean over standard deviation, and mean, of max(X, 0) for X normal with mean z and deviation 1."""
    from scipy import special

    z = np.linspace(-1.0, 6.0, 701)
    above, density = special.ndtr(z), np.exp(-0.5 * z * z) / math.sqrt(2 * math.pi)
    mean = z * above + density
    return z, mean / np.sqrt((z * z + 1) * above + z * density - mean**2), mean
