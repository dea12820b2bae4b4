"""Packed mosaics against loops over pixels, and against demosaicing itself: what it keeps, and where its noise is."""

import numpy as np
import pytest
import torch

from novags.methods.nova import denoiser as module
from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.denoiser_config import BlindSpotConfig, DenoiserConfig, ResUNetConfig
from novags.methods.nova.packed import demosaiced, packed, turned
from sensor_model.isp import interpolate
from sensor_model.params import CFAS

CONFIG = DenoiserConfig(
    network=ResUNetConfig(widths=(4,), bottleneck=4, normalization="none"),
    blind_spots=BlindSpotConfig(mask_fraction=0.1, packed=True, per_channel=True),
)


def sample(picture: np.ndarray, cfa: str, y: int, x: int) -> float:
    """What the pixel (y, x) measures; beyond the border, the pixel mirrored about the last one."""
    height, width = picture.shape[:2]
    y, x = (2 * height - 2 - y if y >= height else y), (2 * width - 2 - x if x >= width else x)
    return picture[y, x, "RGB".index(cfa[2 * (y % 2) + x % 2])]


@pytest.mark.parametrize("cfa", CFAS)
@pytest.mark.parametrize("size", [(4, 6), (5, 6), (7, 3)])
def test_each_plane_holds_what_one_place_of_the_cell_measures(cfa, size):
    picture = np.random.default_rng(0).uniform(0, 1, (2, *size, 3))
    found = packed(torch.from_numpy(picture), cfa).numpy()
    assert found.shape == (2, 4, -(-size[0] // 2), -(-size[1] // 2))
    for view, k, y, x in np.ndindex(found.shape):
        assert found[view, k, y, x] == sample(picture[view], cfa, 2 * y + k // 2, 2 * x + k % 2)


@pytest.mark.parametrize("cfa", CFAS)
def test_a_picture_that_was_demosaiced_comes_back(cfa):
    """Rationale: demosaicing must keep the samples, or there would be no mosaic in the picture."""
    mosaic = np.random.default_rng(1).uniform(0, 1, (13, 18))
    picture = interpolate(mosaic, cfa, "menon")
    planes = packed(torch.from_numpy(picture)[None], cfa)[0]
    np.testing.assert_allclose(demosaiced(planes, cfa, 13, 18).numpy(), picture, atol=1e-12)


@pytest.mark.parametrize("cfa", CFAS)
@pytest.mark.parametrize("turn", range(8))
def test_a_turned_mosaic_is_a_mosaic_of_the_turned_scene(cfa, turn):
    """Every sample keeps its letter: a scene of one colour in each channel looks the same from every side."""
    scene = torch.rand(1, 10, 14, 3, generator=torch.Generator().manual_seed(turn))
    found = turned(packed(scene, cfa), turn, cfa)
    upright = torch.rot90(scene, turn % 4, (1, 2))
    upright = upright.flip(2) if turn >= 4 else upright
    # The turned scene, sampled from each of the four phases that the pattern can have there.
    phases = [
        packed(upright[:, y : upright.shape[1] - y, x : upright.shape[2] - x], cfa) for y in (0, 1) for x in (0, 1)
    ]
    assert sum(phase.shape == found.shape and torch.equal(phase, found) for phase in phases) == 1


def test_the_network_sees_samples_and_its_output_is_demosaiced(monkeypatch):
    picture = torch.rand(2, 9, 12, 3, generator=torch.Generator().manual_seed(0))
    config = DenoiserConfig(network=CONFIG.network, blind_spots=CONFIG.blind_spots, noisy_share=0.25)
    subject = Denoiser(picture, config, total_steps=1, seed=0, cfa="GRBG")
    subject.network = lambda planes: 0.5 * planes
    planes = packed(picture, "GRBG")[1]
    mosaic = np.empty((10, 12))
    for k, y, x in np.ndindex(4, 5, 6):
        mosaic[2 * y + k // 2, 2 * x + k % 2] = (0.75 * 0.5 + 0.25) * planes[k, y, x]
    expected = np.clip(interpolate(mosaic[:9], "GRBG", "menon"), 0, 1)
    np.testing.assert_allclose(subject.denoise(1), expected, atol=1e-6)
    assert subject.denoise_all().shape == (2, 9, 12, 3)


@pytest.mark.parametrize(("per_channel", "planes"), [(True, (8, 1, 4, 6)), (False, (2, 4, 4, 6))])
def test_samples_are_blinded_by_themselves_or_cell_by_cell(monkeypatch, per_channel, planes):
    shapes = []
    monkeypatch.setattr(module, "sample_mask", lambda p, *rest: shapes.append(tuple(p.shape)) or p[:, 0] > 0.5)
    spots = BlindSpotConfig(packed=True, per_channel=per_channel)
    config = DenoiserConfig(network=CONFIG.network, blind_spots=spots, batch=2)
    images = torch.rand(2, 8, 12, 3, generator=torch.Generator().manual_seed(0))
    Denoiser(images, config, total_steps=1, seed=0, cfa="RGGB").loss()
    assert shapes == [planes]


def test_augmented_batches_are_turned_as_mosaics(monkeypatch):
    turns = []
    monkeypatch.setattr(module, "turned", lambda batch, turn, cfa: turns.append((turn, cfa)) or batch)
    config = DenoiserConfig(network=CONFIG.network, blind_spots=CONFIG.blind_spots, augment=True)
    subject = Denoiser(torch.rand(1, 8, 8, 3), config, total_steps=1, seed=0, cfa="BGGR")
    for _ in range(60):
        subject._draw_batch()
    assert {turn for turn, _ in turns} == set(range(8))
    assert {cfa for _, cfa in turns} == {"BGGR"}


def test_without_packed_blind_spots_the_filter_array_changes_nothing():
    images = torch.rand(1, 8, 8, 3, generator=torch.Generator().manual_seed(0))
    subject = Denoiser(images, DenoiserConfig(network=CONFIG.network), total_steps=1, seed=0, cfa="RGGB")
    assert torch.equal(subject.images, images.movedim(-1, 1))
    assert subject.network.head.out_channels == 3
