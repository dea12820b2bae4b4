"""Pictures as a network sees them: 2 x 2 pixels packed into one, the channels that were measured marked by a mask.

A picture of any camera is [B, 3, H, W] with a mask of the same shape: all ones of three chips, one of three behind a
colour filter array. Packing moves each 2 x 2 cell into 12 channels at half the size, so that one network serves both:
of a mosaic the mask says which filter lies where, however the picture was flipped or turned.
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from sensor_model.mosaicking import channel_index
from sensor_model.params import Cfa


def mask_of(size: Sequence[int], cfa: Cfa | None) -> Tensor:
    """The samples that a camera measures, float32 [1, 3, H, W] of zeros and ones; `size`: (H, W)."""
    height, width = size
    if cfa is None:
        return torch.ones(1, 3, height, width)
    channel = torch.from_numpy(channel_index((height, width), cfa))
    return F.one_hot(channel, 3).permute(2, 0, 1)[None].float()


def spread(mosaic: Tensor, mask: Tensor) -> Tensor:
    """A mosaic [B, H, W] as [B, 3, H, W] that is zero where nothing was measured."""
    return mosaic[:, None] * mask


_TENT = torch.tensor([[1.0, 2.0, 1.0], [2.0, 4.0, 2.0], [1.0, 2.0, 1.0]])


def filled(values: Tensor, mask: Tensor) -> Tensor:
    """Measured values unchanged, the missing ones as the weighted mean of their measured neighbours (bilinear).

    Args:
        values: [B, 3, H, W], anything where the mask is 0; at least 2 px a side.
        mask: The same shape, of ones where something was measured; every 2 x 2 pixels measure every channel.
    """
    kernel = _TENT.to(values).expand(3, 1, 3, 3)
    known = values * mask
    total = F.conv2d(F.pad(known, (1, 1, 1, 1)), kernel, groups=3)
    weight = F.conv2d(F.pad(mask, (1, 1, 1, 1)), kernel, groups=3)
    return torch.where(mask > 0, values, total / weight)


def pack(pictures: Tensor) -> Tensor:
    """[B, D, H, W] with even sides -> [B, 4 D, H/2, W/2]."""
    return F.pixel_unshuffle(pictures, 2)


def unpack(packed: Tensor) -> Tensor:
    """The inverse of `pack`."""
    return F.pixel_shuffle(packed, 2)


def turned(pictures: Tensor, turn: int) -> Tensor:
    """[B, D, H, W] after one of the eight flips and quarter turns, 0..7."""
    turned = torch.rot90(pictures, turn % 4, (2, 3))
    return turned.flip(3) if turn >= 4 else turned


def turned_back(pictures: Tensor, turn: int) -> Tensor:
    """The inverse of `turned`."""
    straight = pictures.flip(3) if turn >= 4 else pictures
    return torch.rot90(straight, -(turn % 4), (2, 3))
