"""Packing, masks and interpolation against slow independent versions."""

import numpy as np
import pytest
import torch

from novags.methods.denoised.packing import filled, mask_of, pack, spread, turned, turned_back, unpack
from sensor_model import mosaic
from sensor_model.isp import interpolate
from sensor_model.params import CFAS, Cfa


def test_packing_moves_the_four_pixels_of_a_cell_into_channels_and_back() -> None:
    pictures = torch.rand(2, 3, 6, 8, generator=torch.Generator().manual_seed(0))
    packed = pack(pictures)
    for channel in range(3):
        for y in range(2):
            for x in range(2):
                assert torch.equal(packed[:, 4 * channel + 2 * y + x], pictures[:, channel, y::2, x::2])
    assert torch.equal(unpack(packed), pictures)


@pytest.mark.parametrize("cfa", CFAS)
def test_the_mask_marks_what_the_camera_measures(cfa: Cfa) -> None:
    rgb = np.random.default_rng(0).random((5, 7, 3)).astype(np.float32)
    mask = mask_of((5, 7), cfa)
    measured = torch.from_numpy(mosaic(rgb, cfa))
    assert torch.equal((torch.from_numpy(rgb).permute(2, 0, 1) * mask[0]).sum(0), measured)
    assert torch.equal(spread(measured[None], mask)[0].sum(0), measured)
    assert torch.equal(mask.sum(1), torch.ones(1, 5, 7))


def test_three_chips_measure_everything() -> None:
    assert torch.equal(mask_of((3, 4), None), torch.ones(1, 3, 3, 4))


@pytest.mark.parametrize("cfa", CFAS)
def test_missing_values_are_interpolated_as_by_bilinear_demosaicing(cfa: Cfa) -> None:
    data = np.random.default_rng(1).random((10, 12))
    mask = mask_of((10, 12), cfa).double()
    found = filled(spread(torch.from_numpy(data)[None], mask), mask)[0].permute(1, 2, 0).numpy()
    wanted = interpolate(data, cfa, "bilinear")
    np.testing.assert_allclose(found[1:-1, 1:-1], wanted[1:-1, 1:-1], atol=1e-12)  # borders mirror there
    constant = filled(torch.full((1, 3, 10, 12), 7.0) * mask_of((10, 12), cfa), mask_of((10, 12), cfa))
    torch.testing.assert_close(constant, torch.full((1, 3, 10, 12), 7.0))


def test_the_eight_turns_differ_and_each_is_undone() -> None:
    picture = torch.rand(1, 3, 4, 6, generator=torch.Generator().manual_seed(2))
    seen = [turned(picture, turn) for turn in range(8)]
    assert len({tuple(s.flatten().tolist()) for s in seen}) == 8
    assert all(torch.equal(turned_back(s, turn), picture) for turn, s in enumerate(seen))
