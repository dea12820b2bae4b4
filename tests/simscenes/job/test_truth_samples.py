"""Held-out views are the truth that methods are judged by: they may have more samples, and their halves are kept."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import orbit_rig, render_set


def lamp_and_floor() -> dict[str, Any]:
    return {
        "type": "scene",
        "lamp": {"type": "sphere", "center": [0, 0, 2], "radius": 0.4,
                 "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [9, 8, 7]}}},
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}},
        "ball": {"type": "sphere", "center": [0.3, 0, 0.3], "radius": 0.3},
    }  # fmt: skip


def test_held_out_views_get_their_own_number_of_samples_and_training_views_stay_as_they_are(tmp_path: Path) -> None:
    """The truth that methods are judged by: every 8th view, from 0."""
    rig = orbit_rig(9, 16, 16, 40, radius=4.0)
    plain, better = (
        render_set(lamp_and_floor(), rig, tmp_path / str(times), spp=8, plan="rgb", truth_samples=times)
        for times in (1, 4)
    )
    spp = [view["spp"] for view in better.meta["views"].values()]
    assert spp == [32, 8, 8, 8, 8, 8, 8, 8, 32]
    for i in range(9):
        same = np.array_equal(plain.radiance(i), better.radiance(i))
        assert same == (i not in better.test_indices)


def test_a_held_out_view_stops_at_a_smaller_error(tmp_path: Path) -> None:
    rig = orbit_rig(3, 16, 16, 40, radius=4.0)
    found = render_set(lamp_and_floor(), rig, tmp_path, target_error=0.1, plan="rgb", truth_samples=4)
    errors = [view["relative_error"] for view in found.meta["views"].values()]
    assert errors[0] <= 0.05
    assert max(errors[1:]) <= 0.1


def test_the_halves_of_a_view_are_renders_of_their_own_whose_mean_it_is(tmp_path: Path) -> None:
    rig = orbit_rig(3, 16, 16, 40, radius=4.0)
    found = render_set(lamp_and_floor(), rig, tmp_path, spp=16, plan="rgb")
    light, half, variance = found.radiance(1), found.half(1), found.variance(1)
    assert half is not None
    assert variance is not None
    assert (light - np.abs(half) >= -1e-6).all()  # neither is darker than black
    assert np.mean(half**2) == pytest.approx(variance.mean(), rel=1e-4)


def test_truth_samples_below_one_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="truth_samples must be 1 to"):
        render_set(lamp_and_floor(), None, tmp_path, spp=8, truth_samples=0.5)
