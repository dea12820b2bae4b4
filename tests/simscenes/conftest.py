"""A small matt scene and cameras around it, for all that plans and renders light."""

from collections.abc import Callable
from typing import Any

import pytest

from simscenes import Rig, orbit_rig
from simscenes.backend import activate


@pytest.fixture(scope="session")
def diffuse_box() -> Callable[..., dict[str, Any]]:
    """A ball on a floor under a white sky, all of one matt colour; with whatever else is given."""

    def make(**more: Any) -> dict[str, Any]:
        white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.6, 0.5]}}
        mi = activate()
        floor = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(3), "bsdf": white}
        ball = {"type": "sphere", "center": [0, 0, 0.5], "radius": 0.5, "bsdf": white}
        return {"type": "scene", "floor": floor, "ball": ball, "sky": {"type": "constant"}, **more}

    return make


@pytest.fixture(scope="session")
def ring() -> Rig:
    """Four small views around it."""
    return orbit_rig(4, 32, 32, 45, target=(0, 0, 0.4), radius=3.0)
