"""The planner leaves out only what its bound allows, and finds what it must find."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import Optics, Rig, default_rig, orbit_rig, plan_transport, render_set
from simscenes.backend import activate, backend_of
from simscenes.camera import camera_color, srgb_curves
from simscenes.render.motion import moved_pose, subframe_rig
from simscenes.render.radiance import Method, View
from simscenes.render.source import build_scene
from simscenes.rigs import intrinsics, look_at
from simscenes.scenes import MEASURED_LIGHTS, SCENES
from simscenes.transport import TransportPlan
from simscenes.transport.effects import _is_chromatic
from simscenes.transport.pilot import MOST, Share, beyond, changed_light, missing_light, most_reflected, pilot_rig
from simscenes.transport.plan import MADE_UP
from simscenes.transport.planner import everything_on
from simscenes.transport.spectra import WAVELENGTHS, color_error, has_measured
from simscenes.transport.specular import chained_light


def diffuse_box(**more: Any) -> dict[str, Any]:
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.6, 0.5]}}
    mi = activate()
    floor = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(3), "bsdf": white}
    ball = {"type": "sphere", "center": [0, 0, 0.5], "radius": 0.5, "bsdf": white}
    return {"type": "scene", "floor": floor, "ball": ball, "sky": {"type": "constant"}, **more}


def ring() -> Rig:
    return orbit_rig(4, 32, 32, 45, target=(0, 0, 0.4), radius=3.0)


@pytest.fixture(scope="module")
def plain() -> TransportPlan:
    return plan_transport(diffuse_box(), rig=ring())


def test_a_matt_scene_needs_indirect_light_and_nothing_else(plain: TransportPlan) -> None:
    roulette = plain.is_on("Russian roulette")  # by what it measured; it is no part of the light
    assert [e.name for e in plain.effects if e.on and e.name != "Russian roulette"] == ["indirect light"]
    assert plain.color == "rgb"
    rr_depth = plain.rr_depth if roulette else plain.max_depth + 1
    assert plain.integrator() == {"type": "path", "max_depth": plain.max_depth, "rr_depth": rr_depth}
    assert plain["polarisation"].contribution == 0
    assert plain.bound == pytest.approx(sum(e.contribution for e in plain.effects if not e.on and e.unit != "px"))
    assert plain.bound <= 0.02


def test_a_plan_prints_and_survives_json(plain: TransportPlan) -> None:
    import json

    text = str(plain)
    assert all(e.name in text for e in plain.effects)
    assert TransportPlan.from_dict(json.loads(json.dumps(plain.to_dict()))) == plain


def test_a_measured_plan_says_what_it_saves(plain: TransportPlan) -> None:
    assert set(plain.seconds) == {"planned", "everything on"}
    assert all(0 < s < np.inf for s in plain.seconds.values())
    assert "times less time" in str(plain)
    bounded = plan_transport(diffuse_box(), rig=ring(), measure=False)
    assert bounded.seconds == {}
    everything = everything_on(plain)
    assert everything.color == "spectral_polarized"
    assert everything.integrator()["max_depth"] == 64


def test_every_effect_can_be_forced() -> None:
    force = {"indirect light": False, "polarisation": True, "Russian roulette": False}
    forced = plan_transport(diffuse_box(), rig=ring(), force=force, max_depth=5)
    assert forced["indirect light"].forced
    assert forced.integrator() == {"type": "path", "max_depth": 2, "rr_depth": 3}
    assert forced.color == "spectral_polarized"
    assert forced["paths beyond max_depth"].forced
    assert forced.bound >= forced["indirect light"].contribution > 0.03
    endless = plan_transport(diffuse_box(), rig=ring(), force={"paths beyond max_depth": True}, measure=False)
    assert endless.integrator() == {"type": "path", "max_depth": -1, "rr_depth": 2}
    assert endless["paths beyond max_depth"].on


@pytest.mark.parametrize(
    ("force", "said"),
    [
        ({"magic": True}, "must be one of"),
        ({"depth of field": True}, "pinhole"),
        ({"motion blur": True}, "at rest"),
        ({"paths beyond max_depth": True, "Russian roulette": False}, "needs 'Russian roulette' on"),
        ({"paths beyond max_depth": True, "indirect light": False}, "needs 'indirect light' on"),
        ({"participating media": True}, "holds no medium"),
        ({"chromatic media": True}, "holds no medium"),
        ({"polarisation": True, "spectral transport": False}, "needs 'spectral transport' on"),
    ],
)
def test_what_cannot_be_simulated_is_refused_before_any_pilot(
    force: dict[str, bool], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from simscenes.transport import pilot

    monkeypatch.setattr(pilot, "render_pilot", None)
    with pytest.raises(ValueError, match=said):
        plan_transport(diffuse_box(), rig=ring(), force=force)
    with pytest.raises(ValueError, match="max_depth must be at least 2"):
        plan_transport(diffuse_box(), rig=ring(), max_depth=1)


def test_what_is_on_brings_what_it_needs() -> None:
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.01}}
    scene = {"type": "scene", "ball": {"type": "sphere", "bsdf": black}, "sky": {"type": "constant"}}
    endless = plan_transport(scene, rig=ring(), force={"paths beyond max_depth": True}, measure=False)
    assert endless.integrator()["max_depth"] == -1
    assert endless["indirect light"].reason == "because paths beyond max_depth is on"
    fog = {"type": "homogeneous", "albedo": 0.5, "sigma_t": {"type": "rgb", "value": [0.2, 0.4, 0.8]}, "scale": 2.0}
    cloud = {"type": "sphere", "radius": 1.2, "bsdf": {"type": "null"}, "interior": fog}
    plan = plan_transport(diffuse_box(cloud=cloud), rig=ring(), measure=False)
    assert plan.integrator()["type"] == "volpathmis"
    polarised = plan.force(on=["polarisation"])  # volpathmis knows none
    assert (polarised.integrator()["type"], polarised.color) == ("volpath", "spectral_polarized")
    assert polarised.is_on("spectral transport")
    assert np.isnan(polarised.bound)
    assert plan.force(off=["participating media"]).integrator()["type"] == "path"
    assert not polarised.force(off=["spectral transport"]).is_on("polarisation")
    with pytest.raises(ValueError, match="effect name"):
        plan.force(on=["magic"])


def test_motion_blur_can_be_forced_on_a_plan_that_is_made(tmp_path: Path) -> None:
    rig, images = ring(), {}
    plan = plan_transport(diffuse_box(), rig=rig, optics=Optics(motion=0.3), measure=False)
    for name, made in (("as planned", plan), ("off", plan.force(off=["motion blur"]))):
        done = render_set(diffuse_box(), rig, tmp_path / name, spp=64, optics=Optics(motion=0.3), plan=made)
        images[name] = done.radiance(1)
    still = render_set(diffuse_box(), rig, tmp_path / "still", spp=64, plan=plan.force(off=["motion blur"]))
    assert np.array_equal(images["off"], still.radiance(1))
    assert not np.allclose(images["as planned"], images["off"], rtol=0.1)


def test_polarisation_in_rgb_scenes_is_weighed_against_the_spectra_it_needs() -> None:
    """Of glass in RGB light the made-up spectra change more; forced on, what they change is in the bound."""
    plan = plan_transport("glassware", rig=default_rig("glassware", 2, 32, 32))
    assert not plan.is_on("polarisation")
    assert plan.biases[MADE_UP] > 0.05
    forced = plan_transport("glassware", rig=default_rig("glassware", 2, 32, 32), force={"polarisation": True})
    assert MADE_UP not in forced.biases
    assert forced.bound > plan.biases[MADE_UP]


def test_a_black_body_scene_needs_direct_light_only() -> None:
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.01}}
    scene = {"type": "scene", "ball": {"type": "sphere", "bsdf": black}, "sky": {"type": "constant"}}
    plan = plan_transport(scene, rig=ring())
    assert not plan.is_on("indirect light")
    assert plan.integrator()["max_depth"] == 2


def test_fog_switches_the_integrator_and_coloured_fog_the_sampler() -> None:
    for sigma_t, kind in ((0.4, "volpath"), ({"type": "rgb", "value": [0.2, 0.4, 0.8]}, "volpathmis")):
        fog = {"type": "homogeneous", "albedo": {"type": "rgb", "value": 0.5}, "sigma_t": sigma_t, "scale": 2.0}
        cloud = {"type": "sphere", "radius": 1.2, "bsdf": {"type": "null"}, "interior": fog}
        plan = plan_transport(diffuse_box(cloud=cloud), rig=ring(), measure=False)
        assert plan.is_on("participating media")
        assert plan["participating media"].contribution > 0.05
        assert plan.integrator()["type"] == kind


def test_glass_goes_deeper_than_matt_things() -> None:
    glass = {"type": "dielectric", "int_ior": "bk7", "ext_ior": "air"}
    nested = {
        f"shell_{k}": {"type": "sphere", "center": [0, 0, 0.5], "radius": 0.9 - 0.1 * k, "bsdf": glass}
        for k in range(4)
    }
    plan = plan_transport(diffuse_box(**nested), rig=ring(), measure=False)
    assert plan.max_depth > 8
    assert plan["polarisation"].contribution > 0


@pytest.mark.usefixtures("jit")
def test_light_by_two_mirrors_in_a_row_is_told_from_the_rest() -> None:
    """A mirror facing a mirrored corner shows a sky of 1 by one, two or three reflections; matt things show none."""
    mi = activate()
    t, mirror = mi.ScalarTransform4f(), {"type": "conductor", "material": "none"}
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    floor = {"type": "rectangle", "to_world": t.scale(50), "bsdf": mirror}
    wall = {"type": "rectangle", "to_world": t.translate([0, 5, 0]).rotate([1, 0, 0], 90).scale(50), "bsdf": mirror}
    down = Rig(viewmats=look_at((0, 0, 3), (0, 1.5, 0))[None], Ks=intrinsics(8, 8, 10)[None], width=8, height=8)
    settings = {"type": "path", "max_depth": 8, "rr_depth": 9}
    once = build_scene({"type": "scene", "floor": floor, "sky": sky}, mi)
    twice = build_scene({"type": "scene", "floor": floor, "wall": wall, "sky": sky}, mi)
    assert chained_light(mi, once, down, settings, 0) == 0
    assert chained_light(mi, twice, down, settings, 0) == pytest.approx(1.0, rel=1e-5)
    assert chained_light(mi, build_scene(diffuse_box(), mi), ring(), settings, 0) == 0


def test_lens_and_motion_are_weighed_in_pixels() -> None:
    quiet = Optics(aperture_radius=1e-4, focus_distance=3.0, motion=1e-3)
    loud = Optics(aperture_radius=0.1, focus_distance=2.0, motion=0.2)
    plans = [plan_transport(diffuse_box(), rig=ring(), optics=o, measure=False) for o in (quiet, loud)]
    for name in ("depth of field", "motion blur"):
        assert not plans[0].is_on(name)
        assert plans[1].is_on(name)
        assert plans[0][name].contribution < 0.5 < plans[1][name].contribution
    assert plans[1].subframes in (4, 16, 64)
    # Circle of confusion of the nearest points and of the sky, by similar triangles.
    focal = 16 / np.tan(np.radians(22.5))
    worst = max(2 * 0.1 * abs(1 - 2.0 / z) * focal / 2.0 for z in (2.0, np.inf))
    assert plans[1]["depth of field"].contribution <= 1.001 * worst


@pytest.mark.usefixtures("jit")
def test_measured_lamps_call_for_spectra_and_rgb_lamps_do_not() -> None:
    market = plan_transport("market", rig=default_rig("market", 2, 32, 32), measure=False)
    assert market.is_on("spectral transport")
    assert 0.02 < market["spectral transport"].contribution < 1


@pytest.mark.usefixtures("jit")
def test_the_list_of_scenes_with_measured_lamps_is_right() -> None:
    """A scene by name is not loaded in spectra to find out."""
    mi = activate(backend_of(), "spectral")
    found = {name for name in SCENES if has_measured(mi, build_scene(name, mi))}
    activate()
    assert found == MEASURED_LIGHTS


@pytest.mark.usefixtures("jit")
def test_a_scene_with_objects_made_in_python_is_planned_in_their_colours() -> None:
    mesh = activate().load_dict({"type": "sphere", "bsdf": {"type": "roughconductor"}})
    plan = plan_transport({"type": "scene", "mesh": mesh, "sky": {"type": "constant"}}, rig=ring())
    assert plan.color == "rgb"
    assert "made for RGB" in plan["spectral transport"].reason
    assert plan.seconds == {}


def test_only_colours_make_a_medium_chromatic() -> None:
    mi = activate()
    for shape, chromatic in (((3, 3, 3, 1), False), ((2, 2, 2, 3), True)):
        grid = mi.VolumeGrid(np.arange(np.prod(shape), dtype=np.float32).reshape(shape) / 50 + 0.1)
        density = {"type": "gridvolume", "grid": grid, "raw": True}
        medium = mi.load_dict({"type": "heterogeneous", "sigma_t": density, "albedo": 0.5})
        assert _is_chromatic(mi, medium) == chromatic


@pytest.mark.usefixtures("jit")
def test_a_measured_lamp_in_an_included_file_is_found(tmp_path: Path) -> None:
    spectrum = '<spectrum name="intensity" value="450:0.1, 580:0.1, 590:9, 600:0.1, 700:0.1"/>'
    red = '<bsdf type="diffuse"><spectrum name="reflectance" value="400:0.1, 580:0.1, 620:0.9, 700:0.9"/></bsdf>'
    lamp = f'<emitter type="point"><point name="position" x="3" y="0" z="0"/>{spectrum}</emitter>'
    (tmp_path / "lamp.xml").write_text(f'<scene version="3.0.0">{lamp}</scene>')
    ball = f'<shape type="sphere">{red}</shape>'
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0"><include filename="lamp.xml"/>{ball}</scene>')
    effect = plan_transport(tmp_path / "scene.xml", rig=ring(), measure=False)["spectral transport"]
    assert effect.on
    assert effect.contribution > 0.02


def test_the_lens_is_rendered_when_the_plan_says_so_and_only_then(tmp_path: Path) -> None:
    """A small bright ball out of focus: its light spreads over the circle of confusion, and comes back without lens."""
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    ball = {"type": "sphere", "center": [0, 0, 0], "radius": 0.05, "emitter": glow}
    wall = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}}
    scene = {"type": "scene", "ball": ball, "wall": wall | {"to_world": activate().ScalarTransform4f().scale(0.01)}}
    rig = orbit_rig(2, 32, 32, 20, target=(0, 0, 0), radius=4.0, swing_deg=0)
    optics, areas = Optics(aperture_radius=0.2, focus_distance=2.0), {}
    for on in (True, False):
        plan = plan_transport(scene, rig=rig, optics=optics, measure=False, force={"depth of field": on})
        views = render_set(scene, rig, tmp_path / str(on), spp=64, optics=optics, plan=plan)
        image = views.radiance(0)[..., 1].astype(np.float64)
        areas[on] = image.sum() ** 2 / (image**2).sum()  # pixels that share the light
    focal = float(rig.Ks[0, 0, 0])
    sharp, circle = np.pi * (0.05 * focal / 4) ** 2, np.pi * (0.2 * abs(1 - 2 / 4) / 2 * focal) ** 2
    assert areas[False] == pytest.approx(sharp, rel=0.5)
    assert areas[True] == pytest.approx(circle, rel=0.3)
    assert areas[True] > 10 * areas[False]


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
    approximate = render_set(scene, rig, tmp_path / "b", spp=256, optics=optics, plan=cheap)
    assert exact.meta["mitsuba_variant"].endswith("spectral")
    assert approximate.meta["mitsuba_variant"].endswith("rgb")
    seen = np.stack([exact.radiance(i) for i in range(2)]), np.stack([approximate.radiance(i) for i in range(2)])
    surface = np.stack([exact.geometry(i)["id"] for i in range(2)]) > 0  # type: ignore[index]
    cost = np.abs(seen[1] - seen[0])[surface].sum() / seen[0][surface].sum()
    assert cost == pytest.approx(cheap["spectral transport"].contribution, rel=0.25)
    assert cost > 0.05
    assert approximate.meta["camera_matrix_error"] == camera_color(optics.camera).matrix_error  # type: ignore[arg-type]


def test_a_camera_on_rgb_lights_costs_its_matrix() -> None:
    optics = Optics(camera="Nikon 5100 (NPL)")
    effect = plan_transport(diffuse_box(), rig=ring(), optics=optics, measure=False)["spectral transport"]
    assert effect.contribution == camera_color("Nikon 5100 (NPL)").matrix_error
    assert "ColorChecker" in effect.reason


def test_the_camera_matrix_maps_daylight_white_exactly_enough() -> None:
    import colour

    camera = camera_color("Nikon 5100 (NPL)")
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(colour.SpectralShape(380, 780, 5)).values
    seen, exact = light @ srgb_curves(), light @ camera.curves / camera.curves[:, 1].sum()
    assert np.allclose(camera.matrix @ seen, exact, rtol=0.05)
    assert 0.001 < camera.matrix_error < 0.05


def test_missing_light_counts_the_mean_and_bounds_it() -> None:
    rng = np.random.default_rng(0)
    full = np.ones((3, 32, 32, 3))
    lacking = rng.exponential(0.01, (3, 32, 32, 1)) * np.ones(3)
    share = missing_light(full, full - lacking)
    assert share.estimate == pytest.approx(lacking.mean())
    assert share.upper == pytest.approx(0.01, rel=0.15)
    assert share.upper > 0.01
    assert missing_light(np.zeros_like(full), np.zeros_like(full)).upper == 0


def test_the_interval_beyond_a_cut_holds_a_geometric_series() -> None:
    """Light (1 - a) a^k after k bounces: a pilot to depth 64 misses a^64 of it, which the upper end must cover."""
    for albedo in (0.5, 0.9, 0.98):
        for depth in (8, 16, 32):
            found = albedo**depth - albedo**64
            cut = beyond(Share(found, found), 64 - depth, albedo)
            assert cut.estimate <= albedo**depth
            assert cut.upper == pytest.approx(albedo**depth)


def test_the_most_a_bounce_keeps_is_that_of_the_brightest_surface_seen_or_not() -> None:
    mi = activate()
    hidden = {"type": "sphere", "center": [0, 0, -50], "bsdf": {"type": "diffuse", "reflectance": 0.9}}
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(np.full((4, 4, 3), 0.95, np.float32)), "raw": True}
    textured = {"type": "sphere", "bsdf": {"type": "twosided", "b": {"type": "diffuse", "reflectance": bitmap}}}
    for more, most in (({}, 0.7), ({"h": hidden}, 0.9), ({"h": hidden, "t": textured}, 0.95)):
        assert most_reflected(mi, build_scene(diffuse_box(**more), mi)) == pytest.approx(most)
    fog = {"type": "homogeneous", "sigma_t": 0.1, "albedo": 0.99}
    cloud = {"type": "sphere", "bsdf": {"type": "null"}, "interior": fog}
    metal = {"type": "sphere", "bsdf": {"type": "conductor"}}
    assert most_reflected(mi, build_scene(diffuse_box(c=cloud), mi)) == MOST
    assert most_reflected(mi, build_scene(diffuse_box(m=metal), mi)) == MOST


def test_changed_light_averages_noise_away_but_not_change() -> None:
    rng = np.random.default_rng(0)
    full = np.ones((3, 32, 32, 3))
    noisy = full + rng.normal(0, 0.1, full.shape)
    assert changed_light(full, noisy).upper < 0.02
    half = full.copy()
    half[:, :16] *= 1.1
    assert changed_light(full, half).estimate == pytest.approx(0.05)


def test_pilots_keep_the_field_of_view() -> None:
    rig = default_rig("cornell", 9, 640, 480)
    small = pilot_rig(rig)
    assert (len(small), small.width, small.height) == (3, 32, 24)
    corners = np.array([[0.0, 0], [640, 480]])
    for K, w, h, place in ((rig.Ks[0], 640, 480, corners), (small.Ks[0], 32, 24, corners / 20)):
        rays = (place - K[:2, 2]) / np.diag(K)[:2]
        assert np.allclose(rays, [[-w / 2 / K[0, 0], -h / 2 / K[1, 1]], [w / 2 / K[0, 0], h / 2 / K[1, 1]]])


def test_poses_of_an_exposure_lie_on_the_way_between_the_views() -> None:
    rig = orbit_rig(8, 16, 16, 50, radius=2.0, swing_deg=0)
    assert np.allclose(moved_pose(rig, 3, 1.0), rig.viewmats[4], atol=1e-9)
    assert np.allclose(moved_pose(rig, 3, -1.0), rig.viewmats[2], atol=1e-9)
    assert np.array_equal(moved_pose(rig, 3, 0.0), rig.viewmats[3])
    ends = moved_pose(rig, 0, -0.5), moved_pose(rig, 7, 0.5)  # past the ends of the rig
    assert all(np.allclose(e[:3, :3] @ e[:3, :3].T, np.eye(3)) for e in ends)
    frames = subframe_rig(rig, 3, 0.4, 8)
    assert np.allclose(frames.positions.mean(0), rig.positions[3], atol=0.05)
    steps = np.linalg.norm(np.diff(frames.positions, axis=0), axis=1)
    assert np.allclose(steps, steps[0], rtol=0.1)


def difference(
    scene: str, rig: Rig, plan: TransportPlan, reference: TransportPlan, spp: int
) -> dict[str, tuple[float, float]]:
    """Absolute differences over all light: of the whole mean, and averaged over 4 x 4 blocks; each with its error."""
    images, variances = [], []
    for made in (plan, reference):
        mi = activate(backend_of(), made.color)
        loaded = build_scene(scene, mi)
        method = Method(mi, mi.variant(), loaded, mi.load_dict(made.integrator()))
        seen = [View(method, rig, i).render(spp, None) for i in range(len(rig))]
        images.append(np.stack([v.mean for v in seen]).astype(np.float64).mean(-1))
        # The channels of a pixel err together.
        variances.append(np.stack([v.variance for v in seen]).astype(np.float64).mean(-1))
    activate()
    gap, variance, total = images[0] - images[1], variances[0] + variances[1], images[1].mean()
    n, h, w = gap.shape
    blocks = np.abs(gap.reshape(n, 4, h // 4, 4, w // 4).mean((2, 4)))
    spread = np.sqrt(variance.reshape(n, 4, h // 4, 4, w // 4).mean((2, 4)) * 16 / (h * w))
    whole = abs(float(gap.mean())), float(np.sqrt(variance.mean() / gap.size))
    return {"whole": (whole[0] / total, whole[1] / total), "blocks": (blocks.mean() / total, spread.mean() / total)}


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize(
    "name", [n if n in ("cornell", "hall") else pytest.param(n, marks=pytest.mark.slow) for n in SCENES]
)
def test_what_is_left_out_stays_below_the_stated_bound(name: str) -> None:
    """Against a render with everything on: deep paths, media, spectra, polarisation."""
    rig = default_rig(name, 2, 32, 32)
    plan = plan_transport(name, rig=rig)
    everything = everything_on(plan)
    assert "spectral" in everything.color
    found = difference(name, rig, plan, everything, 256)
    bound = plan.bound + plan.biases.get(MADE_UP, 0.0)  # everything includes spectra, where there are none as well
    change, error = found["whole"]
    assert change <= bound + 5 * error
    # The mean of 32 absolute normal deviates is 0.8 standard deviations, and beyond 1.25 once in 10^4 times.
    change, error = found["blocks"]
    assert change <= bound + 1.25 * error


def test_motion_blur_averages_the_poses(tmp_path: Path) -> None:
    rig = ring()
    blurred = render_set(diffuse_box(), rig, tmp_path / "a", spp=256, optics=Optics(motion=0.3))
    sharp = render_set(diffuse_box(), rig, tmp_path / "b", spp=256)
    assert blurred.meta["plan"]["subframes"] > 1
    frames = subframe_rig(rig, 1, 0.3, blurred.meta["plan"]["subframes"])
    mi = activate()
    loaded = build_scene(diffuse_box(), mi)
    method = Method(mi, mi.variant(), loaded, mi.load_dict({"type": "path", "max_depth": 8, "rr_depth": 2}))
    mean = np.mean([View(method, frames, k).render(32, None).mean for k in range(len(frames))], 0)
    away, still = (np.abs(blurred.radiance(1) - other).mean() for other in (mean, sharp.radiance(1)))
    assert away < 0.5 * still
