"""Mosaics of demosaiced pictures, packed: the four samples of a 2 x 2 cell as channels of a picture of half the size.

Demosaicing keeps the measurement of a pixel and fills in the rest from neighbours, so that the noise of the filled-in
values is no longer their own, and a blind-spot network could copy it. At the places of the colour filter array the
pictures still hold the sensor's samples, each with noise of its own. Channels are in the order of the pattern: "RGGB"
is red, green of the red rows, green of the blue rows, blue.
"""

from itertools import product

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from sensor_model.isp import interpolate
from sensor_model.params import Cfa


def _letters(cfa: Cfa) -> Tensor:
    """Channel that each pixel of a cell measures, [2, 2]."""
    return torch.tensor(["RGB".index(letter) for letter in cfa]).reshape(2, 2)


def packed(pictures: Tensor, cfa: Cfa) -> Tensor:
    """The measured samples of demosaiced pictures.

    Args:
        pictures: [C, H, W, 3].
        cfa: Colour filter array.

    Returns:
        [C, 4, ceil(H / 2), ceil(W / 2)]; where a side is odd, the last cells are completed by reflection, which keeps
        the pattern.
    """
    height, width = pictures.shape[1:3]
    down, right = height % 2, width % 2
    mode = "reflect" if min(height - down, width - right) > 0 else "replicate"
    planes = (
        F.pad(pictures.movedim(-1, 1), (0, right, 0, down), mode=mode) if down or right else pictures.movedim(-1, 1)
    )
    cells = F.pixel_unshuffle(planes.contiguous(), 2).unflatten(1, (3, 4))
    return torch.stack([cells[:, int(c), k] for k, c in enumerate(_letters(cfa).flatten())], 1)


def demosaiced(planes: Tensor, cfa: Cfa, height: int, width: int) -> Tensor:
    """A picture [height, width, 3] from packed samples [4, h, w], without gradient (Menon 2007)."""
    mosaic = F.pixel_shuffle(planes.detach()[None], 2)[0, 0, :height, :width]
    return torch.from_numpy(np.ascontiguousarray(interpolate(mosaic.cpu().numpy(), cfa, "menon"))).to(planes)


def turned(batch: Tensor, turn: int, cfa: Cfa) -> Tensor:
    """Packed samples turned and mirrored as one mosaic, then cut to the cells of the same pattern.

    Args:
        batch: [B, 4, h, w].
        turn: Quarter turns, plus 4 for a mirror image; 0..7.
        cfa: Colour filter array.

    Returns:
        [B, 4, h', w'], a cell smaller along each axis on which the turned pattern begins one pixel later.
    """

    def moved(image: Tensor) -> Tensor:
        image = torch.rot90(image, turn % 4, (-2, -1))
        return image.flip(-1) if turn >= 4 else image

    letters = _letters(cfa)
    starts = product((0, 1), (0, 1))
    y, x = next(s for s in starts if torch.equal(moved(letters).roll((-s[0], -s[1]), (0, 1)), letters))
    mosaic = moved(F.pixel_shuffle(batch, 2))
    return F.pixel_unshuffle(mosaic[..., y : mosaic.shape[-2] - y, x : mosaic.shape[-1] - x], 2)
