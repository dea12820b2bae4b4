"""The planner knows what three colour channels, wavelengths and polarisation change in a scene."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import Optics, Rig, default_rig, orbit_rig, plan_transport, render_set
from simscenes.backend import activate, backend_of, using_variant
from simscenes.camera import camera_color, srgb_curves
from simscenes.loading.load import build_scene
from simscenes.rigs import intrinsics, look_at
from simscenes.scenes import SCENES
from simscenes.transport.lengths import light_by_length
from simscenes.transport.plan import MADE_UP
from simscenes.transport.spectra import WAVELENGTHS, color_error, has_measured

SceneMaker = Callable[..., dict[str, Any]]


def test_polarisation_in_rgb_scenes_is_weighed_against_the_spectra_it_needs() -> None:
    """Of glass in RGB light the made-up spectra change more; forced on, what they change is in the bound."""
    plan = plan_transport("glassware", rig=default_rig("glassware", 2, 32, 32))
    assert not plan.is_on("polarisation")
    assert plan.biases[MADE_UP] > 0.05
    forced = plan_transport("glassware", rig=default_rig("glassware", 2, 32, 32), force={"polarisation": True})
    assert MADE_UP not in forced.biases
    assert forced.bound > plan.biases[MADE_UP]


@pytest.mark.usefixtures("jit")
def test_light_by_two_mirrors_in_a_row_is_told_from_the_rest(diffuse_box: SceneMaker, ring: Rig) -> None:
    """A mirror facing a mirrored corner shows a sky of 1 by one, two or three reflections; matt things show none."""
    mi = activate()
    t, mirror = mi.ScalarTransform4f(), {"type": "conductor", "material": "none"}
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    floor = {"type": "rectangle", "to_world": t.scale(50), "bsdf": mirror}
    wall = {"type": "rectangle", "to_world": t.translate([0, 5, 0]).rotate([1, 0, 0], 90).scale(50), "bsdf": mirror}
    down = Rig(viewmats=look_at((0, 0, 3), (0, 1.5, 0))[None], Ks=intrinsics(8, 8, 10)[None], width=8, height=8)
    once = build_scene({"type": "scene", "floor": floor, "sky": sky}, mi)
    twice = build_scene({"type": "scene", "floor": floor, "wall": wall, "sky": sky}, mi)
    box = build_scene(diffuse_box(), mi)
    found = [light_by_length(mi, *seen, 8, 9, 16, 0).chained for seen in ((once, down), (twice, down), (box, ring))]
    assert found == [0, pytest.approx(1.0, rel=1e-5), 0]


@pytest.mark.usefixtures("jit")
def test_measured_lamps_call_for_spectra_and_rgb_lamps_do_not() -> None:
    market = plan_transport("market", rig=default_rig("market", 2, 32, 32), measure=False)
    assert market.is_on("spectral transport")
    assert 0.02 < market["spectral transport"].contribution < 1


@pytest.mark.usefixtures("jit")
def test_the_list_of_scenes_with_measured_lamps_is_right() -> None:
    """A scene by name is not loaded in spectra to find out."""
    with using_variant(backend_of(), "spectral") as mi:
        found = {name for name in SCENES if has_measured(mi, build_scene(name, mi))}
    assert found == {name for name, scene in SCENES.items() if scene.measured_lights}


@pytest.mark.usefixtures("jit")
def test_a_scene_with_objects_made_in_python_is_planned_in_their_colours(ring: Rig) -> None:
    mesh = activate().load_dict({"type": "sphere", "bsdf": {"type": "roughconductor"}})
    plan = plan_transport({"type": "scene", "mesh": mesh, "sky": {"type": "constant"}}, rig=ring)
    assert plan.color == "rgb"
    assert "made for RGB" in plan["spectral transport"].reason
    assert plan.seconds == {}


@pytest.mark.usefixtures("jit")
def test_a_measured_lamp_in_an_included_file_is_found(tmp_path: Path, ring: Rig) -> None:
    spectrum = '<spectrum name="intensity" value="450:0.1, 580:0.1, 590:9, 600:0.1, 700:0.1"/>'
    red = '<bsdf type="diffuse"><spectrum name="reflectance" value="400:0.1, 580:0.1, 620:0.9, 700:0.9"/></bsdf>'
    lamp = f'<emitter type="point"><point name="position" x="3" y="0" z="0"/>{spectrum}</emitter>'
    (tmp_path / "lamp.xml").write_text(f'<scene version="3.0.0">{lamp}</scene>')
    ball = f'<shape type="sphere">{red}</shape>'
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0"><include filename="lamp.xml"/>{ball}</scene>')
    effect = plan_transport(tmp_path / "scene.xml", rig=ring, measure=False)["spectral transport"]
    assert effect.on
    assert effect.contribution > 0.02


def test_color_error_is_zero_for_flat_light_and_grows_with_bounces_and_lines() -> None:
    flat = np.ones((1, len(WAVELENGTHS)))
    slope = np.linspace(0.1, 0.9, len(WAVELENGTHS))[None]
    line = np.exp(-(((WAVELENGTHS - 589) / 8) ** 2))[None] + 1e-3
    grey = np.full_like(flat, 0.5)
    assert color_error(flat, grey, None) < 1e-12
    assert color_error(line, slope, None) > 10 * color_error(flat, slope, None)
    assert color_error(flat, slope, None, 3) > color_error(flat, slope, None, 1)
    assert color_error(flat, grey, "Nikon 5100 (NPL)") < 0.05 < color_error(line, slope, "Nikon 5100 (NPL)")
    with pytest.raises(ValueError, match="camera must be"):
        color_error(flat, slope, "Box Brownie")


def lamp_over_colours(lamp: Any) -> dict[str, Any]:
    """A convex coloured ball under one light: every path bounces once, as the planner's first number assumes."""
    slope = {"type": "spectrum", "value": [(380.0, 0.7), (500.0, 0.1), (600.0, 0.8), (780.0, 0.5)]}
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": slope}}
    return {"type": "scene", "ball": ball, "sky": {"type": "constant", "radiance": lamp}}


@pytest.mark.usefixtures("jit")
def test_camera_rgb_through_the_matrix_costs_what_the_plan_says(tmp_path: Path) -> None:
    """Camera RGB straight from spectra (specfilm) against RGB light through the camera's matrix, in finished sets."""
    line = {"type": "spectrum", "value": [(380.0, 0.1), (570.0, 0.1), (590.0, 4.0), (610.0, 0.1), (780.0, 0.1)]}
    scene, rig = lamp_over_colours(line), orbit_rig(2, 12, 12, 20, radius=4.0)
    optics = Optics(camera="Nikon 5100 (NPL)")
    plan = plan_transport(scene, rig=rig, optics=optics, measure=False)
    assert plan.is_on("spectral transport")
    exact = render_set(scene, rig, tmp_path / "a", spp=256, optics=optics, plan=plan)
    cheap = plan_transport(scene, rig=rig, optics=optics, measure=False, force={"spectral transport": False})
    with pytest.warns(UserWarning, match="leaves out up to .* most of it by 'spectral transport' .forced by name; RGB"):
        approximate = render_set(scene, rig, tmp_path / "b", spp=256, optics=optics, plan=cheap)
    assert exact.meta["mitsuba_variant"].endswith("spectral")
    assert approximate.meta["mitsuba_variant"].endswith("rgb")
    seen = np.stack([exact.radiance(i) for i in range(2)]), np.stack([approximate.radiance(i) for i in range(2)])
    surface = np.stack([exact.geometry(i)["id"] for i in range(2)]) > 0  # type: ignore[index]
    cost = np.abs(seen[1] - seen[0])[surface].sum() / seen[0][surface].sum()
    assert cost == pytest.approx(cheap["spectral transport"].contribution, rel=0.25)
    assert cost > 0.05
    assert approximate.meta["camera_matrix_error"] == camera_color(optics.camera).matrix_error  # type: ignore[arg-type]


def test_a_camera_on_rgb_lights_costs_its_matrix(diffuse_box: SceneMaker, ring: Rig) -> None:
    optics = Optics(camera="Nikon 5100 (NPL)")
    effect = plan_transport(diffuse_box(), rig=ring, optics=optics, measure=False)["spectral transport"]
    assert effect.contribution == camera_color("Nikon 5100 (NPL)").matrix_error
    assert "ColorChecker" in effect.reason


def test_the_camera_matrix_maps_daylight_white_exactly_enough() -> None:
    import colour

    camera = camera_color("Nikon 5100 (NPL)")
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(colour.SpectralShape(380, 780, 5)).values
    seen, exact = light @ srgb_curves(), light @ camera.curves / camera.curves[:, 1].sum()
    assert np.allclose(camera.matrix @ seen, exact, rtol=0.05)
    assert 0.001 < camera.matrix_error < 0.05
