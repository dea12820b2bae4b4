"""Rendered geometry against analytic surfaces."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from simscenes import Rig
from simscenes.backend import using_variant
from simscenes.loading.load import build_scene
from simscenes.render.geometry import check_cameras, geometry_channels
from simscenes.render.sensors import sensor_dict

Scene = Callable[[], dict[str, Any]]
Camera = Callable[..., Rig]


def analytic(rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distance, z-depth, normal and id (1 plane, 2 ball) of every pixel centre, in float64, from first principles."""
    x, y = np.meshgrid(np.arange(rig.width) + 0.5, np.arange(rig.height) + 0.5)
    directions = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(rig.Ks[0]).T
    c2w = np.linalg.inv(rig.viewmats[0])
    d = directions @ c2w[:3, :3].T
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    o = c2w[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        t_plane = -o[2] / d[..., 2]
        p = o + t_plane[..., None] * d
        t_plane = np.where((t_plane > 0) & (np.abs(p[..., :2]) <= 3).all(-1), t_plane, np.inf)
        b = d @ (o - [0, 0, 1])
        root = b**2 - (np.sum((o - [0, 0, 1]) ** 2) - 1)
        t_ball = np.where(root > 0, -b - np.sqrt(root), np.inf)
    t = np.minimum(t_plane, t_ball)
    ball = t_ball < t_plane
    normal = np.where(ball[..., None], o + np.where(np.isfinite(t), t, 0)[..., None] * d - [0, 0, 1], [0, 0, 1])
    z = t * (d @ c2w[:3, 2])
    return t, z, normal, np.where(np.isfinite(t), np.where(ball, 2, 1), 0)


def check_geometry(variant: str, scene: dict[str, Any], rig: Rig) -> None:
    with using_variant(variant) as mi:
        loaded = build_scene(scene, mi)
        assert variant in ("auto", loaded.variant.removesuffix("_rgb"))
        channels = geometry_channels(mi, loaded, rig, 0)
    t, z, normal, number = analytic(rig)
    names = np.array(["", *loaded.shapes])
    assert np.array_equal(names[channels["id"]], np.array(["", "plane", "ball"])[number])
    seen = number > 0
    assert 0.2 < seen.mean() < 1
    assert np.isinf(channels["Z"][~seen]).all()
    assert np.isinf(channels["distance"][~seen]).all()
    assert np.abs(channels["distance"][seen] / t[seen] - 1).max() < 1e-5
    assert np.abs(channels["Z"][seen] / z[seen] - 1).max() < 1e-5
    for name in ("N", "Ng"):
        found = np.stack([channels[f"{name}.{c}"] for c in "XYZ"], -1)
        assert np.abs(found[seen] - normal[seen]).max() < 2e-5
        assert not found[~seen].any()
    albedo = np.stack([channels[f"albedo.{c}"] for c in "RGB"], -1)
    assert np.allclose(albedo[seen], [0.6, 0.4, 0.2], atol=1e-6)
    assert len(np.unique(channels["material"][seen])) == 1


def test_geometry_equals_the_analytic_surfaces(ball_on_plane: Scene, view: Camera) -> None:
    check_geometry("auto", ball_on_plane(), view())


def test_geometry_is_the_same_in_a_scalar_variant(ball_on_plane: Scene, view: Camera) -> None:
    check_geometry("scalar", ball_on_plane(), view(21, 16))


def card_over_floor(mi: Any, card: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A green floor without end, and 1 above it a card; the sky is grey."""
    paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.9, 0.1]}}
    wide, above = mi.ScalarTransform4f().scale(9), mi.ScalarTransform4f().translate([0, 0, 1])
    floor = {"type": "rectangle", "to_world": wide, "bsdf": paint}
    card = {"type": "rectangle", "to_world": above, **card}
    return {"type": "scene", "floor": floor, "card": card, "sky": {"type": "constant"}, **more}


def from_above(size: int = 8) -> Rig:
    """3 above the floor, looking down; the edges of the card lie on those of the picture."""
    down = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 3], [0, 0, 0, 1]])
    K = np.array([[float(size), 0, size / 2], [0, float(size), size / 2], [0, 0, 1]])
    return Rig(viewmats=down[None], Ks=K[None], width=size, height=size)


RED = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.9, 0.1, 0.1]}}
NO_LIGHT = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}


@pytest.mark.parametrize("kind", ["mask", "blendbsdf"])
@pytest.mark.parametrize(("backend", "color"), [("auto", "rgb"), ("scalar", "rgb"), ("auto", "spectral_polarized")])
def test_geometry_sees_through_the_holes_of_a_cut_out_leaf(backend: str, color: str, kind: str) -> None:
    with using_variant(backend, color) as mi:
        cells = {"type": "checkerboard", "color0": 0.0, "color1": 1.0}
        leaf: dict[str, Any] = {"type": "mask", "opacity": cells, "nested": {"type": "twosided", "nested": RED}}
        if kind == "blendbsdf":
            leaf = {"type": "blendbsdf", "weight": cells, "nothing": {"type": "null"}, "something": RED}
        loaded = build_scene(card_over_floor(mi, {"bsdf": leaf}), mi)
        rig = from_above()
        sensor = mi.load_dict(sensor_dict(mi, rig, 0, loaded))
        picture = mi.render(loaded.scene, sensor=sensor, integrator=mi.load_dict({"type": "path"}), spp=16)
        channels = geometry_channels(mi, loaded, rig, 0)
    red, green = np.array(picture)[..., 0], np.array(picture)[..., 1]
    shown = np.where(red > green, 1 + loaded.shapes.index("card"), 1 + loaded.shapes.index("floor"))
    assert 0.2 < (shown == 1).mean() < 0.8
    assert np.array_equal(channels["id"], shown)
    assert np.allclose(channels["Z"], np.where(red > green, 2.0, 3.0), rtol=1e-6)
    assert np.array_equal(channels["albedo.R"] > channels["albedo.G"], red > green)


@pytest.mark.parametrize("backend", ["auto", "scalar"])
@pytest.mark.parametrize("opacity", [0.45, 0.55])
def test_a_veil_is_a_surface_from_half_its_opacity_on(backend: str, opacity: float) -> None:
    with using_variant(backend) as mi:
        loaded = build_scene(card_over_floor(mi, {"bsdf": {"type": "mask", "opacity": opacity, "nested": RED}}), mi)
        channels = geometry_channels(mi, loaded, from_above(), 0)
    assert np.allclose(channels["Z"], 2.0 if opacity > 0.5 else 3.0)


@pytest.mark.parametrize("order", [("card", "floor"), ("floor", "card")])
def test_a_hole_is_one_wherever_its_shape_stands_in_the_scene(order: tuple[str, str]) -> None:
    with using_variant("auto") as mi:
        veil = {"type": "mask", "opacity": 0.45, "nested": RED}
        shapes = card_over_floor(mi, {"bsdf": veil})
        loaded = build_scene({"type": "scene", **{name: shapes[name] for name in order}}, mi)
        assert loaded.shapes == order
        channels = geometry_channels(mi, loaded, from_above(), 0)
    assert np.allclose(channels["Z"], 3.0)


@pytest.mark.parametrize("backend", ["auto", "scalar"])
def test_a_sheet_of_glass_is_a_surface(backend: str) -> None:
    with using_variant(backend) as mi:
        loaded = build_scene(card_over_floor(mi, {"bsdf": {"type": "thindielectric"}}), mi)
        channels = geometry_channels(mi, loaded, from_above(), 0)
    assert np.allclose(channels["Z"], 2.0)


@pytest.mark.parametrize("backend", ["auto", "scalar"])
@pytest.mark.parametrize("hidden", [True, False])
def test_geometry_sees_through_lamps_that_the_integrator_hides(backend: str, hidden: bool) -> None:
    with using_variant(backend) as mi:
        lamp = {"bsdf": NO_LIGHT, "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5.0}}}
        own = {"type": "path", "hide_emitters": hidden}
        loaded = build_scene(card_over_floor(mi, lamp, integrator=own), mi)
        rig = from_above()
        picture = mi.render(
            loaded.scene, sensor=mi.load_dict(sensor_dict(mi, rig, 0, loaded)), integrator=mi.load_dict(own), spp=16
        )
        channels = geometry_channels(mi, loaded, rig, 0)
    lamp_seen = np.array(picture)[..., 0] > 4
    assert lamp_seen.all() == lamp_seen.any() == (not hidden)
    assert np.allclose(channels["Z"], 3.0 if hidden else 2.0)
    assert (channels["id"] == 1 + loaded.shapes.index("floor" if hidden else "card")).all()


@pytest.mark.parametrize(("which", "is_refused"), [("first", True), ("second", True), ("clear", False)])
def test_a_camera_inside_any_opaque_object_is_refused_by_its_name(which: str, is_refused: bool, view: Camera) -> None:
    """Two opaque balls and one of glass, one of them around the camera."""
    rig, materials = view(8, 6), {"first": "diffuse", "second": "plastic", "clear": "dielectric"}
    balls = {}
    for i, (name, material) in enumerate(materials.items()):
        centre = rig.positions[0] + (0 if name == which else 100 + 10 * i)
        balls[name] = {"type": "sphere", "center": centre.tolist(), "radius": 2.0, "bsdf": {"type": material}}
    with using_variant("scalar") as mi:
        loaded = build_scene({"type": "scene", **balls}, mi)
        if is_refused:
            with pytest.raises(ValueError, match=f"view 0 at .* sees the inside of '{which}', which is one-sided"):
                check_cameras(mi, loaded, rig)
        else:
            check_cameras(mi, loaded, rig)
