"""Hard cases of the renderer: very many samples, very dim and bright lamps, grazing angles, tiny gaps, a lamp in view.

References: scenes whose light is known in closed form. Mitsuba renders in float32 and takes its own threads.
"""

import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from simscenes.backend import using_variant
from simscenes.loading.load import build_scene
from simscenes.render import radiance
from simscenes.render.geometry import geometry_channels, pixel_rays
from simscenes.render.radiance import RenderedView, RenderMethod
from simscenes.render.sequences import Radiance
from simscenes.rigs import Rig, intrinsics, look_at
from simscenes.sets.pictures.exr import read_exr, write_exr
from tests.stability.case import EPS, Case, Error, Fails, Part, Setting, worse

PART = Part("render")
HERE = sys.modules[__name__]  # where the cases find what a test replaces
BOTH = ("llvm_ad_rgb", "scalar_rgb")
SIZE = 4  # px


def grey(value: float) -> dict[str, Any]:
    """The same in all three channels."""
    return {"type": "rgb", "value": value}


def floor(mi: Any, size: float, albedo: float, height: float = 0.0) -> dict[str, Any]:
    """A matt square that looks up."""
    place = mi.ScalarTransform4f().translate([0, 0, height]).scale(size)
    return {"type": "rectangle", "to_world": place, "bsdf": {"type": "diffuse", "reflectance": grey(albedo)}}


def camera(eye: Any, at: Any, fov: float = 20.0) -> Rig:
    """One small camera."""
    up = look_at(eye, at, (0.0, 1.0, 0.0) if eye[0] == at[0] and eye[1] == at[1] else (0.0, 0.0, 1.0))
    return Rig(viewmats=up[None], Ks=intrinsics(SIZE, SIZE, fov)[None], width=SIZE, height=SIZE)


def rendered(make: Any, rig: Rig, setting: Setting, spp: int = 64, depth: int = 64) -> Radiance:
    """One view of the scene that `make` describes for the mitsuba module, which only simscenes may import."""
    with using_variant(setting.backend) as mi:
        loaded = build_scene({"type": "scene", **make(mi)}, mi)
        integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 64})
        return RenderedView(RenderMethod(mi, mi.variant(), loaded, integrator), rig, 0).render(spp, None)


def _relative(found: NDArray, wanted: Any) -> float:
    black = np.broadcast_to(np.asarray(wanted) == 0, found.shape)  # where nothing is to be seen, nothing is
    return float(np.abs(np.where(black, found, found.astype(np.float64) / np.where(black, 1, wanted) - 1)).max())


# Samples are added up in float64: what is left is the rounding of one sample, and of the mean.
@PART.case("a million samples in a pixel", bound=4 * EPS, unit="relative", backends=("llvm_ad_rgb",), slow=True)
def _(setting: Setting) -> float:
    def scene(mi: Any) -> dict[str, Any]:
        far = {"type": "sphere", "center": [0, 0, -1e3], "radius": 100.0}  # out of view; a small one would be refused
        return {"sky": {"type": "constant", "radiance": grey(1 / 3)}, "far": far}

    return _relative(rendered(scene, camera((0, 0, 0), (0, 1, 0)), setting, spp=10**6).mean, 1 / 3)


# Every bounce rounds a few times, and 64 samples are added up.
@PART.case("lamps of radiance 1e-8 to 1e8, stored and read", bound=100 * EPS, unit="relative", backends=BOTH)
def _(setting: Setting) -> float:
    def scene(level: float) -> Any:
        lamp = {"type": "sphere", "center": [0, 0, 2], "radius": 0.5,
                "emitter": {"type": "area", "radiance": grey(level)}}  # fmt: skip
        return lambda mi: {
            "lamp": lamp, "floor": floor(mi, 3, 0.6),
            "ball": {"type": "sphere", "center": [0.2, 0, 0.3], "radius": 0.3},
        }  # fmt: skip

    rig, worst = camera((0, -4, 1.5), (0, 0, 0.3), 30), 0.0
    one = rendered(scene(1.0), rig, setting)
    for level in (1e-8, 1e-3, 1e3, 1e8):
        other = _stored(rendered(scene(level), rig, setting))
        worst = worse(worst, _relative(other.mean, one.mean.astype(np.float64) * level))
        wanted = one.variance.astype(np.float64) * level**2
        worst = worse(worst, float(np.abs(other.variance - wanted).max() / wanted.max()))
        worst += other.fireflies != one.fireflies
    return worst


def _stored(light: Radiance) -> Radiance:
    """What a file gives back of it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "light.exr"
        kinds = ("mean", "variance", "half")
        planes = {f"{kind}.{c}": getattr(light, kind)[..., c] for kind in kinds for c in range(3)}
        write_exr(path, planes)
        found, _ = read_exr(path)
    stacked = {kind: np.stack([found[f"{kind}.{c}"] for c in range(3)], -1) for kind in kinds}
    return Radiance(**stacked, spp=light.spp, error=light.error, fireflies=light.fireflies)


@PART.case("light that grazes a floor at 0.1 to 1e-5 rad", bound=8 * EPS, unit="relative", backends=BOTH)
def _(setting: Setting) -> float:
    worst = 0.0
    for angle in (0.1, 1e-3, 1e-5):

        def scene(mi: Any, angle: float = angle) -> dict[str, Any]:
            sun = {"type": "directional", "direction": [math.cos(angle), 0, -math.sin(angle)], "irradiance": grey(1.0)}
            return {"sun": sun, "floor": floor(mi, 1, 0.5)}

        found = rendered(scene, camera((0, 0, 3), (0, 0, 0)), setting, spp=4).mean
        worst = worse(worst, _relative(found, 0.5 / math.pi * math.sin(angle)))
    return worst


@PART.case("depth of a floor seen at 0.1 to 1e-4 rad", bound=8 * EPS, unit="relative", backends=BOTH)
def _(setting: Setting) -> float:
    worst = 0.0
    for angle in (0.1, 1e-2, 1e-3, 1e-4):
        rig = camera((-0.5, 0, angle * 0.5), (0, 0, 0), fov=angle)  # degrees: all rays hit the floor
        with using_variant(setting.backend) as mi:
            loaded = build_scene({"type": "scene", "floor": floor(mi, 1, 0.5)}, mi)
            found = geometry_channels(mi, loaded, rig, 0)["distance"].ravel()
        origin, directions = pixel_rays(rig, 0)
        worst = worse(worst, _relative(found, -origin[2] / directions[:, 2]))
    return worst


def gap(height: float, setting: Setting) -> float:
    """Relative error of the light that a lamp throws on a floor of side 2, so far beneath it, seen from in between."""

    def scene(mi: Any) -> dict[str, Any]:
        down = mi.ScalarTransform4f().translate([0, 0, height]).rotate([1, 0, 0], 180)
        plate = {"type": "rectangle", "to_world": down, "bsdf": {"type": "diffuse", "reflectance": grey(0.0)},
                 "emitter": {"type": "area", "radiance": grey(2.0)}}  # fmt: skip
        return {"plate": plate, "floor": floor(mi, 1, 0.5)}

    rig = camera((-0.5, 0, height / 2), (0, 0, 0), fov=math.degrees(height / 4))
    light = rendered(scene, rig, setting, spp=1024, depth=2)
    # Between endless plates every point of the floor sees nothing but the lamp: albedo times its radiance.
    return abs(float(light.mean.astype(np.float64).mean()) - 1.0)


# Mitsuba starts a ray 9e-5 (1 + |x|) off its surface: smaller gaps are not there for it, and that is stated.
# The floor's edges are 0.5 away or more: the lamp covers all of its sky but (gap / 0.5)**2 = 4e-4. The rest is noise.
@PART.case("gaps of 1e-2 to 1.5e-4 of the scene between a lamp and a floor", bound=1e-3, unit="relative",
           backends=("llvm_ad_rgb",))  # fmt: skip
def _(setting: Setting) -> float:
    return worse(*(gap(height, setting) for height in (1e-2, 1e-3, 1.5e-4)))


@PART.case("a lamp of radiance 1e6 in view: its own pixels alone", bound=0, unit="of the lamp", backends=BOTH)
def _(setting: Setting) -> float:
    def scene(mi: Any) -> dict[str, Any]:
        # A square that covers the middle 2 x 2 of 4 x 4 pixels exactly would leave the border to rounding.
        side = 0.5 * 0.99
        lamp = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(side),
                "emitter": {"type": "area", "radiance": grey(1e6)}}  # fmt: skip
        return {"lamp": lamp, "dark": floor(mi, 9, 0.0, height=-5)}

    rig = camera((0, 0, 1), (0, 0, 0), fov=90)
    found = rendered(scene, rig, setting, spp=1024).mean
    outside = found.copy()
    outside[1:3, 1:3] = 0
    # A pixel of the middle is covered by 0.99**2, a share that 1024 stratified samples hit to 1 / 1024.
    covered = float(np.abs(found[1:3, 1:3] / 1e6 / 0.99**2 - 1).max())
    return float(outside.max()) / 1e6 + max(covered - 2e-3, 0.0)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_files_of_half_precision_lose_lamps(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = read_exr

    def halved(path: Any) -> Any:
        channels, header = whole(path)
        with np.errstate(over="ignore"):
            return {name: plane.astype(np.float16).astype(np.float32) for name, plane in channels.items()}, header

    monkeypatch.setattr(HERE, "read_exr", halved)
    with np.errstate(invalid="ignore"):
        assert fails("lamps of radiance", "scalar_rgb")


def test_a_filter_wider_than_a_pixel_carries_a_lamp_into_its_neighbours(
    fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = radiance.sensor_dict

    def blurred(*given: Any) -> dict[str, Any]:
        found = whole(*given)
        return {**found, "film": {**found["film"], "rfilter": {"type": "gaussian"}}}

    assert not fails("a lamp of radiance 1e6", "scalar_rgb")
    monkeypatch.setattr(radiance, "sensor_dict", blurred)
    assert fails("a lamp of radiance 1e6", "scalar_rgb")


def test_a_depth_that_starts_at_the_near_plane_is_too_short(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = geometry_channels

    def from_near_plane(mi: Any, loaded: Any, rig: Any, i: int) -> Any:
        found = whole(mi, loaded, rig, i)
        return {**found, "distance": found["distance"] - 1e-4 * loaded.extent}

    monkeypatch.setattr(HERE, "geometry_channels", from_near_plane)
    assert fails("depth of a floor", "scalar_rgb")


def test_a_ray_that_starts_a_thousandth_off_its_surface_misses_the_light_of_a_gap(jit: None) -> None:
    """The page on stability states where Mitsuba's own offset, 9e-5 of a scene of size 1, ends what is seen."""
    here = Setting("llvm_ad_rgb")
    assert gap(1.5e-4, here) < 1e-3
    assert gap(5e-5, here) > 0.99
