"""Scenes from elsewhere: read where they are sound, refused with the reason where they are not."""

import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simscenes import Rig, fit_rig, load_set, render_set
from simscenes.backend import activate
from simscenes.loading.checks.physical import offset_share
from simscenes.loading.checks.untrusted import check_xml
from simscenes.loading.load import build_scene
from simscenes.render.framing import own_rig
from simscenes.rigs import intrinsics, look_at

SCENE = """<scene version="3.0.0">
  <default name="res" value="24"/>
  <sensor type="perspective">
    <float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0,1.5,4" target="0,0.5,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="$res"/><integer name="height" value="18"/></film>
  </sensor>
  <shape type="sphere" id="ball">
    <point name="center" value="0,0.5,0"/><float name="radius" value="0.5"/>
    <bsdf type="diffuse">{reflectance}</bsdf>
  </shape>
  <shape type="rectangle" id="floor">
    <transform name="to_world"><rotate x="1" angle="-90"/><scale value="5"/></transform>
  </shape>
  <emitter type="constant"/>{more}
</scene>"""
GREY = '<rgb name="reflectance" value="0.5,0.4,0.3"/>'


def write_scene(folder: Path, reflectance: str = GREY, more: str = "") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.xml").write_text(SCENE.format(reflectance=reflectance, more=more))
    return folder / "scene.xml"


def texture(name: str) -> str:
    return f'<texture type="bitmap" name="reflectance"><string name="filename" value="{name}"/></texture>'


def ball(**more: Any) -> dict[str, Any]:
    shape = {"type": "sphere", "bsdf": {"type": "diffuse"}}
    return {"type": "scene", "ball": shape, "sky": {"type": "constant"}, **more}


def rig_at(eye: Any, target: Any = (0, 0, 0)) -> Rig:
    return Rig(viewmats=look_at(eye, target)[None], Ks=intrinsics(6, 5, 60)[None], width=6, height=5)


def test_an_xml_file_renders_around_its_own_sensor(tmp_path: Path) -> None:
    path = write_scene(tmp_path / "scene")
    mi = activate()
    loaded = build_scene(path, mi)
    own = own_rig(loaded, mi)
    assert (own.width, own.height) == (24, 18)
    assert np.allclose(own.positions, (0, 1.5, 4), atol=1e-6)
    assert np.allclose(own.Ks[0], intrinsics(24, 18, 45), rtol=1e-6)
    rig = fit_rig(path, 5)
    pixels, depths = rig.project([[0, 0.5, 0]])
    assert np.abs(pixels[:, 0] - (12, 9)).max() < 3  # all look where the sensor looked
    assert (np.linalg.norm(np.diff(rig.positions, axis=0), axis=1) > 0.1).all()
    assert (rig.viewmats[:, 1, 1] < 0).all()  # the scene's up, +y, stays up
    done = render_set(path, fit_rig(path, 2, 12, 9), tmp_path / "out", spp=4, plan="rgb")
    assert (len(done), done.meta["scene"], done.meta["shapes"]) == (2, "scene", ["ball", "floor"])
    assert load_set(tmp_path / "out").image(0).max() > 100


def test_an_arc_is_narrowed_until_its_cameras_are_free(tmp_path: Path) -> None:
    wall = """<shape type="cube" id="wall"><transform name="to_world"><scale x="0.1" y="3" z="3"/>
      <translate x="1" y="1" z="3"/></transform></shape>"""
    free, walled = write_scene(tmp_path / "a"), write_scene(tmp_path / "b", more=wall)
    wide, narrow = (np.ptp(fit_rig(p, 5).positions[:, 0]) for p in (free, walled))
    assert wide > 2.5
    assert 0 < narrow < 2


def test_textures_beside_the_scene_are_read_and_others_are_not(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(40, 200, (8, 8, 3), dtype=np.uint8)
    for name in ("scene/wood.png", "secret.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / name), pixels)
    mi = activate()
    assert build_scene(write_scene(tmp_path / "scene", texture("wood.png")), mi).shapes == ("ball", "floor")
    outside = [texture("../secret.png"), texture(str(tmp_path / "secret.png")), texture("$file")]
    for reflectance in outside:
        defaults = '<default name="file" value="../secret.png"/>' if "$file" in reflectance else ""
        path = write_scene(tmp_path / "scene", reflectance)
        path.write_text(path.read_text().replace('<default name="res"', defaults + '<default name="res"'))
        with pytest.raises(ValueError, match="outside its folder"):
            build_scene(path, mi)
    path = write_scene(tmp_path / "scene", texture("../secret.png"))
    assert build_scene(path, mi, allow_outside=True).shapes == ("ball", "floor")


def test_a_link_is_no_way_out_of_the_folder(tmp_path: Path) -> None:
    path = write_scene(tmp_path / "scene", texture("inside.png"))
    cv2.imwrite(str(tmp_path / "secret.png"), np.zeros((4, 4, 3), np.uint8))
    (tmp_path / "scene" / "inside.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(ValueError, match="outside its folder"):
        build_scene(path, activate())


SPECTRUM_FILE = '<emitter type="constant"><spectrum name="radiance" filename="/etc/hostname"/></emitter>'


@pytest.mark.parametrize("leak", ['<include filename="../other.xml"/>', '<path value="/etc"/>', SPECTRUM_FILE])
def test_what_the_parser_would_read_itself_is_checked_before_it_runs(leak: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="outside its folder"):
        build_scene(write_scene(tmp_path / "scene", more=leak), activate())


def test_included_files_are_checked_as_well(tmp_path: Path) -> None:
    path = write_scene(tmp_path, more='<include filename="part.xml"/>')
    part = '<scene version="3.0.0"><shape type="ply"><string name="filename" value="../x.ply"/></shape></scene>'
    (tmp_path / "part.xml").write_text(part)
    with pytest.raises(ValueError, match="outside its folder"):
        build_scene(path, activate())
    (tmp_path / "part.xml").write_text('<scene version="3.0.0"><include filename="part.xml"/></scene>')
    with pytest.raises(ValueError, match="15 deep"):
        build_scene(path, activate())


def test_entity_bombs_are_refused_in_bounded_time(tmp_path: Path) -> None:
    bomb = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]><scene version="3.0.0">&b;</scene>'
    (tmp_path / "scene.xml").write_text(bomb)
    start = time.perf_counter()
    with pytest.raises(ValueError, match="entities"):
        build_scene(tmp_path / "scene.xml", activate())
    assert time.perf_counter() - start < 60  # it must end, however slow the machine


@pytest.mark.parametrize(
    ("reflectance", "more", "message"),
    [
        (texture("missing.png"), "", "cannot be loaded"),
        (GREY, '<shape type="dodecahedron"/>', "dodecahedron"),
        (GREY, "<oops", "cannot be read as XML"),
        ('<rgb name="reflectance" value="-0.5,0.4,0.3"/>', "", "reflectance|0..1"),
        ('<rgb name="reflectance" value="1.5,0.4,0.3"/>', "", "reflectance|0..1"),
        (GREY, '<emitter type="point"><rgb name="intensity" value="nan"/></emitter>', "finite|nan"),
        (GREY, '<emitter type="point"><rgb name="intensity" value="-3"/></emitter>', ">= 0"),
    ],
    ids=["missing texture", "unknown plugin", "broken xml", "albedo < 0", "albedo > 1", "nan light", "dark light"],
)
def test_broken_scenes_are_refused_with_the_reason(reflectance: str, more: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        build_scene(write_scene(tmp_path, reflectance, more), activate())


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ({"type": "scene", "sky": {"type": "constant"}}, "no shapes"),
        ({"type": "sphere"}, "type 'scene'"),
        ({"type": "scene", "a": {"type": "sphere", "radiu": 3}}, "radiu"),
        (ball(lamp={"type": "point", "intensity": {"type": "rgb", "value": float("inf")}}), "finite|inf"),
        (17, "scene must be"),
        (
            ball(
                lamp={"type": "point", "intensity": {"type": "irregular", "wavelengths": "400, 700", "values": "1, 2"}}
            ),
            "type 'spectrum'",
        ),
    ],
    ids=["no shapes", "no scene", "misspelt", "infinite light", "a number", "raw spectrum"],
)
def test_broken_dicts_are_refused_with_the_reason(scene: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build_scene(scene, activate())


@pytest.mark.parametrize(("axis", "length"), [('x="0.701" y="0.701" z="0.701"', "1.214"), ('value="1, 1, 0"', "1.414")])
def test_a_turn_about_an_axis_of_another_length_would_stretch_and_is_refused(
    axis: str, length: str, tmp_path: Path
) -> None:
    turned = '<shape type="cube"><transform name="to_world"><rotate {} angle="{}"/></transform></shape>'
    with pytest.raises(ValueError, match=f"must be of length 1, got {length}"):
        check_xml(write_scene(tmp_path, more=turned.format(axis, 30)))
    for sound in (turned.format(axis, 360), turned.format('x="0.577" y="0.577" z="0.577"', 30), '<rotate z="-1"/>'):
        check_xml(write_scene(tmp_path, more=sound))


def test_shapes_that_mitsuba_takes_for_others_are_refused() -> None:
    mi = activate()
    transform, lamp = mi.ScalarTransform4f(), {"type": "area"}
    long, tilted = transform.scale([2, 1, 1]), transform.rotate([1, 0, 0], 60)
    cells = np.linspace(-1, 1, 4)[:, None, None, None] * np.ones((4, 4, 4, 1))
    grid = {"type": "sdfgrid", "grid": mi.TensorXf(cells.astype(np.float32))}
    for shape, message in (
        ({"type": "sphere", "to_world": long}, "'egg' is a sphere that is stretched by 2, 1, 1"),
        ({"type": "cylinder", "to_world": long, "emitter": lamp}, "'egg' is a lamp on a cylinder that is stretched"),
        ({**grid, "to_world": tilted}, "'egg' is an 'sdfgrid' that is turned or mirrored"),
    ):
        with pytest.raises(ValueError, match=message):
            build_scene(ball(egg=shape), mi)
    turned = tilted @ transform.scale([-2, 2, 2])  # a ball's mirror image is a ball
    group = {"type": "shapegroup", "round": {"type": "sphere"}}
    instance = {"type": "instance", "to_world": long, "group": {"type": "ref", "id": "group"}}
    sound = {"tube": {"type": "cylinder", "to_world": long}, "grid": {**grid, "to_world": long},
             "round": {"type": "sphere", "to_world": turned, "emitter": lamp}, "group": group, "egg": instance,
             "lamp": {"type": "cylinder", "to_world": tilted.scale([1, 1, 9]), "emitter": lamp}}  # fmt: skip
    assert len(build_scene(ball(**sound), mi).shapes) == 6


def bitmap(mi: Any, value: float) -> dict[str, Any]:
    return {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(np.full((4, 8, 3), value, np.float32))}


def unphysical(kind: str, mi: Any) -> dict[str, Any]:
    def box(**medium: Any) -> dict[str, Any]:
        return {"type": "sphere", "bsdf": {"type": "null"}, "interior": {"type": "homogeneous", **medium}}

    def painted(**bsdf: Any) -> dict[str, Any]:
        return {"type": "sphere", "bsdf": bsdf}

    def moved(*diagonal: float) -> dict[str, Any]:
        return {"type": "sphere", "to_world": mi.ScalarTransform4f(np.diag([*diagonal, 1.0]))}

    return {
        "negative pixel of the sky": ball(sky={"type": "envmap", "bitmap": bitmap(mi, -1.0)["bitmap"]}),
        "negative sky": ball(sky={"type": "envmap", "bitmap": bitmap(mi, 1.0)["bitmap"], "scale": -2.0}),
        "negative slide": ball(lamp={"type": "projector", "irradiance": bitmap(mi, -1.0)}),
        "negative paint": ball(ball=painted(type="principled", base_color=bitmap(mi, -1.0))),
        "glass that makes light": ball(ball=painted(type="dielectric", specular_transmittance=3.0)),
        "negative fog": ball(fog=box(sigma_t=-1.0)),
        "negative fog scale": ball(fog=box(scale=-1.0)),
        "nan in a transform": ball(far=moved(np.nan, 1.0, 1.0)),
        "nan in the only transform": ball(ball=moved(np.nan, np.nan, np.nan)),
        "nan in a texture's transform": ball(
            ball=painted(
                type="diffuse",
                reflectance={"type": "checkerboard", "to_uv": mi.ScalarTransform4f(np.diag([np.nan, 1.0, 1.0, 1.0]))},
            )
        ),
        "no room": ball(ball=moved(0.0, 0.0, 0.0)),
    }[kind]


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("negative pixel of the sky", "data of EnvironmentMapEmitter 'sky' must be >= 0"),
        ("negative sky", "scale of EnvironmentMapEmitter 'sky' must be >= 0"),
        ("negative slide", "irradiance.data of .* 'lamp' must be >= 0"),
        ("negative paint", "base_color.data must lie in 0..1"),
        ("glass that makes light", "specular_transmittance.value must lie in 0..1"),
        ("negative fog", "sigma_t.value.value of HomogeneousMedium .* must be >= 0"),
        ("negative fog scale", "scale of HomogeneousMedium .* must be >= 0"),
        ("nan in a transform", "finite"),
        ("nan in the only transform", "finite box"),
        ("nan in a texture's transform", "reflectance.to_uv must be finite"),
        ("no room", "finite box of some size"),
    ],
)
def test_unphysical_numbers_are_refused_by_their_name(kind: str, message: str) -> None:
    mi = activate()
    with pytest.raises(ValueError, match=message):
        build_scene(unphysical(kind, mi), mi)


@pytest.mark.parametrize("attribute", ["vertex_color", "face_color"])
def test_colours_of_a_mesh_are_shares_of_light_where_a_material_reflects_by_them(attribute: str) -> None:
    mi = activate()

    def painted(colour: float, scale: float, material: str = "diffuse", use: str = "reflectance") -> dict[str, Any]:
        bsdf = mi.load_dict({"type": material, use: {"type": "mesh_attribute", "name": attribute, "scale": scale}})
        properties = mi.Properties()
        properties["mesh_bsdf"] = bsdf
        mesh = mi.Mesh("triangle", 3, 1, props=properties)
        mesh.add_attribute(attribute, 3, [0.2, 0.3, colour] * (3 if attribute == "vertex_color" else 1))
        params = mi.traverse(mesh)
        params["vertex_positions"], params["faces"] = [0, 0, 0, 1, 0, 0, 0, 1, 0], [0, 1, 2]
        params.update()
        return ball(paper=mesh)

    with pytest.raises(ValueError, match=rf"reflectance \({attribute}\) of 'paper' must lie in 0..1 .*0.2..3"):
        build_scene(painted(3.0, 1.0), mi)
    with pytest.raises(ValueError, match="base_color .* of 'paper' must lie in 0..1 .*0.4..1.8"):
        build_scene(painted(0.9, 2.0, "principled", "base_color"), mi)
    assert build_scene(painted(3.0, 0.3), mi).shapes == ("ball", "paper")
    assert build_scene(painted(3.0, 1.0, "roughconductor", "alpha"), mi).shapes == ("ball", "paper")  # no share
    paint = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": attribute}}
    assert build_scene(ball(ball={"type": "sphere", "bsdf": paint, attribute: bitmap(mi, 0.9)}), mi).shapes == ("ball",)
    with pytest.raises(ValueError, match=rf"reflectance \({attribute}\) of 'ball' must lie in 0..1"):
        build_scene(ball(ball={"type": "sphere", "bsdf": paint, attribute: bitmap(mi, 1.5)}), mi)
    assert build_scene(ball(ball={"type": "sphere", "bsdf": paint}), mi).shapes == ("ball",)  # Mitsuba's own matter


def scaled(size: float, far: float) -> dict[str, Any]:
    """A ball over a ground under a lamp: the same picture in every size and place."""
    from simscenes import activate

    place = activate().ScalarTransform4f().translate([far, 0, 0]).scale(size)
    ground = place.translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(3)
    light = {"type": "rgb", "value": 10 * size**2}
    lamp = {"type": "point", "position": [far + 2 * size, 4 * size, 3 * size], "intensity": light}
    shapes = {"ball": {"type": "sphere", "to_world": place}, "ground": {"type": "rectangle", "to_world": ground}}
    return {"type": "scene", **shapes, "lamp": lamp}


def picture(size: float, far: float) -> np.ndarray:
    mi = activate()
    origin, target = [far + size, 2 * size, 5 * size], [far, 0, 0]
    film = {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": "box"}}
    sensor = {
        "type": "perspective", "fov": 40, "film": film, "near_clip": 1e-3 * size, "far_clip": 1e3 * size,
        "to_world": mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0]),
    }  # fmt: skip
    path = mi.load_dict({"type": "path", "max_depth": 8})
    seen = mi.render(mi.load_dict(scaled(size, far)), sensor=mi.load_dict(sensor), integrator=path, spp=256, seed=1)
    return np.array(seen, dtype=np.float64)


def test_rays_that_start_off_the_surface_are_said_in_proportion_to_what_they_spoil(tmp_path: Path) -> None:
    """A scene in small units or far away renders wrongly by its share of the offset: said, or refused."""
    exact = picture(100.0, 0.0)
    for size, far, share in ((1e-3, 0.0, 1.03e-2), (1.0, 1000.0, 1.03e-2), (1.0, 300.0, 3.1e-3), (1e-2, 0.0, 1.06e-3)):
        loaded = activate().load_dict(scaled(size, far))
        box = loaded.bbox()
        extent = float(np.linalg.norm(np.array(box.extents())))
        assert offset_share(loaded, extent) == pytest.approx(share, rel=0.02)
        wrong = np.abs(picture(size, far) - exact).mean() / exact.mean()
        assert 0.5 * share < wrong < 2 * share
    for size, far in ((1e-3, 0.0), (1e-4, 0.0), (1.0, 1e4)):
        with pytest.raises(ValueError, match=r"start rays .* of the scene's size off its surfaces.*scale it"):
            build_scene(scaled(size, far), activate())
    rig = Rig(
        viewmats=np.stack([look_at([0, 0.02, 0.05 + k / 1000], [0, 0, 0], [0, 1, 0]) for k in range(3)]),
        Ks=np.stack([intrinsics(8, 8, 40.0)] * 3), width=8, height=8,
    )  # fmt: skip
    with (
        pytest.warns(UserWarning, match=r"starts rays 0.11% of the scene's size off its surfaces"),
        pytest.warns(UserWarning, match=r"depths/\*.png.* few steps"),
    ):
        render_set(scaled(1e-2, 0.0), rig, tmp_path / "small", spp=2)


def test_places_and_angles_may_be_negative() -> None:
    mi = activate()
    lamp = {"type": "point", "position": [-1, -2, -3], "intensity": 2.0}
    sun = {"type": "sunsky", "latitude": -30.0, "longitude": -70.0}
    assert build_scene(ball(sky=sun, lamp=lamp), mi).shapes == ("ball",)


def test_a_camera_inside_an_object_is_refused_by_its_name(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="inside of 'ball'"):
        render_set(ball(), rig_at((0.1, 0.2, 0.0)), tmp_path, spp=4, plan="rgb")
    paper = {"type": "twosided", "bsdf": {"type": "diffuse"}}
    room = ball(ball={"type": "sphere", "bsdf": paper}, lamp={"type": "point", "position": [0, 0, 0.5]})
    assert render_set(room, rig_at((0.1, 0.2, 0.0)), tmp_path, spp=4, plan="rgb").radiance(0).mean() > 0


def test_darkness_is_a_correct_picture(tmp_path: Path) -> None:
    dark = {"type": "scene", "ball": {"type": "sphere"}}
    with pytest.warns(UserWarning, match="scene 'custom' has no emitter: every picture is black"):
        done = render_set(dark, rig_at((0, -4, 1)), tmp_path, spp=4)
    assert not done.radiance(0).any()
    assert not done.image(0).any()
    assert done.meta["exposure_scale"] == 1.0
    assert done.meta["views"]["0000"]["relative_error"] == 0.0


def test_a_view_of_nothing_has_no_points_and_infinite_depth(tmp_path: Path) -> None:
    done = render_set(ball(), rig_at((0, -4, 1), (0, -9, 1)), tmp_path, spp=4, plan="rgb")
    geometry = done.geometry(0)
    assert geometry is not None
    assert np.isinf(geometry["z"]).all()
    assert done.points() is None
    assert (done.radiance(0) == 1).all()


def test_a_scene_without_sensor_needs_a_rig() -> None:
    with pytest.raises(ValueError, match="perspective"):
        fit_rig(ball(), 3)


def test_a_film_that_would_take_all_memory_is_refused(tmp_path: Path) -> None:
    path = write_scene(tmp_path)
    path.write_text(path.read_text().replace('value="24"', 'value="10000000"'))
    with pytest.raises(ValueError, match="film"):
        fit_rig(path, 3)
    assert fit_rig(path, 3, 8, 6).width == 8
