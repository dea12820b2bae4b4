"""Spectra of light and surfaces, and light by two mirrors in a row, against sums and rays written out."""

from typing import Any

import numpy as np
import pytest

from simscenes import Rig
from simscenes.backend import activate, using_variant
from simscenes.camera import camera_color, daylight, srgb_curves
from simscenes.loading.load import build_scene
from simscenes.rigs import intrinsics, look_at
from simscenes.transport import spectra
from simscenes.transport.lengths import light_by_length
from simscenes.transport.spectra import WAVELENGTHS, color_error, light_and_surface

NIKON = "Nikon 5100 (NPL)"


@pytest.mark.parametrize("camera", [None, NIKON])
@pytest.mark.parametrize("bounces", [1, 2, 3])
def test_color_error_is_that_of_sums_over_wavelengths(camera: str | None, bounces: int) -> None:
    """Saturated surfaces leave the range of RGB, saturated light gives the camera less than nothing: both are cut."""
    assert np.array_equal(WAVELENGTHS, np.arange(380, 781, 10))
    rng = np.random.default_rng(0)
    bumps = [np.exp(-(((WAVELENGTHS - at) / 25) ** 2)) for at in (420, 500, 520, 610, 700)]
    lights = np.stack([bump + 0.01 for bump in bumps])
    surfaces = np.stack([0.95 * bump + 0.01 for bump in bumps[::-1]]) * rng.uniform(0.8, 1, (5, 1))
    srgb, white = srgb_curves()[::2], daylight()[::2]
    filters = srgb if camera is None else camera_color(camera).curves[::2]
    unit = 1.0 if camera is None else sum(camera_color(camera).curves[:, 1])
    wrong = total = 0.0
    outside = 0
    for light, surface in zip(lights, surfaces, strict=True):
        rgb = []
        for c in range(3):
            lit = sum(light[k] * srgb[k][c] for k in range(41))
            reflected = sum(surface[k] * white[k] * srgb[k][c] for k in range(41))
            reflected /= sum(white[k] * srgb[k][c] for k in range(41))
            outside += (lit < 0) + (reflected < 0) + (reflected > 1)
            rgb.append(max(lit, 0) * min(max(reflected, 0), 1) ** bounces)
        if camera is not None:
            seen = [sum(camera_color(camera).matrix[c][d] * rgb[d] for d in range(3)) for c in range(3)]
            outside += min(seen) < 0
            rgb = [max(value, 0) for value in seen]
        for c in range(3):
            exact = sum(light[k] * surface[k] ** bounces * filters[k][c] for k in range(41)) / unit
            wrong, total = wrong + abs(rgb[c] - exact), total + abs(exact)
    assert outside > 5
    assert color_error(lights, surfaces, camera, bounces) == pytest.approx(wrong / total)
    assert color_error(lights[:0], surfaces[:0], camera, bounces) == 0
    if bounces == 1:
        assert color_error(lights, surfaces, camera) == pytest.approx(wrong / total)


@pytest.mark.usefixtures("jit")
def test_spectra_of_light_and_surface_are_those_of_the_points_seen() -> None:
    """A lamp above a floor: intensity times cosine over squared distance, pixel by pixel; the sky counts for none."""
    steps = {"type": "spectrum", "value": [(380.0, 1.0), (580.0, 5.0), (780.0, 3.0)]}
    paint = {"type": "spectrum", "value": [(380.0, 0.2), (780.0, 0.8)]}
    floor = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": paint}}
    lamp = {"type": "point", "position": [0.2, 0.1, 1.5], "intensity": steps}
    poses = np.stack([look_at((0, -1, 2), (0, 0, 0)), look_at((0, 0, 1), (0, 1, 3)), look_at((0, -1, 2), (0.9, 0, 0))])
    rig = Rig(viewmats=poses, Ks=np.repeat(intrinsics(3, 2, 40)[None], 3, 0), width=3, height=2)
    with using_variant(color="spectral") as mi:
        loaded = build_scene({"type": "scene", "floor": floor, "lamp": lamp}, mi)
        light, surface = light_and_surface(mi, loaded, rig, 0)
    irradiances = []
    for pose in (poses[0], poses[2]):
        c2w = np.linalg.inv(pose)
        for y in range(2):
            for x in range(3):
                ray = c2w[:3, :3] @ np.linalg.solve(rig.Ks[0], [x + 0.5, y + 0.5, 1])
                point = c2w[:3, 3] - c2w[2, 3] / ray[2] * ray
                away = np.array([0.2, 0.1, 1.5]) - point
                if np.abs(point[:2]).max() < 1:
                    irradiances.append(away[2] / np.linalg.norm(away) ** 3)
    assert 6 < len(irradiances) < 12
    wanted = np.interp(WAVELENGTHS, [380, 580, 780], [1, 5, 3])
    assert light.shape == surface.shape == (len(irradiances), 41)
    assert np.allclose(light, np.outer(irradiances, wanted), rtol=1e-4)
    assert np.allclose(surface, np.interp(WAVELENGTHS, [380, 780], [0.2, 0.8]), rtol=1e-4)


@pytest.mark.usefixtures("jit")
def test_light_by_two_mirrors_is_averaged_over_pixels_and_views() -> None:
    """A mirrored corner shows a sky of 1 by two reflections in half of one view in four."""
    mi = activate()
    t, mirror = mi.ScalarTransform4f(), {"type": "conductor", "material": "none"}
    floor = {"type": "rectangle", "to_world": t.translate([-50, 0, 0]).scale(50), "bsdf": mirror}
    wall = {"type": "rectangle", "to_world": t.translate([0, 5, 0]).rotate([1, 0, 0], 90).scale(50), "bsdf": mirror}
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    loaded = build_scene({"type": "scene", "floor": floor, "wall": wall, "sky": sky}, mi)
    up = look_at((0, 0, 3), (0, -1, 9))
    poses = np.stack([up, up, up, look_at((0, 0, 3), (0, 1.5, 0))])
    rig = Rig(viewmats=poses, Ks=np.repeat(intrinsics(8, 8, 10)[None], 4, 0), width=8, height=8)
    assert light_by_length(mi, loaded, rig, 8, 9, 16, 0).chained == pytest.approx(1 / 8, rel=1e-5)


@pytest.mark.usefixtures("jit")
def test_the_light_of_a_lamp_is_averaged_over_its_whole_face() -> None:
    """A square lamp of radiance 1 at a height h above the floor: the integral of h^2 / r^4 over its face, over pi."""
    h = 0.5
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 401)[1::2]])
    expected = 4 * (h**2 / (x**2 + y**2 + h**2) ** 2).mean()
    pose, K = look_at((0.1, -0.1, 0.2), (0, 0, 0)), intrinsics(16, 16, 1)
    glow = {"type": "area", "radiance": {"type": "spectrum", "value": 1.0}}
    with using_variant(color="spectral") as mi:
        face = mi.ScalarTransform4f().translate([0, 0, h]).rotate([1, 0, 0], 180)
        lamp = {"type": "rectangle", "to_world": face, "emitter": glow}
        floor = {"type": "rectangle", "bsdf": {"type": "diffuse"}}
        loaded = build_scene({"type": "scene", "floor": floor, "lamp": lamp}, mi)

        def light(views: int, seed: int) -> np.ndarray:
            rig = Rig(viewmats=np.repeat(pose[None], views, 0), Ks=np.repeat(K[None], views, 0), width=16, height=16)
            return light_and_surface(mi, loaded, rig, seed)[0]

        first, other, two = light(1, 0), light(1, 1), light(2, 0)
    for found in (first, other, two):
        assert found.mean(0) == pytest.approx(np.full(41, expected), rel=0.05)
    assert np.array_equal(two[:256], first)
    for found in (other, two[256:]):  # every seed and every view picks points of its own
        assert not np.allclose(found, first, rtol=0.01)


@pytest.mark.usefixtures("jit")
def test_every_seed_and_every_view_follows_mirrored_paths_of_its_own() -> None:
    mi = activate()
    rough = {"type": "roughconductor", "alpha": 0.4}
    wall = mi.ScalarTransform4f().translate([0, 1, 0]).rotate([1, 0, 0], 90).scale(5)
    scene = {"type": "scene", "floor": {"type": "rectangle", "bsdf": rough}, "sky": {"type": "constant"},
             "wall": {"type": "rectangle", "to_world": wall, "bsdf": rough}}  # fmt: skip
    loaded, K = build_scene(scene, mi), intrinsics(8, 8, 10)
    poses = np.stack([look_at((0, -1, 2), (0, 0.5, 0)), look_at((0.01, -1, 2), (0.01, 0.5, 0))])

    def light(views: int, seed: int) -> float:
        rig = Rig(viewmats=poses[:views], Ks=np.repeat(K[None], views, 0), width=8, height=8)
        return light_by_length(mi, loaded, rig, 5, 9, 16, seed).chained

    assert light(1, 0) == pytest.approx(light(1, 0), rel=1e-12)
    found = [light(1, 0), light(1, 1), light(2, 0)]
    assert min(abs(a - b) for a, b in zip(found, found[1:] + found[:1], strict=True)) > 1e-6
    assert found == pytest.approx([found[0]] * 3, rel=0.2)


def test_measured_spectra_are_found_wherever_they_are() -> None:
    """What is behind a mask is found too; a metal's indices do not count."""
    pairs = {"type": "spectrum", "value": [(400, 0.1), (550, 0.2), (600, 0.9), (700, 0.9)]}
    cloud = {"type": "homogeneous", "sigma_t": pairs, "albedo": 0.5}
    cases: list[tuple[dict[str, Any], list[str], bool]] = [
        ({"bsdf": {"type": "diffuse", "reflectance": pairs}}, [], True),
        ({"bsdf": {"type": "plastic", "diffuse_reflectance": pairs}}, [], True),
        ({"bsdf": {"type": "conductor", "material": "Au"}}, [], False),
        ({"bsdf": {"type": "mask", "b": {"type": "dielectric", "specular_transmittance": pairs}}},
         ["specular_transmittance"], True),
        ({"bsdf": {"type": "principled", "base_color": pairs}}, ["base_color"], True),
        ({"bsdf": {"type": "null"}, "interior": cloud}, ["medium"], True),
        ({"bsdf": {"type": "plastic"}}, [], False),
    ]  # fmt: skip
    with using_variant("scalar", "spectral") as mi:
        for parts, elsewhere, measured in cases:
            scene = {"type": "scene", "ball": {"type": "sphere", **parts}, "sky": {"type": "constant"}}
            loaded = build_scene(scene, mi)
            assert spectra.measured_elsewhere(mi, loaded) == elsewhere
            assert spectra.has_measured(mi, loaded) == measured
        loaded = build_scene({"type": "scene", "ball": {"type": "sphere"}, "sky": {"type": "sunsky"}}, mi)
        assert spectra.measured_elsewhere(mi, loaded) == ["sunlight and sky"]
