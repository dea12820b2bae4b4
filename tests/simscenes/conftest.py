"""Small scenes and cameras around them, for all that plans and renders light."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from simscenes import Rig, orbit_rig, render_set
from simscenes.backend import activate, using_variant

GRAY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.4, 0.2]}}


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


def ball_on_plane() -> dict[str, Any]:
    """Unit sphere resting on z = 0, a small lamp, a bright sky: two lights and one material shared by two shapes."""
    ref = {"type": "ref", "id": "paint"}
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 9.0}}
    with using_variant() as mi:
        lamp = mi.ScalarTransform4f().translate([1, -1, 4]).rotate([1, 0, 0], 180).scale(0.4)
    return {
        "type": "scene",
        "paint": GRAY,
        "plane": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(3), "bsdf": ref},
        "ball": {"type": "sphere", "center": [0, 0, 1], "radius": 1.0, "bsdf": ref},
        "lamp": {"type": "rectangle", "to_world": lamp, "emitter": glow},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.2, 0.3, 0.4]}},
    }


def small_job(out: Path, rig: Rig | None = None, **more: Any) -> Any:
    rig = rig or orbit_rig(3, 17, 13, 60, target=(0, 0, 0.8), radius=4.0)
    return render_set(ball_on_plane(), rig, out, **{"spp": 4, "plan": "rgb", **more})


@pytest.fixture(name="ball_on_plane", scope="session")
def _ball_on_plane() -> Callable[[], dict[str, Any]]:
    return ball_on_plane


@pytest.fixture(name="small_job", scope="session")
def _small_job() -> Callable[..., Any]:
    """A render of it, of three views and four samples unless asked otherwise."""
    return small_job
