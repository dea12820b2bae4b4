"""Light behaves: scenes whose radiance is known exactly, within five standard errors of the render's own estimate."""

from typing import Any

import numpy as np
import pytest

from simscenes import Optics, Rig
from simscenes.backend import activate, using_variant
from simscenes.loading.load import build_scene
from simscenes.render.geometry import pixel_rays
from simscenes.render.radiance import RenderedView, RenderMethod
from simscenes.render.sequences import Radiance
from simscenes.rigs import intrinsics, look_at

WHITE = {"type": "rgb", "value": 1.0}


def rendered(scene: dict[str, Any], spp: int = 128, size: int = 12, eye: Any = (0, -4, 0.5), **method: Any) -> Radiance:
    kind = method.pop("integrator", "path")
    rig = Rig(viewmats=look_at(eye, (0, 0, 0))[None], Ks=intrinsics(size, size, 40)[None], width=size, height=size)
    with using_variant(color=method.pop("color", "rgb")) as mi:
        loaded = build_scene({"type": "scene", **scene}, mi)
        integrator = mi.load_dict({"type": kind, "max_depth": 64, "rr_depth": 2})
        return RenderedView(RenderMethod(mi, mi.variant(), loaded, integrator, **method), rig, 0).render(spp, None)


def diffuse(albedo: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}


def check_level(result: Radiance, level: float | np.ndarray, floor: float = 2e-6) -> None:
    """The whole image on average, and no 4 x 4 block of pixels, leaves five standard errors."""
    difference = result.mean.astype(np.float64) - level
    variance = result.variance.astype(np.float64)
    assert abs(difference.mean()) <= 5 * np.sqrt(variance.sum()) / variance.size + floor
    blocks = difference.mean(-1).reshape(3, 4, 3, 4).mean((1, 3))
    errors = np.sqrt(variance.mean(-1).reshape(3, 4, 3, 4).mean((1, 3)) / 16)
    # Blocks share few passes, so their error estimates scatter: the largest speaks for all.
    assert (np.abs(blocks) <= 5 * errors.max() + floor).all()


def test_a_convex_body_in_a_furnace_shows_its_albedo() -> None:
    result = rendered(
        {
            "sky": {"type": "constant", "radiance": WHITE},
            "ball": {"type": "sphere", "radius": 9.0, "bsdf": diffuse(0.5)},
        },
        eye=(0, -20, 0),
    )
    check_level(result, 0.5)


def test_white_bodies_vanish_in_a_furnace_however_light_bounces_between_them() -> None:
    balls = {
        f"ball_{k}": {"type": "sphere", "center": [0.9 * k - 0.9, 0, 0], "radius": 0.5, "bsdf": diffuse(1.0)}
        for k in range(3)
    }
    floor = {
        "type": "rectangle",
        "to_world": activate().ScalarTransform4f().translate([0, 0, -0.5]).scale(3),
        "bsdf": diffuse(1.0),
    }
    check_level(rendered({"sky": {"type": "constant", "radiance": WHITE}, **balls, "floor": floor}), 1.0, floor=1e-4)


def test_a_glowing_hollow_sphere_adds_up_its_bounces() -> None:
    """Emission 0.2, albedo 0.8 everywhere: radiance 0.2 (1 + 0.8 + 0.8^2 + ...) = 1 in every direction."""
    shell = {"type": "sphere", "radius": 5.0, "flip_normals": True, "bsdf": diffuse(0.8),
             "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 0.2}}}  # fmt: skip
    check_level(rendered({"shell": shell}), 1.0, floor=1e-5)


def test_a_sphere_light_lights_a_plane_by_the_inverse_square_law() -> None:
    """E = pi L (r/d)^2 cos(a) holds exactly for a sphere above the horizon, so radiance is albedo L (r/d)^2 cos(a)."""
    lamp = {
        "type": "sphere",
        "center": [0, 0, 2.0],
        "radius": 0.5,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 7.0}},
    }
    plane = {"type": "rectangle", "to_world": activate().ScalarTransform4f().scale(50), "bsdf": diffuse(0.6)}
    result = rendered({"lamp": lamp, "plane": plane}, spp=256, eye=(0, -3, 3.5))
    rig = Rig(viewmats=look_at((0, -3, 3.5), (0, 0, 0))[None], Ks=intrinsics(48, 48, 40)[None], width=48, height=48)
    origin, directions = pixel_rays(rig, 0)
    points = origin - directions * (origin[2] / directions[:, 2:])
    d2 = (points**2).sum(1) - 0 + 4 - 4 * points[:, 2]
    exact = (0.6 * 7.0 * 0.25 / d2 * 2.0 / np.sqrt(d2)).reshape(12, 4, 12, 4).mean((1, 3))  # mean over each pixel
    see_lamp = np.zeros((12, 12), dtype=bool)
    b = directions @ (origin - [0, 0, 2.0])
    see_lamp |= (b**2 - ((origin - [0, 0, 2.0]) ** 2).sum() + 0.25 > 0).reshape(12, 4, 12, 4).any((1, 3))
    see_lamp |= np.roll(see_lamp, 1, 0) | np.roll(see_lamp, -1, 0) | np.roll(see_lamp, 1, 1) | np.roll(see_lamp, -1, 1)
    error = np.sqrt(result.variance[~see_lamp].max())
    assert (~see_lamp).sum() > 60
    # 4 x 4 points a pixel leave 1e-3 of curvature in the exact mean.
    assert np.abs(result.mean[..., 0] - exact)[~see_lamp].max() < 5 * error + 1e-3 * exact.max()


@pytest.mark.parametrize(
    "material",
    [
        {"type": "roughplastic", "alpha": 0.1, "diffuse_reflectance": {"type": "rgb", "value": 0.85}},
        {"type": "roughconductor", "material": "Cu", "alpha": 0.2},
        {"type": "dielectric", "int_ior": "bk7", "ext_ior": "air"},
    ],
    ids=["plastic", "metal", "glass"],
)
def test_no_material_gives_back_more_than_it_gets(material: dict[str, Any]) -> None:
    scene = {
        "sky": {"type": "constant", "radiance": WHITE},
        "ball": {"type": "sphere", "radius": 9.0, "bsdf": material},
    }
    result = rendered(scene, eye=(0, -20, 0))
    error = np.sqrt(result.variance.max())
    assert result.mean.max() <= 1 + 5 * error + 1e-5
    if material["type"] == "dielectric":
        check_level(result, 1.0, floor=1e-4)
    else:
        assert result.mean.mean() < 1


def test_white_fog_in_a_furnace_is_invisible() -> None:
    fog = {"type": "homogeneous", "albedo": {"type": "rgb", "value": 1.0}, "sigma_t": 0.7}
    cloud = {"type": "sphere", "radius": 1.0, "bsdf": {"type": "null"}, "interior": fog}
    check_level(
        rendered({"sky": {"type": "constant", "radiance": WHITE}, "cloud": cloud}, integrator="volpath"), 1.0, 1e-4
    )


def test_a_camera_inside_fog_sees_through_it_from_where_it_is() -> None:
    """Absorbing fog: the sky fades by exp(-sigma x way out), which differs if the camera does not know it is inside."""
    fog = {"type": "homogeneous", "albedo": {"type": "rgb", "value": 0.0}, "sigma_t": 0.25}
    cloud = {"type": "sphere", "radius": 5.0, "bsdf": {"type": "null"}, "interior": fog}
    scene = {"sky": {"type": "constant", "radiance": WHITE}, "cloud": cloud}
    result = rendered(scene, eye=(0, -4, 0), integrator="volpath", spp=256)
    rig = Rig(viewmats=look_at((0, -4, 0), (0, 0, 0))[None], Ks=intrinsics(12, 12, 40)[None], width=12, height=12)
    _, directions = pixel_rays(rig, 0)
    b = directions @ np.array([0.0, -4, 0])
    check_level(result, np.exp(-0.25 * (-b + np.sqrt(b**2 - 16 + 25))).reshape(12, 12, 1), floor=1e-3)


def test_camera_rgb_is_the_integral_of_radiance_times_sensitivity() -> None:
    """A grey body in flat light: camera RGB must be albedo x radiance x each curve's integral over green's."""
    from simscenes.camera import camera_color

    flat = {"type": "constant", "radiance": {"type": "uniform", "value": 0.8}}
    ball = {
        "type": "sphere",
        "radius": 9.0,
        "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}},
    }
    camera = camera_color("Nikon 5100 (NPL)")
    result = rendered({"sky": flat, "ball": ball}, eye=(0, -20, 0), color="spectral", optics=Optics(camera=camera.name))
    expected = 0.4 * camera.curves.sum(0) / camera.curves[:, 1].sum()
    error = np.sqrt(result.variance.astype(np.float64).sum((0, 1))) / 144
    # 1e-3: Mitsuba integrates the tabulated curves by the trapezoid rule, the sum above does not halve the ends.
    assert (np.abs(result.mean.mean((0, 1)) - expected) <= 5 * error + 1e-3).all()
