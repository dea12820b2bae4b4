"""What a Mitsuba file brings along is used or refused with the reason: integrator, parameters, sensors, colours."""

import math
from pathlib import Path
from typing import Any

import pytest

from simscenes import fit_rig, own_cameras, plan_transport, read_exr, render_set
from simscenes.backend import activate, using_variant
from simscenes.loading.integrator import OwnIntegrator, in_dict, in_file, own_integrator
from simscenes.loading.load import build_in_fewest_colors, build_scene
from simscenes.loading.reference import SceneRef
from simscenes.render.framing import own_rig

BALL = '<shape type="sphere"><bsdf type="diffuse"/></shape><emitter type="constant"/>'
VIEW = """<sensor type="{}"><float name="fov" value="45"/>
  <transform name="to_world"><lookat origin="{},-4,0" target="0,0,0" up="0,0,1"/></transform>
  <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/></film></sensor>"""
FRONT = VIEW.format("perspective", 0)


def file_of(folder: Path, *parts: str) -> Path:
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{"".join(parts)}</scene>')
    return path


@pytest.mark.parametrize(
    ("plugins", "kept"),
    [
        ([("path", {"max_depth": 9, "rr_depth": 4, "hide_emitters": True})], OwnIntegrator("path", 9, 4, True)),
        ([("volpath", {"max_depth": -1})], OwnIntegrator("volpath")),
        ([("path", {"max_depth": 100000, "rr_depth": math.inf})], OwnIntegrator("path")),
        ([("aov", {}), ("path", {"max_depth": 5})], OwnIntegrator("path", 5, lost=("type 'aov'",))),
        ([("path", {"max_depth": 5}), ("stokes", {}), ("volpath", {"max_depth": 9})],
         OwnIntegrator("path", 5, lost=("type 'stokes'",))),
        ([("direct", {"bsdf_samples": 3})], OwnIntegrator("direct", 2, lost=("bsdf_samples 3",))),
        ([("ptracer", {"max_depth": 6})], OwnIntegrator("ptracer", 6, lost=("type 'ptracer'",))),
        ([("path", {"max_depth": 1})],
         OwnIntegrator("path", 2, lost=("max_depth 1 (2, lamps and surfaces they light, is the least)",))),
        ([("sphere", {})], None),
    ],
)  # fmt: skip
def test_what_of_an_integrator_is_kept_and_what_is_not(plugins: Any, kept: OwnIntegrator | None) -> None:
    assert own_integrator(plugins) == kept


def test_a_dict_and_a_file_say_the_same(tmp_path: Path) -> None:
    inner = {"type": "path", "max_depth": 7, "hide_emitters": True}
    described = {"type": "scene", "a": {"type": "sphere"}, "i": {"type": "aov", "aovs": "d:depth", "in": inner}}
    wanted = OwnIntegrator("path", 7, hide_emitters=True, lost=("type 'aov'",))
    assert own_integrator(in_dict(described)) == wanted
    xml = '<integrator type="aov"><string name="aovs" value="d:depth"/><integrator type="path">{}</integrator>'
    xml += "</integrator>"
    parts = '<integer name="max_depth" value="$deep"/><boolean name="hide_emitters" value="true"/>'
    path = file_of(tmp_path, '<default name="deep" value="3"/>', xml.format(parts), BALL)
    with using_variant("scalar") as mi:
        config = mi.parser.ParserConfig("scalar_rgb")
        assert own_integrator(in_file(mi.parser.parse_file(config, str(path), deep="7").nodes)) == wanted
        loaded = build_scene(SceneRef.of(path).given(("deep=7",)), mi)
    assert loaded.integrator == wanted


def test_hidden_lights_are_black_and_still_shine(tmp_path: Path) -> None:
    hide = '<integrator type="path"><boolean name="hide_emitters" value="true"/></integrator>'
    path = file_of(tmp_path, hide, BALL, FRONT)
    done = render_set(
        path, fit_rig(path, 2, 9, 9, sweep_deg=2.0), tmp_path / "out", spp=4, plan="rgb", variant="scalar"
    )
    light = done.radiance(0)
    assert light[0, 0].max() == 0
    assert light[4, 4].min() > 0.3
    assert done.meta["integrator"]["hide_emitters"] is True


def test_parameters_of_a_file_are_given_and_count_as_its_content(tmp_path: Path) -> None:
    size = '<default name="r" value="1"/>' + BALL.replace(
        '<bsdf type="diffuse"/>', '<float name="radius" value="$r"/><bsdf type="diffuse"/>'
    )
    path = file_of(tmp_path, size)
    with using_variant("scalar") as mi:
        plain, same, large = (build_scene(SceneRef.of(path).given(given), mi) for given in ((), ("r=1",), ("r=3",)))
        assert large.extent == pytest.approx(3 * plain.extent)
        assert len({plain.digest, large.digest}) == 2
        assert same.extent == plain.extent
        for given, said in (
            (("radius=3",), "has no parameter radius; it has r$"),
            (("r=3", "s=4"), "has no parameter s; it has r$"),
        ):
            with pytest.raises(ValueError, match=said):
                build_scene(SceneRef.of(path).given(given), mi)


@pytest.mark.parametrize(
    ("given", "said"),
    [(("r",), "must be NAME=VALUE, .* got 'r'"), (("=3",), "NAME=VALUE"), (("r 1=3",), "NAME=VALUE"),
     (("r=1", "r=2"), "given once, got r several times")],
)  # fmt: skip
def test_parameters_are_names_with_values(given: tuple[str, ...], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        SceneRef.of("scene.xml").given(given)
    with pytest.raises(ValueError, match="of the catalogue: parameters and sensors belong to Mitsuba files"):
        SceneRef.of("cornell").given(("r=1",))


def test_a_parameter_cannot_reach_outside_the_folder(tmp_path: Path) -> None:
    mesh = '<default name="m" value="m.ply"/><shape type="ply"><string name="filename" value="$m"/></shape>'
    path = file_of(tmp_path, mesh)
    with using_variant("scalar") as mi, pytest.raises(ValueError, match="outside its folder"):
        build_scene(SceneRef.of(path).given(("m=/etc/passwd",)), mi)


def test_all_sensors_of_a_file_can_be_the_views(tmp_path: Path) -> None:
    path = file_of(tmp_path, BALL, FRONT, VIEW.format("perspective", 2), VIEW.format("perspective", -2))
    views = own_cameras(path)
    assert (len(views), views.width, views.height) == (3, 8, 6)
    assert views.positions[:, 0] == pytest.approx([0, 2, -2])
    with using_variant("scalar") as mi:
        second = build_scene(SceneRef.of(path).given((), 1), mi)
        assert own_rig(second, mi).positions[0] == pytest.approx([2, -4, 0])
        with pytest.raises(ValueError, match="has 3 sensors, numbered from 0; got 3"):
            build_scene(SceneRef.of(path).given((), 3), mi)


def test_sensors_that_no_pinhole_camera_can_stand_in_for_are_refused_with_the_reason(tmp_path: Path) -> None:
    flat = VIEW.format("orthographic", 0).replace('<float name="fov" value="45"/>', "")
    with pytest.raises(
        ValueError,
        match=r"sensor 1 of scene 'scene' must be .* it is OrthographicCamera .its rays are parallel, the rays of our",
    ):
        own_cameras(file_of(tmp_path, BALL, FRONT, flat))
    wide = FRONT.replace('name="width" value="8"', 'name="width" value="9"')
    path = file_of(tmp_path, BALL, FRONT, wide)
    with pytest.raises(ValueError, match=r"has sensors of 2 sizes, \(8, 6\) to \(9, 6\)"):
        own_cameras(path)
    with pytest.warns(UserWarning, match="sensor 0 of scene 'scene' has a film of 8 x 6 pixels: .* 8 x 8 show more"):
        assert len(own_cameras(path, 8, 8)) == 2


def test_sensors_of_different_lenses_are_no_one_set_unless_a_lens_is_chosen(tmp_path: Path) -> None:
    lens = '<float name="aperture_radius" value="{}"/><float name="focus_distance" value="3"/></sensor>'
    thin = VIEW.format("thinlens", 2).replace("</sensor>", lens)
    mixed = file_of(tmp_path, BALL, FRONT, thin.format(0.1))
    with pytest.raises(ValueError, match=r"sensor 0 has a pinhole, sensor 1 an aperture radius of 0.1, focused at 3\."):
        own_cameras(mixed)
    assert len(own_cameras(mixed, own_lenses=False)) == 2
    assert len(own_cameras(file_of(tmp_path, BALL, thin.format(0.1), thin.format(0.1)))) == 2
    with pytest.raises(ValueError, match=r"aperture radius of 0.1, focused at 3, sensor 1 an aperture radius of 0.2"):
        own_cameras(file_of(tmp_path, BALL, thin.format(0.1), thin.format(0.2)))


@pytest.mark.parametrize(
    ("plane", "value", "hidden"), [("near", 3.5, True), ("near", 2.5, False), ("far", 3.1, True), ("far", 4.5, False)]
)
def test_a_clip_plane_that_hides_a_surface_is_said_not_to_be_kept(
    plane: str, value: float, hidden: bool, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    """The ball's surface lies 3 to 4 units before the sensor."""
    clipped = FRONT.replace("<transform", f'<float name="{plane}_clip" value="{value}"/><transform')
    own_cameras(file_of(tmp_path, BALL, clipped))
    said = [str(w.message) for w in recwarn]
    assert len(said) == hidden
    assert all(f"has {plane}_clip {value:g}, which hides surfaces" in line for line in said)


def test_a_mirrored_sensor_is_refused_by_its_number(tmp_path: Path) -> None:
    mirrored = FRONT.replace("<lookat", '<scale x="-1"/><lookat')
    with pytest.raises(
        ValueError, match="sensor 1 of scene 'scene' is mirrored: its to_world holds a scale of negative"
    ):
        own_cameras(file_of(tmp_path, BALL, FRONT, mirrored))


def test_a_scene_without_emitters_is_said_to_be_black(tmp_path: Path) -> None:
    path = file_of(tmp_path, BALL.partition("<emitter")[0], FRONT)
    with pytest.warns(UserWarning, match="scene 'scene' has no emitter: every picture is black; add one"):
        plan_transport(path, rig=own_cameras(path), measure=False)


def test_a_scene_whose_lamps_nothing_sees_is_said_to_be_black(tmp_path: Path) -> None:
    hidden = '<shape type="sphere"><float name="radius" value="0.5"/><emitter type="area"/></shape>'  # within the ball
    path = file_of(tmp_path, BALL.partition("<emitter")[0], hidden, FRONT)
    with pytest.warns(UserWarning, match="no light of scene 'scene' reaches its cameras"):
        plan_transport(path, rig=own_cameras(path), measure=False)


@pytest.mark.parametrize("name", ["my-fov", "lens.fov"])
def test_parameters_may_have_names_with_dots_and_dashes(name: str, tmp_path: Path) -> None:
    path = file_of(tmp_path, f'<default name="{name}" value="45"/>', BALL, FRONT.replace('"45"', f'"${name}"'))
    narrow, wide = (own_cameras(SceneRef.of(path).given([f"{name}={fov}"])).Ks[0, 0, 0] for fov in (20, 45))
    assert narrow / wide == pytest.approx(math.tan(math.radians(22.5)) / math.tan(math.radians(10)), rel=1e-5)


def test_what_mitsuba_leaves_unsaid_of_a_file_is_added(tmp_path: Path) -> None:
    path = file_of(tmp_path, BALL, FRONT.replace('"45"', '"$fov"'))
    with pytest.raises(ValueError, match=r"undefined parameter: \$fov.*give it a value: -D fov=VALUE"):
        own_cameras(path)
    path.write_text(f'<scene version="0.5.0">{BALL}<film type="ldrfilm"/></scene>')
    with pytest.raises(ValueError, match="the file is of Mitsuba 0.x"):
        own_cameras(path)


def test_a_lamp_of_a_temperature_demands_spectra(tmp_path: Path) -> None:
    """Mitsuba's RGB variants would stop in the middle of a render."""
    heat = '<float name="temperature" value="2500"/>'
    light = f'<emitter type="area"><spectrum type="blackbody" name="radiance">{heat}</spectrum></emitter>'
    loaded = build_in_fewest_colors(file_of(tmp_path, BALL.replace("</shape>", f"{light}</shape>"), FRONT), "scalar")
    assert loaded.color == "spectral"
    assert loaded.demand.endswith("holds a 'blackbody' spectrum, which only spectral variants can read")


def test_a_file_that_demands_spectra_gets_them(tmp_path: Path) -> None:
    """Its albedo is what a spectrum of that height is in RGB; what it was rendered in is recorded."""
    paint = '<spectrum type="regular" name="reflectance"><float name="wavelength_min" value="360"/>'
    paint += '<float name="wavelength_max" value="830"/><string name="values" value="0.4, 0.4"/></spectrum>'
    ball = BALL.replace('<bsdf type="diffuse"/>', f'<bsdf type="diffuse">{paint}</bsdf>')
    path = file_of(tmp_path, ball, FRONT)
    loaded = build_in_fewest_colors(path, "scalar")
    assert loaded.color == "spectral"
    rig = fit_rig(loaded, 2, 9, 9, sweep_deg=2.0)
    done = render_set(path, rig, tmp_path / "out", spp=4, variant="scalar")
    assert done.meta["mitsuba_variant"] == "scalar_spectral"
    assert "only spectral variants can read" in done.meta["demands"]
    channels, _ = read_exr(done.path / "gt" / "0000.exr")
    assert [channels[f"albedo.{c}"][4, 4] for c in "RGB"] == pytest.approx([0.4] * 3, abs=0.01)
    wrong = file_of(tmp_path, ball.replace("0.4, 0.4", "0.4, x"), FRONT)
    with pytest.raises(ValueError, match="cannot be loaded"):
        build_in_fewest_colors(wrong, "scalar")


@pytest.mark.usefixtures("jit")
def test_albedo_of_many_points_in_spectra_is_that_of_rgb() -> None:
    from simscenes.render.geometry import geometry_channels

    paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.4, 0.2]}}
    scene = {"type": "scene", "ball": {"type": "sphere", "bsdf": paint}, "sky": {"type": "constant"}}
    scene["eye"] = {"type": "perspective", "fov": 45.0,
                    "to_world": activate().ScalarTransform4f().look_at([0, -4, 0], [0, 0, 0], [0, 0, 1])}  # fmt: skip
    found = []
    for color in ("rgb", "spectral"):
        with using_variant("auto", color) as mi:
            loaded = build_scene(scene, mi)
            channels = geometry_channels(mi, loaded, own_rig(loaded, mi, 9, 9), 0)
            found.append([channels[f"albedo.{c}"][4, 4] for c in "RGB"])
            assert channels["albedo.R"][0, 0] == 0
    assert found[1] == pytest.approx(found[0], abs=0.01)
