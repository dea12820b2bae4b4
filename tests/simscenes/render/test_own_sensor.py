"""The sensor that comes with a scene: its lens, film and fog become the rig's, whichever way they are written."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import Rig, fit_rig, plan_transport, render_set
from simscenes.backend import activate, using_variant
from simscenes.loading.load import build_scene
from simscenes.optics import Optics
from simscenes.render.framing import own_cameras, own_rig, with_lens
from simscenes.render.geometry import pixel_rays
from simscenes.render.sensors import medium_at
from simscenes.rigs import intrinsics, look_at

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


@pytest.mark.usefixtures("jit")
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


def test_the_aperture_of_a_scenes_own_lens_is_used_unless_another_is_asked_for(tmp_path: Path) -> None:
    mi = activate()
    lens = scene({"width": 24, "height": 20}, type="thinlens", aperture_radius=0.4, focus_distance=2.0)
    lens["sky"] = {"type": "constant"}
    loaded = build_scene(lens, mi)
    for asked in (None, Optics(motion=0.2), Optics(camera="Nikon 5100 (NPL)")):
        found = with_lens(asked, loaded, mi)
        assert (found.aperture_radius, found.focus_distance) == (pytest.approx(0.4), pytest.approx(2.0))
        assert (found.motion, found.camera) == ((asked.motion, asked.camera) if asked else (None, None))
    other = Optics(aperture_radius=0.1, focus_distance=3.0)
    assert with_lens(other, loaded, mi) == other
    assert plan_transport(lens, 0.5, measure=False).is_on("depth of field")
    rig = fit_rig(lens, 1)
    done = render_set(lens, rig, tmp_path / "own", spp=4, plan="rgb")
    sharp = render_set(lens, rig, tmp_path / "pinhole", spp=4, plan="rgb", optics=Optics(aperture_radius=0))
    assert (done.meta["optics"]["aperture_radius"], sharp.meta["optics"]["aperture_radius"]) == (
        pytest.approx(0.4),
        None,
    )
    assert not np.array_equal(done.radiance(0), sharp.radiance(0))


def in_fog(box: bool) -> dict[str, Any]:
    """A sensor in fog: within a box of it from y = -5 to -3, or in fog without end."""
    mi = activate()
    fog = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.5, "id": "fog"}
    foggy = scene({"width": 6, "height": 5}, medium={"type": "ref", "id": "fog"})
    place = mi.ScalarTransform4f().translate([1, -4, 2])
    walls = {"type": "cube", "to_world": place, "bsdf": {"type": "null"}, "interior": {"type": "ref", "id": "fog"}}
    lit = {"type": "scene", "fog": fog, **{k: v for k, v in foggy.items() if k != "type"}, "sky": {"type": "constant"}}
    return {**lit, "walls": walls} if box else lit


@pytest.mark.parametrize("variant", ["auto", "scalar"])
def test_fog_around_the_own_sensor_is_around_all_cameras_that_no_border_parts_from_it(variant: str) -> None:
    described = [in_fog(box) for box in (False, True)]
    with using_variant(variant) as mi:
        endless, box = (build_scene(d, mi) for d in described)
        for position in ([1, -4, 2], [3, 3, 3]):
            assert medium_at(mi, endless, np.array(position, float)) is not None
        assert medium_at(mi, box, np.array([1.2, -4.1, 2.3])) is not None
        for position in ([1, -4, 5], [4, -4, 2], [1, 0, 9]):
            assert medium_at(mi, box, np.array(position, float)) is None


def test_fog_that_only_the_sensor_knows_of_is_planned_for() -> None:
    rig = Rig(viewmats=look_at((1, -4, 2), (0, 0, 0))[None], Ks=intrinsics(8, 8, 60)[None], width=8, height=8)
    assert plan_transport(in_fog(box=False), 0.1, rig=rig, measure=False).is_on("participating media")


def test_cameras_of_a_scene_with_two_lenses_need_one_for_all() -> None:
    mi = activate()
    both = scene({"width": 12, "height": 10}, id="a")
    pose = mi.ScalarTransform4f().look_at([2, -3, 2], [0, 0, 0], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 12, "height": 10}
    wide = {"type": "thinlens", "fov": 50.0, "to_world": pose, "film": film, "aperture_radius": 0.25}
    both |= {"second": {**wide, "focus_distance": 2.0}, "third": {**wide, "focus_distance": 3.0}}
    with pytest.raises(ValueError, match="0 has a pinhole, sensor 1 an aperture radius of 0.25, focused at 2"):
        own_cameras(both)
    assert len(own_cameras(both, own_lenses=False)) == 3
    both.pop("camera")
    with pytest.raises(ValueError, match="0 has .* of 0.25, focused at 2, sensor 1 an aperture .* 0.25, focused at 3"):
        own_cameras(both)
    both.pop("third")
    assert len(own_cameras(both)) == 1


def test_cameras_of_a_scene_with_films_of_two_sizes_need_one_for_all() -> None:
    mi = activate()
    pose = mi.ScalarTransform4f().look_at([2, -3, 2], [0, 0, 0], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 12, "height": 8}
    both = scene({}) | {"second": {"type": "perspective", "fov": 50.0, "to_world": pose, "film": film}}
    with pytest.raises(ValueError, match=r"has sensors of 2 sizes, \(12, 8\) to \(100, 80\): one set has pictures"):
        own_cameras(both)
