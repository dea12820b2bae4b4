"""Random numbers: the published Philox, and draws that depend on nothing but their own address."""

import numpy as np
import pytest

from sensor_model.frame import streams
from sensor_model.frame.streams import Draws

KNOWN_ANSWERS = [  # Random123, kat_vectors, philox4x32 10
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN_ANSWERS)
def test_philox_gives_the_published_answers(counter, key, expected):
    words = streams.philox(tuple(np.array([c], np.uint64) for c in counter), key)
    assert tuple(int(w[0]) for w in words) == expected


def test_a_crop_draws_what_the_whole_frame_draws_there():
    whole = Draws(seed=5, view=3).uniforms((20, 30, 3), streams.SHOT)
    crop = Draws(seed=5, view=3, origin=(4, 7)).uniforms((9, 11, 3), streams.SHOT)
    np.testing.assert_array_equal(crop, whole[4:13, 7:18])


def test_both_halves_of_a_seed_are_the_key():
    assert Draws(seed=5).key == (5, 0)
    assert Draws(seed=(7 << 32) + 5).key == (5, 7)


def test_streams_are_uniform_and_uncorrelated():
    n = 256 * 256
    base = {"seed": 1, "view": 2, "frame": 3}
    pixel = Draws(**base).uniforms((256, 256), streams.SHOT)
    assert 0 < pixel.min()
    assert pixel.max() < 1
    assert abs(pixel.mean() - 0.5) < 5 * np.sqrt(1 / 12 / n)
    assert abs(pixel.var() - 1 / 12) < 5 * np.sqrt(1 / 180 / n)
    others = [
        Draws(**base).uniforms((256, 256), streams.READ),
        Draws(**base).uniforms((256, 256), streams.DSNU),
        *(Draws(**(base | {key: 9})).uniforms((256, 256), streams.SHOT) for key in base),
    ]
    for other in others:
        assert abs(np.corrcoef(pixel.ravel(), other.ravel())[0, 1]) < 5 / np.sqrt(n)


def test_all_52_bits_of_a_uniform_number_are_random():
    whole = (Draws(seed=1).uniforms((40, 50), streams.SHOT) * 2**52).astype(np.uint64).ravel()
    bits = (whole[:, None] >> np.arange(52, dtype=np.uint64)) & np.uint64(1)
    alike = np.corrcoef(bits.astype(float), rowvar=False) - np.eye(52)
    assert np.abs(alike).max() < 5 / np.sqrt(whole.size)


@pytest.mark.parametrize("bad", [{"seed": -1}, {"seed": 2**64}, {"seed": 0, "view": 2**32}, {"seed": 0, "frame": -1}])
def test_indices_that_would_wrap_are_refused(bad):
    with pytest.raises(ValueError, match=r"must be in \[0"):
        Draws(**bad)
    with pytest.raises(ValueError, match="within 65536"):
        Draws(seed=0, origin=(65530, 0)).uniforms((10, 10), streams.SHOT)
