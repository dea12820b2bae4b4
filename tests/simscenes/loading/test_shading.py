"""Faults that Mitsuba's wide variants answer with 0 or a wrong place; and mirrored shapes, which are none."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from simscenes.backend import activate, using_variant
from simscenes.loading.load import build_scene
from simscenes.render.geometry import check_cameras, geometry_channels
from simscenes.rigs import orbit_rig

CORNERS = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
TRIANGLES = [(3, 0, 1, 2), (3, 0, 2, 3)]
WHITE = '<emitter type="constant"><rgb name="radiance" value="1"/></emitter>'
PICTURE = '<texture type="bitmap" name="{}"><string name="filename" value="t.png"/></texture>'
RAW = PICTURE.replace("</texture>", '<boolean name="raw" value="true"/></texture>')
CHECKS = '<texture type="checkerboard" name="{}"/>'
MIRROR = '<transform name="to_world"><scale x="-1" y="1" z="1"/></transform>'


@pytest.fixture(autouse=True)
def nothing_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def scene(folder: Path, body: str) -> Path:
    (folder / "scene.xml").write_text(f'<scene version="3.0.0">{body}</scene>')
    return folder / "scene.xml"


def ply(
    folder: Path, vertex: Sequence[str] = (), face: Sequence[str] = (), faces=TRIANGLES, kind: str = "float"
) -> None:
    """A square whose vertices or faces have properties, all with these values."""

    def named(values):
        return [f"property {kind} {pair.split('=')[0]}" for pair in values]

    def of(values):
        return [pair.split("=")[1] for pair in values]

    rows = [" ".join([*map(str, corner), *of(vertex)]) for corner in CORNERS]
    rows += [" ".join([*map(str, corners), *of(face)]) for corners in faces]
    (folder / "m.ply").write_text("\n".join([
        "ply", "format ascii 1.0", "element vertex 4", *(f"property float {axis}" for axis in "xyz"), *named(vertex),
        f"element face {len(faces)}", "property list uchar int vertex_indices", *named(face), "end_header", *rows, "",
    ]))  # fmt: skip


def coloured(attribute: str, slot: str = "reflectance", bsdf: str = "diffuse") -> str:
    texture = f'<texture type="mesh_attribute" name="{slot}"><string name="name" value="{attribute}"/></texture>'
    return (f'<shape type="ply" id="m"><string name="filename" value="m.ply"/><bsdf type="{bsdf}">{texture}</bsdf>'
            f"</shape>{WHITE}")  # fmt: skip


def light_in_the_middle(file: Path) -> np.ndarray:
    """Radiance of the square, seen from above in a narrow view."""
    mi = activate()
    loaded = build_scene(file, mi)
    sensor = mi.load_dict({
        "type": "perspective", "fov": 5, "film": {"type": "hdrfilm", "width": 4, "height": 4, "pixel_format": "rgb"},
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
    })  # fmt: skip
    return np.array(mi.render(loaded.scene, sensor=sensor, integrator=mi.load_dict({"type": "path"}), spp=256)).mean(
        (0, 1)
    )


RGB = ("red=0.2", "green=0.5", "blue=0.8")


def test_colours_of_faces_and_vertices_are_seen_as_they_are(tmp_path: Path) -> None:
    for attribute, properties in (("face_color", {"face": RGB}), ("vertex_color", {"vertex": RGB})):
        ply(tmp_path, **properties)
        found = light_in_the_middle(scene(tmp_path, coloured(attribute)))
        np.testing.assert_allclose(found, [0.2, 0.5, 0.8], rtol=0.03)


@pytest.mark.parametrize(
    ("attribute", "slot", "bsdf", "properties", "said"),
    [
        ("face_color", "reflectance", "diffuse", {"face": (*RGB, "alpha=1")}, 'had size 4.*leave out alpha'),
        ("vertex_color", "reflectance", "diffuse", {"vertex": (*RGB, "alpha=1")}, 'had size 4.*leave out alpha'),
        ("vertex_color", "reflectance", "diffuse", {}, "has no such values for its vertices or faces"),
        ("vertex_color", "alpha", "roughconductor", {"vertex": RGB}, "had size 3.*other values have one"),
        ("face_color", "opacity", "mask", {"face": RGB}, "had size 3.*other values have one"),
    ],
    ids=["faces with alpha", "vertices with alpha", "none at all", "roughness of three", "opacity of three"],
)  # fmt: skip
@pytest.mark.parametrize("trusted", [False, True])
def test_values_of_a_mesh_that_a_material_cannot_use_are_refused_before_the_render(
    attribute: str,
    slot: str,
    bsdf: str,
    properties: dict[str, tuple[str, ...]],
    said: str,
    trusted: bool,
    tmp_path: Path,
) -> None:
    ply(tmp_path, **properties)
    body = coloured(attribute, slot, bsdf)
    if bsdf == "mask":
        body = body.replace("</bsdf>", '<bsdf type="diffuse"/></bsdf>')
    with pytest.raises(ValueError, match=f"shape 'm' cannot be shaded, and would be black: .*{said}"):
        build_scene(scene(tmp_path, body), activate(), allow_outside=trusted)


@pytest.mark.parametrize(("kind", "refused"), [(PICTURE, True), (RAW, False)])
def test_a_picture_of_normals_that_is_read_as_colours_is_refused_with_the_line_to_add(
    kind: str, refused: bool, tmp_path: Path
) -> None:
    """Where it is the same everywhere, Mitsuba refuses it in no variant of RGB."""
    cv2.imwrite(str(tmp_path / "t.png"), np.full((8, 8, 3), (255, 128, 128), np.uint8))
    bsdf = f'<bsdf type="normalmap">{kind.format("normalmap")}<bsdf type="diffuse"/></bsdf>'
    file = scene(tmp_path, f'<shape type="rectangle">{bsdf}</shape>{WHITE}')
    if not refused:
        assert build_scene(file, activate()).shapes
        return
    with pytest.raises(ValueError, match=r'read as colours: .* add <boolean name="raw" value="true"/>'):
        build_scene(file, activate())


def test_a_lamp_of_colours_of_its_mesh_is_refused_since_it_would_light_nothing_rightly(tmp_path: Path) -> None:
    ply(tmp_path, vertex=RGB)
    radiance = '<texture type="mesh_attribute" name="radiance"><string name="name" value="vertex_color"/></texture>'
    lamp = f'<string name="filename" value="m.ply"/><emitter type="area">{radiance}</emitter>'
    with pytest.raises(ValueError, match="a lamp whose radiance is a 'mesh_attribute'.* is too dark"):
        build_scene(scene(tmp_path, f'<shape type="ply">{lamp}</shape>'), activate())


@pytest.mark.parametrize("opacity", [0.5, 1.0])
def test_a_lamp_with_holes_is_said_to_light_all_else_as_if_it_had_none(opacity: float, tmp_path: Path) -> None:
    lamp = (f'<shape type="rectangle" id="sign"><bsdf type="mask"><float name="opacity" value="{opacity}"/><bsdf '
            'type="diffuse"/></bsdf><emitter type="area"/></shape>')  # fmt: skip
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        build_scene(scene(tmp_path, lamp), activate())
    assert [str(line.message)[:42] for line in said] == ["the lamp 'sign' has an opacity (in glTF an"] * (opacity < 1)


def test_colours_of_eight_bits_are_refused_with_the_likely_cause(tmp_path: Path) -> None:
    ply(tmp_path, vertex=("red=51", "green=128", "blue=204"), kind="uchar")
    with pytest.raises(ValueError, match=r"got 51\.\.204: codes of 8 bits, which Mitsuba takes as they are"):
        build_scene(scene(tmp_path, coloured("vertex_color")), activate())


def test_faces_of_four_corners_are_refused_with_the_way_out(tmp_path: Path) -> None:
    ply(tmp_path, faces=[(4, 0, 1, 2, 3)])
    with pytest.raises(ValueError, match="triangles alone.*triangulate it"):
        build_scene(scene(tmp_path, '<shape type="ply"><string name="filename" value="m.ply"/></shape>'), activate())


def square(inside: str, uv: bool, folder: Path, size: int = 8) -> str:
    """A square with or without texture coordinates, and a texture of two colours beside it."""
    places = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n" if uv else "f 1 2 3\nf 1 3 4\n"
    (folder / "m.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + places)
    picture = np.full((size, size, 3), 40, np.uint8)
    picture[:, size // 2 :] = 200
    cv2.imwrite(str(folder / "t.png"), picture)
    return f'<shape type="obj" id="m"><string name="filename" value="m.obj"/>{inside}</shape>{WHITE}'


TEXTURED = {
    "reflectance": f'<bsdf type="diffuse">{PICTURE.format("reflectance")}</bsdf>',
    "radiance": f'<emitter type="area">{PICTURE.format("radiance")}</emitter>',
    "alpha": f'<bsdf type="twosided"><bsdf type="roughconductor">{PICTURE.format("alpha")}</bsdf></bsdf>',
    "opacity": f'<bsdf type="mask">{PICTURE.format("opacity")}<bsdf type="diffuse"/></bsdf>',
    "weight": f'<bsdf type="blendbsdf">{PICTURE.format("weight")}<bsdf type="diffuse"/><bsdf type="conductor"/></bsdf>',
    "base_color": f'<bsdf type="principled">{CHECKS.format("base_color")}</bsdf>',
    "normalmap": f'<bsdf type="normalmap">{RAW.format("normalmap")}<bsdf type="diffuse"/></bsdf>',
}  # fmt: skip


@pytest.mark.parametrize("slot", TEXTURED)
def test_a_texture_needs_a_mesh_that_says_where_it_lies(slot: str, tmp_path: Path) -> None:
    mi = activate()
    assert build_scene(scene(tmp_path, square(TEXTURED[slot], True, tmp_path)), mi).shapes == ("m",)
    with pytest.raises(
        ValueError, match=f"mesh 'm' has no texture coordinates, and its {slot} is a texture that needs"
    ):
        build_scene(scene(tmp_path, square(TEXTURED[slot], False, tmp_path)), mi)


def test_the_same_of_a_scene_that_is_no_file(tmp_path: Path) -> None:
    square("", False, tmp_path)
    texture = {"type": "bitmap", "filename": str(tmp_path / "t.png")}
    mesh = {"type": "obj", "filename": str(tmp_path / "m.obj"), "bsdf": {"type": "diffuse", "reflectance": texture}}
    with pytest.raises(ValueError, match="mesh 'mesh' has no texture coordinates"):
        build_scene({"type": "scene", "mesh": mesh}, activate())


def test_a_texture_of_one_pixel_needs_no_place(tmp_path: Path) -> None:
    file = scene(tmp_path, square(TEXTURED["reflectance"], False, tmp_path, size=1))
    code = 200 / 255
    np.testing.assert_allclose(light_in_the_middle(file), ((code + 0.055) / 1.055) ** 2.4, rtol=0.03)


GREY = '<bsdf type="diffuse"><rgb name="reflectance" value=".5"/></bsdf>'
LAMP = '<emitter type="area"><rgb name="radiance" value="3"/></emitter>'
WITH_NORMALS = "vn 0 0 1\nf 1//1 2//1 3//1\nf 1//1 3//1 4//1\n"
MESH = '<shape type="obj"><string name="filename" value="m.obj"/>{}</shape>'
MIRRORED = {  # its shapes and lights, and its radiance
    "rectangle": (f'<shape type="rectangle">{MIRROR}{GREY}</shape>{WHITE}', 0.5),
    "mesh with normals": (MESH.format(MIRROR + GREY) + WHITE, 0.5),
    "lamp": (f'<shape type="rectangle">{MIRROR}{LAMP}</shape>', 3.0),
    "instance": (
        f'<shape type="shapegroup" id="g">{MESH.format(GREY)}</shape><shape type="instance"><ref id="g"/>{MIRROR}'
        f"</shape>{WHITE}",
        0.5,
    ),
}


def looking_down(size: int = 16):
    """Two cameras that the square fills."""
    return orbit_rig(2, size, size, 20.0, radius=3.0, elevation_deg=80, swing_deg=0)


@pytest.mark.parametrize("kind", MIRRORED)
def test_mirrored_shapes_are_bright_where_mitsuba_has_them_bright_and_their_normals_face_the_camera(
    kind: str, tmp_path: Path
) -> None:
    body, radiance = MIRRORED[kind]
    (tmp_path / "m.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + WITH_NORMALS)
    file, mi = scene(tmp_path, body), activate()
    np.testing.assert_allclose(light_in_the_middle(file), radiance, rtol=0.03)
    loaded, rig = build_scene(file, mi), looking_down()
    check_cameras(mi, loaded, rig)
    channels = geometry_channels(mi, loaded, rig, 0)
    for name in ("N", "Ng"):
        np.testing.assert_allclose([channels[f"{name}.{axis}"][8, 8] for axis in "XYZ"], [0, 0, 1], atol=1e-5)
    with using_variant("scalar") as scalar:
        check_cameras(scalar, build_scene(file, scalar), rig)


def test_a_mirrored_mesh_without_normals_is_black_from_above_as_mitsuba_has_it_and_refused(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "f 1 2 3\nf 1 3 4\n")
    file, mi = scene(tmp_path, MIRRORED["mesh with normals"][0]), activate()
    np.testing.assert_array_equal(light_in_the_middle(file), 0)
    with pytest.raises(ValueError, match="sees the inside of"):
        check_cameras(mi, build_scene(file, mi), looking_down())
