"""The fixed pattern of a camera: its own by its serial, and of a crop the part of the whole."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sensor_model import Defects, Sensor
from sensor_model.frame import pattern, streams

SHAPE = (12, 16, 3)
DEFECTS = Defects(hot_fraction=0.2, hot_factor=30, rts_fraction=0.2, rts_factor=4)


def of(serial: int) -> Sensor:
    return Sensor(
        gain=1.0, eta=0.5, mu_e_sat=1e4, black_level=64.0, bits=12, sigma_d=2.0, cfa=None, serial=serial,
        defects=DEFECTS,
    )  # fmt: skip


def marked(sites: Any, shape: tuple[int, ...]) -> np.ndarray:
    """A map that is 1 at the sites."""
    found = np.zeros(shape)
    found[sites] = 1
    return found


MAPS: dict[str, Callable[[int, tuple[int, ...], tuple[int, int]], Any]] = {
    "response": lambda serial, shape, origin: pattern.response_map(serial, 0.1, shape, origin),
    "offset": lambda serial, shape, origin: pattern.offset_map(serial, 2.0, shape, origin),
    "hot": lambda serial, shape, origin: pattern.dark_map(of(serial), 5.0, shape, origin),
    "telegraph": lambda serial, shape, origin: marked(pattern.telegraph_sites(of(serial), shape, origin), shape),
}


@pytest.mark.parametrize("name", list(MAPS))
def test_every_camera_has_a_pattern_of_its_own_and_crops_have_their_part_of_it(name: str) -> None:
    first, again, other = (np.array(MAPS[name](serial, SHAPE, (0, 0))) for serial in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.1
    crop = MAPS[name](1, (5, 7, 3), (4, 6))
    np.testing.assert_array_equal(crop, first[4:9, 6:13])


def test_patterns_of_one_camera_have_nothing_to_do_with_each_other() -> None:
    found = [np.array(make(1, SHAPE, (0, 0)), np.float64).ravel() for make in MAPS.values()]
    between = np.corrcoef(found)[np.triu_indices(len(found), 1)]
    assert np.abs(between).max() < 5 / np.sqrt(found[0].size)


def test_kinds_of_defects_lie_at_places_of_their_own() -> None:
    hot, telegraph = (marked(pattern.sites(1, 0.2, SHAPE, (0, 0), s), SHAPE) for s in (streams.HOT, streams.RTS_SITE))
    assert 0.1 < hot.mean() < 0.3
    assert (hot != telegraph).any()
