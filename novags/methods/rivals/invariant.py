"""Where a picture has edges of the surfaces, under any light.

Geusebroek et al. 2001 (Color Invariance, IEEE TPAMI 23, 12): the Gaussian colour model gives the spectral derivatives
E, E_l and E_ll of the light in a pixel, linear in its red, green and blue. Under light of one spectrum, of any
strength, matte paint keeps W_x = E_x / E, W_lx = E_lx / E and W_llx = E_llx / E; their Euclidean length over x and y is
the invariant W.
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

COLOUR_MODEL = ((0.06, 0.63, 0.27), (0.30, 0.04, -0.35), (0.34, -0.60, 0.17))  # E, E_l and E_ll of red, green, blue
SCALE = 1.0  # px, of the Gaussian that pictures are differentiated with
DARKEST = 1e-5  # of the brightest pixel: the ratios of black are 0 / 0


def _kernels(scale: float, like: Tensor) -> tuple[Tensor, Tensor]:
    """A Gaussian of sum 1, and its derivative, which has a slope of 1 on a ramp of slope 1."""
    reach = math.ceil(4 * scale)
    x = torch.arange(-reach, reach + 1, device=like.device, dtype=like.dtype)
    smooth = torch.exp(-0.5 * (x / scale).square())
    slope = x * smooth
    return smooth / smooth.sum(), slope / (slope * x).sum()


def _filtered(planes: Tensor, along_y: Tensor, along_x: Tensor) -> Tensor:
    """Planes [N, H, W] correlated with a kernel along each axis; the border repeats its last pixel."""
    reach = len(along_x) // 2
    wide = F.pad(planes[:, None], (reach, reach, reach, reach), mode="replicate")
    return F.conv2d(F.conv2d(wide, along_y[None, None, :, None]), along_x[None, None, None, :])[:, 0]


def invariant(light: Tensor, scale: float = SCALE) -> Tensor:
    """The invariant W of linear light [H, W, 3]: [H, W], >= 0, per px."""
    planes = light.new_tensor(COLOUR_MODEL) @ light.reshape(-1, 3).T
    planes = planes.reshape(3, *light.shape[:2])
    smooth, slope = _kernels(scale, light)
    strength = _filtered(planes[:1], smooth, smooth)
    strength = strength.clamp_min(DARKEST * float(strength.max().clamp_min(torch.finfo(light.dtype).tiny)))
    across, down = _filtered(planes, smooth, slope), _filtered(planes, slope, smooth)
    length: Tensor = ((across / strength).square() + (down / strength).square()).sum(0).sqrt()
    return length


def structure(light: Tensor, scale: float = SCALE) -> Tensor:
    """The invariant of linear light [H, W, 3] against its median over the picture, W / (W + median): [H, W] in 0..1."""
    found = invariant(light, scale)
    middle = found.median()
    return found / (found + middle) if middle > 0 else (found > 0).to(found)
