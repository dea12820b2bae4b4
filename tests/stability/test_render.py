"""Every hard case of the renderer holds; what would break it does; and what it cannot see is as stated."""

from typing import Any

import numpy as np
import pytest

from novags.testbed.stability import PARTS, Case, Setting, measured
from novags.testbed.stability.parts import render as cases
from simscenes.render import radiance


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def holds(start: str, backend: str = "scalar_rgb") -> bool:
    (case,) = [case for case in PARTS["render"].cases if case.name.startswith(start)]
    return measured(case, Setting(backend, 1)).holds


def test_files_of_half_precision_lose_lamps(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = cases.read_exr

    def halved(path: Any) -> Any:
        channels, header = whole(path)
        with np.errstate(over="ignore"):
            return {name: plane.astype(np.float16).astype(np.float32) for name, plane in channels.items()}, header

    monkeypatch.setattr(cases, "read_exr", halved)
    with np.errstate(invalid="ignore"):
        assert not holds("lamps of radiance")


def test_a_filter_wider_than_a_pixel_carries_a_lamp_into_its_neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = radiance.sensor_dict

    def blurred(*given: Any) -> dict[str, Any]:
        found = whole(*given)
        return {**found, "film": {**found["film"], "rfilter": {"type": "gaussian"}}}

    assert holds("a lamp of radiance 1e6")
    monkeypatch.setattr(radiance, "sensor_dict", blurred)
    assert not holds("a lamp of radiance 1e6")


def test_a_depth_that_starts_at_the_near_plane_is_too_short(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = cases.geometry_channels

    def from_near_plane(mi: Any, loaded: Any, rig: Any, i: int) -> Any:
        found = whole(mi, loaded, rig, i)
        return {**found, "distance": found["distance"] - 1e-4 * loaded.extent}

    monkeypatch.setattr(cases, "geometry_channels", from_near_plane)
    assert not holds("depth of a floor")


def test_a_ray_that_starts_a_thousandth_off_its_surface_misses_the_light_of_a_gap(jit: None) -> None:
    """The page on stability states where Mitsuba's own offset, 9e-5 of a scene of size 1, ends what is seen."""
    here = Setting("llvm_ad_rgb", 1)
    assert cases.gap(1.5e-4, here) < 1e-3
    assert cases.gap(5e-5, here) > 0.99
