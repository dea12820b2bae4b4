"""Light by the length of its path is what Mitsuba's own path tracer finds, path by path."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from simscenes import Rig, default_rig
from simscenes.backend import activate
from simscenes.loading.load import LoadedScene, build_scene
from simscenes.render.radiance import view_seed
from simscenes.render.sensors import sensor_dict
from simscenes.render.wavefront import sample_sums
from simscenes.rigs import intrinsics, look_at
from simscenes.transport import lengths
from simscenes.transport.lengths import light_by_length
from simscenes.transport.pilot import pilot_rig

pytestmark = pytest.mark.usefixtures("jit")
SPP = 16


def one_view(
    eye: tuple[float, float, float], target: tuple[float, float, float], size: int = 12, fov: float = 50
) -> Rig:
    return Rig(viewmats=look_at(eye, target)[None], Ks=intrinsics(size, size, fov)[None], width=size, height=size)


def hard_scene(mi: Any) -> dict[str, Any]:
    """Glass, rough metal, a masked sheet, an empty boundary, a sky, a spot and a lamp that paths run into."""
    t = mi.ScalarTransform4f()
    mask = {"type": "mask", "opacity": 0.4, "b": {"type": "diffuse"}}
    return {
        "type": "scene", "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}},
        "spot": {"type": "spot", "to_world": t.look_at([2, -2, 3], [0, 0, 0], [0, 0, 1]), "intensity": 20.0},
        "lamp": {"type": "sphere", "center": [-1.2, 0, 1.5], "radius": 0.4,
                 "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [8, 6, 4]}}},
        "floor": {"type": "rectangle", "to_world": t.scale(4),
                  "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.5, 0.3]}}},
        "glass": {"type": "sphere", "center": [0, 0, 0.6], "radius": 0.5, "bsdf": {"type": "dielectric"}},
        "metal": {"type": "sphere", "center": [1, 0.2, 0.5], "radius": 0.4,
                  "bsdf": {"type": "roughconductor", "alpha": 0.2}},
        "sheet": {"type": "rectangle", "to_world": t.translate([0, 1, 1]).rotate([1, 0, 0], 90), "bsdf": mask},
        "border": {"type": "sphere", "center": [-0.8, -0.6, 0.4], "radius": 0.3, "bsdf": {"type": "null"}},
    }  # fmt: skip


def traced(mi: Any, loaded: LoadedScene, rig: Rig, i: int, integrator: dict[str, Any], seed: int) -> NDArray[Any]:
    """The same samples by Mitsuba's integrator, [2,h,w,3]."""
    pixels = rig.width * rig.height
    sensor = mi.load_dict(sensor_dict(mi, rig, i, loaded))
    first, more = np.zeros(pixels, np.int64), np.full(pixels, SPP // 2)
    numbers = [view_seed(rig, i, seed, half) for half in range(2)]
    parts = sample_sums(mi, loaded.scene, sensor, mi.load_dict(integrator), first, more, numbers)
    light = np.concatenate([sums for _, sums in parts], axis=1) / (SPP // 2)
    return np.asarray(light.reshape(2, rig.height, rig.width, 3))


@pytest.mark.parametrize("sky", [True, False])
@pytest.mark.parametrize("rr_depth", [1, 2, 5, 99])
def test_every_cut_is_the_picture_of_the_path_tracer(rr_depth: int, sky: bool) -> None:
    """Pixel by pixel, from the same random numbers, so that a path that ran differently anywhere would show."""
    mi = activate()
    scene = {name: one for name, one in hard_scene(mi).items() if sky or name != "sky"}
    loaded, rig = build_scene(scene, mi), one_view((0.3, -4, 2), (0, 0, 0.5))
    found = light_by_length(mi, loaded, rig, 20, rr_depth, SPP, 3)
    assert found.light.shape == (20, 2, 1, 12, 12, 3)
    assert (found.light[:6].mean((2, 3, 4)) > 0).all()
    cuts = found.light.cumsum(0)[:, :, 0]
    for depth in (1, 2, 3, 4, 7, 20):
        truth = traced(mi, loaded, rig, 0, {"type": "path", "max_depth": depth, "rr_depth": rr_depth}, 3)
        # Sums in another order, and fused multiplications, differ in the seventh digit.
        assert np.allclose(cuts[depth - 1], truth, rtol=1e-4, atol=1e-4 * truth.mean())


def test_views_of_a_catalogue_scene_agree_with_the_path_tracer_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each view with its own numbers, however the account is cut into parts of the picture."""
    mi = activate()
    loaded, rig = build_scene("glassware", mi), pilot_rig(default_rig("glassware", 3, 16, 12))
    whole = light_by_length(mi, loaded, rig, 8, 2, SPP, 0)
    for i in range(3):
        truth = traced(mi, loaded, rig, i, {"type": "path", "max_depth": 8, "rr_depth": 2}, 0)
        assert np.isclose(whole.light[:, :, i].sum(0), truth, rtol=1e-4, atol=1e-4 * truth.mean()).mean() > 0.98
    monkeypatch.setattr(lengths, "MOST_BOOKED", 3 * 8 * SPP * 100)
    parts = light_by_length(mi, loaded, rig, 8, 2, SPP, 0)
    assert np.allclose(parts.light, whole.light, rtol=1e-6)
    assert parts.chained == pytest.approx(whole.chained, rel=1e-6)
    assert np.array_equal(parts.light, light_by_length(mi, loaded, rig, 8, 2, SPP, 0).light)  # bit by bit


@pytest.mark.parametrize("border", [False, True])
def test_a_chain_counts_what_its_second_surface_sees_and_borders_are_no_links(border: bool) -> None:
    """A mirrored corner shows a sky of 3 by two reflections; a border between them is passed twice."""
    mi = activate()
    t, mirror = mi.ScalarTransform4f(), {"type": "conductor", "material": "none"}
    upright = t.translate([0, 5, 0]).rotate([1, 0, 0], 90).scale(50)
    scene = {
        "type": "scene", "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [2, 3, 4]}},
        "floor": {"type": "rectangle", "to_world": t.scale(50), "bsdf": mirror},
        "wall": {"type": "rectangle", "to_world": upright, "bsdf": mirror},
    }  # fmt: skip
    if border:
        scene["border"] = {"type": "sphere", "center": [0, 2.4, 1.8], "radius": 1.0, "bsdf": {"type": "null"}}
    rig = one_view((0, 0, 3), (0, 1.5, 0), 8, 10)
    found = light_by_length(mi, build_scene(scene, mi), rig, 8, 99, SPP, 0)
    assert found.light[4 if border else 2].mean() == pytest.approx(3, rel=1e-5)
    assert found.chained == pytest.approx(found.light[2:].sum(0).mean(), rel=1e-5)


def test_a_chain_ends_at_a_matt_surface_and_lamps_that_are_chosen_count_after_it_only() -> None:
    """A rough metal floor lit by a sky of 1: one lobe is not a chain. Behind glass, which is two, all light is."""
    mi = activate()
    sky = {"type": "constant", "radiance": 1.0}
    floor = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(50),
             "bsdf": {"type": "roughconductor", "material": "none", "alpha": 0.5}}  # fmt: skip
    rig = one_view((0, -1, 3), (0, 0, 0), 8)
    one = light_by_length(mi, build_scene({"type": "scene", "sky": sky, "floor": floor}, mi), rig, 8, 99, SPP, 0)
    assert one.light.sum(0).mean() > 0.8
    assert one.chained == 0
    pane = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, -0.5, 1.5]).scale([9, 9, 0.1]),
            "bsdf": {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.0}}  # fmt: skip
    matt = floor | {"bsdf": {"type": "diffuse", "reflectance": 0.5}}
    two = light_by_length(
        mi, build_scene({"type": "scene", "sky": sky, "floor": matt, "pane": pane}, mi), rig, 8, 99, SPP, 0
    )
    assert two.chained == pytest.approx(two.light.sum(0).mean(), rel=1e-5)
    assert two.chained > 0.1


def test_another_seed_and_another_view_follow_other_paths() -> None:
    mi = activate()
    loaded, rig = build_scene(hard_scene(mi), mi), one_view((0.3, -4, 2), (0, 0, 0.5), 8)
    twice = Rig(viewmats=rig.viewmats[[0, 0]], Ks=rig.Ks[[0, 0]] * [[[1.0]], [[1 + 1e-9]]], width=8, height=8)
    first, again, other = (light_by_length(mi, loaded, twice, 4, 99, SPP, seed).light for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert (first[1:] != other[1:]).mean() > 0.5
    assert (first[1:, :, 0] != first[1:, :, 1]).mean() > 0.5
    assert (first[1:, 0] != first[1:, 1]).mean() > 0.5  # each half
