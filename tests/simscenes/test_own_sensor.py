"""The sensor that comes with a scene: its lens, film and fog become the rig's, whichever way they are written."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import fit_rig, plan_transport, render_set
from simscenes.backend import activate
from simscenes.render.fit import own_rig
from simscenes.render.geometry import pixel_rays
from simscenes.render.source import build_scene

CROPPED = {"crop_width": 50, "crop_height": 40, "crop_offset_x": 50, "crop_offset_y": 30}


def scene(film: dict[str, Any], **sensor: Any) -> dict[str, Any]:
    mi = activate()
    pose = mi.ScalarTransform4f().look_at([1, -4, 2], [0, 0, 0], [0, 0, 1])
    camera = {"type": "perspective", "fov": 60.0, "to_world": pose, **sensor}
    return {
        "type": "scene",
        "camera": {**camera, "film": {"type": "hdrfilm", "width": 100, "height": 80, **film}},
        "ball": {"type": "sphere"},
    }


@pytest.mark.parametrize("film", [{}, CROPPED], ids=["whole", "cropped"])
@pytest.mark.parametrize(
    "lens", [{}, {"principal_point_offset_x": 0.1, "principal_point_offset_y": -0.2}, {"fov_axis": "y"}]
)
def test_rays_through_the_pixels_are_those_of_mitsuba(film: dict[str, int], lens: dict[str, Any]) -> None:
    mi = activate()
    loaded = build_scene(scene(film, **lens), mi)
    rig = own_rig(loaded, mi)
    origin, directions = pixel_rays(rig, 0)
    y, x = np.mgrid[: rig.height, : rig.width]
    place = mi.Point2f((x.ravel() + 0.5) / rig.width, (y.ravel() + 0.5) / rig.height)
    ray, _ = loaded.scene.sensors()[0].sample_ray(0, 0.5, place, [0.5, 0.5])
    assert np.abs(np.array(ray.d).T - directions).max() < 1e-5
    assert np.allclose(origin, (1, -4, 2), atol=1e-6)


def test_a_crop_shifts_the_principal_point_and_leaves_the_focal_length() -> None:
    mi = activate()
    K = own_rig(build_scene(scene(CROPPED), mi), mi).Ks[0]
    focal = 50 / np.tan(np.radians(30))
    assert np.allclose(K, [[focal, 0, 0], [0, focal, 10], [0, 0, 1]], atol=1e-3)
    twice = own_rig(build_scene(scene(CROPPED), mi), mi, 100, 80).Ks[0]
    assert np.allclose(twice, [[2 * focal, 0, 0], [0, 2 * focal, 20], [0, 0, 1]], atol=1e-3)


def test_cameras_are_fitted_in_the_variant_the_scene_was_loaded_in(tmp_path: Path) -> None:
    small = scene({"width": 6, "height": 5}, fov=40.0)
    small["sky"] = {"type": "constant"}
    fitted = fit_rig(small, 32)
    done = render_set(small, None, tmp_path, spp=2, variant="scalar", plan="rgb")
    assert (done.meta["mitsuba_variant"], len(done)) == ("scalar_rgb", 32)
    assert np.allclose(done.rig.viewmats, fitted.viewmats, atol=1e-5)
    assert plan_transport(small, 0.5, variant="scalar", measure=False).max_depth >= 2
    activate()
