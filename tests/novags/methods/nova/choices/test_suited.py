"""What a run decides for its pictures before it starts: blind spots on mosaics or pictures, and what L_geo warps."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from novags.methods.nova.config import ConsistencyConfig, NovaConfig
from novags.methods.nova.denoiser_config import BlindSpotConfig, DenoiserConfig, ResUNetConfig
from novags.methods.nova.trainer import _Training, suited
from novags.methods.problem import Problem, RawPictures
from novags.splats import Views

BAYER = RawPictures(dn=torch.zeros(2, 8, 10), cfa="GBRG", black=0, white=1)
THREE_CHIPS = RawPictures(dn=torch.zeros(2, 8, 10, 3), cfa=None, black=0, white=1)
MOSAIC = {"raw": BAYER, "channels_share": ("demosaicing",)}

PARTNERS = ConsistencyConfig(max_distance=3.0)  # two cameras are 1.8 of their extents apart


def problem(**changes) -> Problem:
    viewmats = torch.eye(4).repeat(2, 1, 1)
    viewmats[1, 0, 3] = 0.1  # partners of each other
    views = Views(viewmats, torch.eye(3).repeat(2, 1, 1), 10, 8)
    dark = torch.rand(2, 8, 10, 3, generator=torch.Generator().manual_seed(0))
    start = SimpleNamespace(points=torch.rand(9, 3), colors=torch.rand(9, 3), extent=1.0)
    return Problem(**{"views": views, "srgb8": dark, "start": start, "seed": 0, **changes})


def config(packed: bool | None, per_channel: bool | None = None, **changes) -> NovaConfig:
    spots = BlindSpotConfig(packed=packed, per_channel=per_channel)
    network = ResUNetConfig(widths=(4,), bottleneck=4, normalization="none")
    return NovaConfig(denoiser=DenoiserConfig(network=network, blind_spots=spots), **changes)


@pytest.mark.parametrize(
    ("pictures", "packed", "per_channel"),
    [
        (MOSAIC, True, True),
        ({"raw": THREE_CHIPS}, False, True),
        ({}, False, True),
        ({"channels_share": ("demosaicing",)}, False, False),
        ({"raw": BAYER, "channels_share": ("demosaicing", "JPEG")}, False, False),
    ],
    ids=["mosaic", "three chips", "no raw", "unknown array", "JPEG"],
)
def test_left_open_mosaics_are_blinded_where_nothing_but_demosaicing_changed_them(pictures, packed, per_channel):
    spots = suited(config(None), problem(**pictures)).denoiser.blind_spots
    assert (spots.packed, spots.per_channel) == (packed, per_channel)


@pytest.mark.parametrize(
    ("pictures", "reason"),
    [
        ({"raw": THREE_CHIPS}, "the camera has none"),
        ({"channels_share": ("demosaicing",)}, "it is unknown without raw frames"),
        ({"raw": BAYER, "channels_share": ("demosaicing", "JPEG")}, "JPEG changed them"),
    ],
)
def test_mosaics_that_are_not_there_are_refused(pictures, reason):
    with pytest.raises(ValueError, match=f"packed needs .*{reason}"):
        suited(config(True), problem(**pictures))


def test_samples_of_a_mosaic_are_independent_and_those_of_its_pictures_are_not():
    assert suited(config(True, True), problem(**MOSAIC)).denoiser.blind_spots.per_channel
    with pytest.raises(ValueError, match="per_channel needs channels with independent noise"):
        suited(config(False, True), problem(**MOSAIC))


def test_no_gradient_passes_demosaicing():
    with pytest.raises(ValueError, match="no gradient through its demosaicing"):
        suited(config(True, detach_target=False), problem(**MOSAIC))
    assert suited(config(None, detach_target=False), problem(**MOSAIC)).denoiser.blind_spots.packed is False


def test_the_denoiser_gets_the_filter_array_of_the_capture():
    inputs = problem(**MOSAIC)
    training = _Training(inputs, inputs.srgb8, suited(config(True, consistency=PARTNERS), inputs), None)
    assert training.denoiser.cfa == "GBRG"
    assert training.denoiser.images.shape == (2, 4, 4, 5)


def test_the_geometric_loss_warps_noisy_pictures_if_asked_and_pseudo_clean_ones_else():
    inputs = problem()
    found = {}
    for warped in ("clean", "enhanced"):
        chosen = replace(config(False), consistency=replace(PARTNERS, warped=warped))
        training = _Training(inputs, inputs.srgb8, chosen, None)
        found[warped] = training.geo.images(1)
        assert torch.equal(training.clean(1), training.denoiser.denoise(1))
    assert torch.equal(found["enhanced"], inputs.srgb8[1])
    assert torch.equal(found["clean"], training.clean(1))
