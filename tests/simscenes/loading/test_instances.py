"""Instances: one group of shapes shown many times, each time with an id of its own and with the group's materials."""

from typing import Any

import numpy as np
import pytest

from simscenes import Rig, plan_transport
from simscenes.backend import activate, using_variant
from simscenes.loading.load import build_scene
from simscenes.render.geometry import check_cameras, geometry_channels
from simscenes.rigs import intrinsics, look_at

VARIANTS = pytest.mark.parametrize("variant", ["auto", "scalar"])


def copies(mi: Any, ball: str = "dielectric") -> dict[str, Any]:
    """A ball and beside it, along x, a cube; both shown at y = -1 and at y = 1 above a floor."""

    def copy(y: float) -> dict[str, Any]:
        place = mi.ScalarTransform4f().translate([0, y, 0])
        return {"type": "instance", "to_world": place, "group": {"type": "ref", "id": "group"}}

    cube = mi.ScalarTransform4f().translate([1, 0, 0]).scale(0.3)
    group = {
        "type": "shapegroup",
        "ball": {"type": "sphere", "radius": 0.3, "bsdf": {"type": ball, "id": "shiny"}},
        "cube": {"type": "cube", "to_world": cube, "bsdf": {"type": "diffuse", "id": "matt"}},
    }
    floor = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, -1]).scale(9),
        "bsdf": {"type": "diffuse", "id": "ground"},
    }
    sky = {"type": "constant"}
    return {"type": "scene", "group": group, "left": copy(-1), "right": copy(1), "floor": floor, "sky": sky}


def rig_from(eye: Any, size: int = 60) -> Rig:
    K = intrinsics(size, size, 60)[None]
    return Rig(viewmats=look_at(eye, (eye[0], eye[1], -1), (0, 1, 0))[None], Ks=K, width=size, height=size)


@VARIANTS
def test_each_instance_has_an_id_and_shows_the_materials_of_its_group(variant: str) -> None:
    with using_variant(variant) as mi:
        loaded = build_scene(copies(mi), mi)
        rig = rig_from((0.5, 0, 4))
        channels = geometry_channels(mi, loaded, rig, 0)
    pixels, _ = rig.project([[0, -1, 0.3], [1, -1, 0.3], [0, 1, 0.3], [1, 1, 0.3], [0.5, 0, -1]])
    x, y = pixels[0].astype(int).T
    shapes, materials = np.array(["", *loaded.shapes]), np.array(["", *loaded.materials])
    assert shapes[channels["id"][y, x]].tolist() == ["left", "left", "right", "right", "floor"]
    assert materials[channels["material"][y, x]].tolist() == ["shiny", "matt", "shiny", "matt", "ground"]
    assert (channels["id"] > 0).all()
    assert np.isfinite(channels["Z"]).all()


@VARIANTS
def test_a_camera_inside_an_instance_is_refused_if_its_surface_is_opaque(variant: str) -> None:
    with using_variant(variant) as mi:
        inside = rig_from((0, 1, 0))
        check_cameras(mi, build_scene(copies(mi), mi), inside)
        with pytest.raises(ValueError, match="inside of 'right'"):
            check_cameras(mi, build_scene(copies(mi, "diffuse"), mi), inside)


def test_planning_sees_the_materials_of_instances() -> None:
    mi = activate()
    plans = [
        plan_transport(copies(mi, ball), 0.5, rig=rig_from((0.5, 0, 4), 16), measure=False)
        for ball in ("dielectric", "diffuse")
    ]
    assert [plan["polarisation"].reason.startswith("all surfaces are diffuse") for plan in plans] == [False, True]
