"""glTF scenes against hand-written Mitsuba scenes of the same content, and what is refused by its name."""

import json
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sensor_model.files.door import allow, given
from simscenes.backend import activate
from simscenes.loading.gltf.document import read_document
from simscenes.loading.load import build_scene, load_here
from simscenes.loading.reference import SceneRef
from tests.simscenes.loading.gltf.writer import SQUARE, UV, GltfWriter, floor

pytest.importorskip("pygltflib", reason="the extra gltf is not installed")

CODES = np.array([[[200, 60, 30], [30, 160, 220]], [[90, 90, 90], [250, 240, 20]]], np.uint8)  # red first
PICTURE = CODES.repeat(8, 0).repeat(8, 1)
WHITE = {"type": "constant", "radiance": 1.0}
ROUGH = {"metallicFactor": 0, "roughnessFactor": 1}


@pytest.fixture(autouse=True)
def nothing_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def linear(codes: Any) -> np.ndarray:
    share = np.asarray(codes) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def render(scene: Any, light: dict[str, Any] | None = WHITE, size: int = 16, spp: int = 512) -> np.ndarray:
    """A picture from straight above, the square filling it; the x axis to the right, y up."""
    mi = activate()
    inside = scene if not isinstance(scene, Path) else build_scene(scene, mi).scene
    if isinstance(scene, dict):
        inside = mi.load_dict({"type": "scene", **scene})
    lit = inside
    if light is not None:
        parts = {f"s{k}": shape for k, shape in enumerate(inside.shapes())}
        lit = mi.load_dict({"type": "scene", **parts, "more": light})
    sensor = mi.load_dict({
        "type": "orthographic", "film": {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb",
                                         "rfilter": {"type": "box"}},
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
    })  # fmt: skip
    return np.array(mi.render(lit, sensor=sensor, integrator=mi.load_dict({"type": "path"}), spp=spp), np.float64)


def principled(color: Any, roughness: float, metallic: float = 0.0) -> dict[str, Any]:
    """The square by hand, painted so."""
    base = {"type": "rgb", "value": list(map(float, color))}
    bsdf = {"type": "principled", "base_color": base, "roughness": roughness, "metallic": metallic, "eta": 1.5}
    return {"square": {"type": "rectangle", "bsdf": {"type": "twosided", "bsdf": bsdf}}}


def test_a_red_floor_has_the_light_of_the_same_in_mitsuba(tmp_path: Path) -> None:
    material = {
        "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.2, 0.1, 1], "metallicFactor": 0, "roughnessFactor": 0.7}
    }
    expected = render(principled([0.8, 0.2, 0.1], 0.7))  # fmt: skip
    for name in ("floor.glb", "floor.gltf"):
        found = render(floor(material).write(tmp_path / name))
        np.testing.assert_allclose(found.mean((0, 1)), expected.mean((0, 1)), rtol=0.01)


def test_a_texture_lies_the_right_way_up_times_its_factor(tmp_path: Path) -> None:
    writer = floor({})
    texture = {"index": writer.texture(PICTURE, magFilter=9728)}
    pbr = {"baseColorTexture": texture, "baseColorFactor": [0.5, 1, 1, 1], **ROUGH}
    writer.content["materials"][0]["pbrMetallicRoughness"] = pbr
    found = render(writer.write(tmp_path / "t.glb"))
    # The first row of the picture is the far end, up in the view.
    for rows, row in ((slice(2, 6), 0), (slice(10, 14), 1)):
        for columns, column in ((slice(2, 6), 0), (slice(10, 14), 1)):
            color = linear(CODES[row, column]) * [0.5, 1, 1]
            same = render(principled(color.tolist(), 1.0), size=4)  # fmt: skip
            np.testing.assert_allclose(found[rows, columns].mean((0, 1)), same.mean((0, 1)), rtol=0.03, atol=0.003)


TRANSFORMS = ({"offset": [0.5, 0]}, {"scale": [0.5, 0.5]}, {"rotation": math.pi / 2},
              {"offset": [0.5, 0], "scale": [1, -1], "rotation": -math.pi / 2})  # fmt: skip


@pytest.mark.parametrize("transform", TRANSFORMS)
def test_a_transform_of_a_texture_is_as_the_extension_says(transform: dict[str, Any], tmp_path: Path) -> None:
    writer = floor({})
    info = {"index": writer.texture(PICTURE, magFilter=9728), "extensions": {"KHR_texture_transform": transform}}
    writer.content["materials"][0] = {"emissiveFactor": [1, 1, 1], "emissiveTexture": info}
    found = render(writer.write(tmp_path / "t.glb"), light=None)
    # By the extension's own matrices, at the middle of each quarter.
    turn, (sx, sy), (x, y) = (
        transform.get("rotation", 0),
        transform.get("scale", (1, 1)),
        transform.get("offset", (0, 0)),
    )
    for i, row in enumerate((slice(2, 6), slice(10, 14))):
        for j, column in enumerate((slice(2, 6), slice(10, 14))):
            u, v = 0.25 + 0.5 * j, 0.25 + 0.5 * i
            u, v = u * sx, v * sy
            u, v = u * math.cos(turn) + v * math.sin(turn) + x, -u * math.sin(turn) + v * math.cos(turn) + y
            cell = int(v % 1 * 2), int(u % 1 * 2)
            np.testing.assert_allclose(found[row, column].mean((0, 1)), linear(CODES[cell]), rtol=0.01, atol=0.002)


def test_roughness_is_green_and_metallic_blue(tmp_path: Path) -> None:
    packed = np.zeros((4, 4, 3), np.uint8)
    packed[:] = (17, 128, 255)
    writer = floor({})
    pbr = {"metallicRoughnessTexture": {"index": writer.texture(packed)}, "baseColorFactor": [0.9, 0.6, 0.3, 1],
           "roughnessFactor": 0.8}  # fmt: skip
    writer.content["materials"][0]["pbrMetallicRoughness"] = pbr
    lamp = {"type": "directional", "direction": [0.3, 0, -1], "irradiance": 3.0}
    found = render(writer.write(tmp_path / "t.glb"), light=lamp)
    same = render(principled([0.9, 0.6, 0.3], 0.8 * 128 / 255, metallic=1.0), light=lamp)  # fmt: skip
    np.testing.assert_allclose(found.mean((0, 1)), same.mean((0, 1)), rtol=0.01)


def bumpy(uv: np.ndarray) -> GltfWriter:
    """The square with normals that lean to the right and up in the picture."""
    picture = np.tile(np.round((TILT + 1) * 127.5).astype(np.uint8), (4, 4, 1))
    writer = floor({"pbrMetallicRoughness": ROUGH}, uv=False, TEXCOORD_0=uv)
    writer.content["materials"][0]["normalTexture"] = {"index": writer.texture(picture)}
    return writer


TILT = np.array([0.4, 0.3, math.sqrt(0.75)])


def test_a_normal_map_tilts_the_surface_to_the_right_and_to_the_far_end(tmp_path: Path) -> None:
    file, flat = bumpy(UV).write(tmp_path / "t.glb"), floor({"pbrMetallicRoughness": ROUGH}).write(tmp_path / "f.glb")
    for direction in ([-0.5, 0, -1], [0.5, 0, -1], [0, -0.5, -1], [0, 0.5, -1]):
        lamp = {"type": "directional", "direction": direction, "irradiance": 3.0}
        toward = -np.array(direction) / np.linalg.norm(direction)
        share = render(file, light=lamp).mean() / render(flat, light=lamp).mean()
        # Nearly Lambertian: the light goes with the cosine to the normal, and only a little with other angles.
        assert share == pytest.approx((TILT @ toward) / toward[2], rel=0.12)


def test_a_normal_map_that_lies_mirrored_is_said(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="the normal map of floor lies mirrored on 100% of its faces"):
        build_scene(bumpy((UV * [-1, 1]).astype("<f4")).write(tmp_path / "t.glb"), activate())


def test_colours_of_vertices_are_linear_and_multiply(tmp_path: Path) -> None:
    colors = np.tile(np.array([[0.5, 0.25, 1.0]], "<f4"), (4, 1))
    material = {
        "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.8, 0.4, 1], "metallicFactor": 0, "roughnessFactor": 1}
    }
    found = render(floor(material, COLOR_0=colors).write(tmp_path / "t.glb"))
    same = render(principled([0.4, 0.2, 0.4], 1.0))  # fmt: skip
    np.testing.assert_allclose(found.mean((0, 1)), same.mean((0, 1)), rtol=0.01)


def test_normalised_integers_are_shares(tmp_path: Path) -> None:
    writer = GltfWriter()
    writer.mesh({"POSITION": SQUARE})
    attributes = writer.content["meshes"][0]["primitives"][0]["attributes"]
    attributes["COLOR_0"] = writer.accessor(np.full((4, 4), 255, np.uint8), normalized=True)
    assert build_scene(writer.write(tmp_path / "t.glb"), activate()).shapes == ("floor",)
    attributes["COLOR_0"] = writer.accessor(np.full((4, 4), 255, np.uint8))
    with pytest.raises(ValueError, match="colours of floor must be 3 or 4 numbers in 0..1"):
        build_scene(writer.write(tmp_path / "t.glb"), activate())


def test_emission_is_in_nits_and_a_mirrored_lamp_shines_to_the_same_side(tmp_path: Path) -> None:
    material = {
        "emissiveFactor": [1, 0.5, 0],
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 7}},
    }
    writer = floor(material)
    writer.content["extensionsUsed"] = ["KHR_materials_emissive_strength"]
    np.testing.assert_allclose(
        render(writer.write(tmp_path / "t.glb"), light=None).mean((0, 1)), [7, 3.5, 0], rtol=1e-4
    )
    writer.content["nodes"][0]["scale"] = [-1, 1, 1]
    np.testing.assert_allclose(
        render(writer.write(tmp_path / "t.glb"), light=None).mean((0, 1)), [7, 3.5, 0], rtol=1e-4
    )
    del writer.content["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
    np.testing.assert_allclose(
        render(writer.write(tmp_path / "t.glb"), light=None).mean((0, 1)), [7, 3.5, 0], rtol=1e-4
    )


LAMBERT = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1], "metallicFactor": 0, "roughnessFactor": 1}}
LIGHTS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {  # in glTF; the same for Mitsuba, 2 m above the middle
    "point": ({"type": "point", "intensity": 30, "color": [1, 0.5, 0.25]},
              {"type": "point", "position": [0, 0, 2], "intensity": {"type": "rgb", "value": [30, 15, 7.5]}}),
    "directional": ({"type": "directional", "intensity": 4},
                    {"type": "directional", "direction": [0, 0, -1], "irradiance": 4.0}),
    "spot": ({"type": "spot", "intensity": 30, "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.3}}, {}),
}  # fmt: skip


@pytest.mark.parametrize("kind", LIGHTS)
@pytest.mark.filterwarnings("ignore:.*falls off as Mitsuba's spot")
def test_lights_shine_as_the_same_in_mitsuba(kind: str, tmp_path: Path) -> None:
    light, hand = LIGHTS[kind]
    writer = floor(LAMBERT)
    writer.content["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    down = {"rotation": [-math.sqrt(0.5), 0, 0, math.sqrt(0.5)], "translation": [0, 2, 0]}  # -z turned down
    writer.content["nodes"].append({"name": "lamp", **down, "extensions": {"KHR_lights_punctual": {"light": 0}}})
    writer.content["scenes"][0]["nodes"] = [0, 1]
    if kind == "spot":
        mi = activate()
        above = mi.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0])
        hand = {
            "type": "spot",
            "to_world": above,
            "intensity": 30.0,
            "cutoff_angle": math.degrees(0.3),
            "beam_width": math.degrees(0.2),
        }
    found = render(writer.write(tmp_path / "t.glb"), light=None)
    same = render(principled([0.5] * 3, 1.0), light=hand)  # fmt: skip
    assert same.max() > 0.1
    np.testing.assert_allclose(found, same, rtol=0.05, atol=0.02 * same.max())


def test_cameras_stand_and_look_as_the_file_says(tmp_path: Path) -> None:
    writer = floor({"emissiveFactor": [1, 1, 1]})
    writer.content["cameras"] = [
        {"type": "perspective", "perspective": {"yfov": 0.6, "aspectRatio": 1.5, "znear": 0.1}}
    ]
    down = [-math.sqrt(0.5), 0, 0, math.sqrt(0.5)]
    writer.content["nodes"] += [{"translation": [0, 4, 0], "children": [2], "scale": [3, 3, 3]}]
    writer.content["nodes"] += [{"camera": 0, "name": "eye", "rotation": down}]
    writer.content["scenes"][0]["nodes"] = [0, 1]
    mi = activate()
    (sensor,) = build_scene(writer.write(tmp_path / "t.glb"), mi).scene.sensors()
    place = np.array(sensor.world_transform().matrix).reshape(4, 4)
    np.testing.assert_allclose(place[:3, 3], [0, 0, 4], atol=1e-6)  # 4 m up, in the axes here
    np.testing.assert_allclose(place[:3, 2], [0, 0, -1], atol=1e-6)  # looks down
    np.testing.assert_allclose(place[:3, 1], [0, 1, 0], atol=1e-6)  # the far end of the floor is up
    width, height = sensor.film().crop_size()
    assert width / height == pytest.approx(1.5)
    fov = float(mi.traverse(sensor)["x_fov"][0])
    assert math.tan(math.radians(fov) / 2) == pytest.approx(1.5 * math.tan(0.3), rel=1e-4)


def test_alpha_cuts_or_blends(tmp_path: Path) -> None:
    picture = np.zeros((8, 8, 4), np.uint8)
    picture[..., :3], picture[:, :4, 3], picture[:, 4:, 3] = 255, 64, 192
    for mode, shares in (("OPAQUE", (1, 1)), ("MASK", (0, 1)), ("BLEND", (64 / 255, 192 / 255))):
        writer = floor({})
        writer.content["materials"][0] = {
            "alphaMode": mode, "emissiveFactor": [0, 0, 0],
            "pbrMetallicRoughness": {"baseColorTexture": {"index": writer.texture(picture, magFilter=9728)}, **ROUGH},
        }  # fmt: skip
        below = {"type": "rectangle", "to_world": None, "emitter": {"type": "area", "radiance": 10.0}}
        mi = activate()
        below["to_world"] = mi.ScalarTransform4f().translate([0, 0, -1]).scale(3)
        found = render(writer.write(tmp_path / "t.glb"), light=below)
        for columns, share in ((slice(2, 6), shares[0]), (slice(10, 14), shares[1])):
            assert found[4:12, columns].mean() == pytest.approx(10 * (1 - share), rel=0.05, abs=0.1)


def change(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    """Sets one value in a file's JSON."""

    def at(content: dict[str, Any]) -> None:
        *above, last = [int(key) if key.isdigit() else key for key in path.split("/")]
        for key in above:
            content = content.setdefault(key, {}) if isinstance(content, dict) else content[key]
        content[last] = value  # type: ignore[index]

    return at


REFUSED = [
    ("nodes/0/skin", 0, r"nodes\[0\] \(floor\) sets 'skin', which is not understood"),
    ("meshes/0/primitives/0/targets", [{"POSITION": 0}], r"meshes\[0\], primitives\[0\] sets 'targets'"),
    ("meshes/0/primitives/0/attributes/JOINTS_0", 0, r"primitives\[0\], attributes sets 'JOINTS_0'"),
    ("meshes/0/primitives/0/mode", 1, "floor is drawn in mode 1: triangles"),
    ("meshes/0/primitives/0/extensions", {"KHR_draco_mesh_compression": {}}, "extensions sets 'KHR_draco_mesh_comp"),
    ("accessors/0/sparse", {"count": 1}, r"accessors\[0\] sets 'sparse'"),
    ("materials/0/extensions", {"KHR_materials_unlit": {}}, r"materials\[0\], extensions sets 'KHR_materials_unlit'"),
    (
        "materials/0/extensions",
        {"KHR_materials_transmission": {"transmissionFactor": 0.5}},
        "KHR_materials_transmission",
    ),
    ("materials/0/extensions", {"KHR_materials_specular": {"specularFactor": 0.5}}, "KHR_materials_specular"),
    ("materials/0/alphaMode", "GLASS", "alphaMode must be one of"),
    *[
        ("materials/0/pbrMetallicRoughness/baseColorFactor", factor, r"baseColorFactor must be 4 numbers in 0\.\.1")
        for factor in ([2, 0, 0, 1], [0, 0, 2, 1], [0, 0, 0, 2])
    ],
    ("materials/0/pbrMetallicRoughness/roughnessFactor", 1.5, r"roughnessFactor must lie in 0\.\.1, got 1.5"),
    ("extensionsRequired", ["KHR_draco_mesh_compression"], "requires the extension 'KHR_draco_mesh_compression'"),
    ("cameraRig", {"a": 1}, "t.glb sets 'cameraRig'"),
    ("nodes/0/mesh", 7, "node 0|floor names number 7 of 1 meshes"),
    ("nodes/0/children", [0], "hold each other in a circle"),
    ("nodes/0/rotation", [0, 0, 0, 2], "rotation of node 0 must be a unit quaternion"),
    ("accessors/0/count", 1000, "1000 entries from byte 0 do not fit"),
    ("buffers/0/uri", "../secret.bin", "outside its folder"),
    ("buffers/0/uri", "https://example.org/a.bin", "nothing is fetched"),
    ("asset/version", "1.0", "must be glTF 2.0, got version '1.0'"),
    ("nodes/0/scale", 3, r"nodes\[0\].scale must be 3 finite numbers, got 3"),
    ("materials", {"a": 1}, "materials must be a list"),
    ("buffers/0/uri", "gone.bin", "names 'gone.bin', which cannot be read"),
]


@pytest.mark.parametrize(("path", "value", "said"), REFUSED)
def test_a_file_with_something_that_is_not_understood_is_refused_by_its_name(
    path: str, value: Any, said: str, tmp_path: Path
) -> None:
    writer = floor(json.loads(json.dumps(LAMBERT)))
    change(path, value)(writer.content)
    with pytest.raises(ValueError, match=said):
        load_here(SceneRef.of(writer.write(tmp_path / "t.glb")), activate())


HARMLESS = [
    ("nodes/0/extras", {"anything": 1}), ("materials/0/occlusionTexture", {"index": 0}), ("skins", [{"joints": [0]}]),
    ("materials/0/extensions", {"KHR_materials_specular": {"specularFactor": 1}, "KHR_materials_ior": {"ior": 1.5}}),
    ("materials/0/doubleSided", True), ("meshes/0/primitives/0/mode", 4),
    ("meshes/0/primitives/0/extensions", {"KHR_materials_variants": {"mappings": [{"material": 0, "variants": [0]}]}}),
    ("extensions", {"KHR_materials_variants": {"variants": [{"name": "night"}]}, "KHR_xmp_json_ld": {"packets": []}}),
]  # fmt: skip


@pytest.mark.parametrize(("path", "value"), HARMLESS)
def test_what_changes_no_picture_is_let_pass(path: str, value: Any, tmp_path: Path) -> None:
    writer = floor(json.loads(json.dumps(LAMBERT)))
    change(path, value)(writer.content)
    assert build_scene(writer.write(tmp_path / "t.glb"), activate()).shapes == ("floor",)


def test_a_lamp_that_wants_to_shine_from_both_sides_is_said_where_its_back_can_be_seen(tmp_path: Path) -> None:
    lamp = {"emissiveFactor": [1, 1, 1], "doubleSided": True}
    with pytest.warns(UserWarning, match="floor shines from its front alone"):
        build_scene(floor(lamp).write(tmp_path / "a.glb"), activate())
    writer = GltfWriter()
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], "<f4")
    part = {"attributes": {"POSITION": writer.accessor(corners)}, "material": 0,
            "indices": writer.accessor(np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], "<u2"))}  # fmt: skip
    writer.content |= {"meshes": [{"primitives": [part]}], "materials": [lamp]}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        build_scene(writer.write(tmp_path / "b.glb"), activate())


def test_animations_and_ranges_of_lamps_are_said(tmp_path: Path) -> None:
    writer = floor()
    writer.content["animations"] = [{"channels": [], "samplers": []}]
    with pytest.warns(UserWarning, match="holds animations: everything stands as its nodes say"):
        build_scene(writer.write(tmp_path / "t.glb"), activate())


def test_a_texture_without_coordinates_is_refused(tmp_path: Path) -> None:
    writer = floor({}, uv=False)
    writer.content["materials"][0] = {
        "emissiveTexture": {"index": writer.texture(PICTURE)},
        "emissiveFactor": [1, 1, 1],
    }
    with pytest.raises(ValueError, match="mesh .floor. has no texture coordinates, and its radiance is a texture"):
        build_scene(writer.write(tmp_path / "t.glb"), activate())


def test_a_file_that_is_cut_short_is_refused(tmp_path: Path) -> None:
    whole = floor().write(tmp_path / "t.glb").read_bytes()
    for length in (10, 21, 40, len(whole) - 20, len(whole) - 1):
        (tmp_path / "cut.glb").write_bytes(whole[:length])
        with pytest.raises(ValueError, match="cut"):
            build_scene(tmp_path / "cut.glb", activate())


def test_files_behind_a_link_are_read_where_links_may_lead(tmp_path: Path) -> None:
    """As the files of Mitsuba's own scenes; else a scene from anywhere could show any picture of the user's."""
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    for folder in (inside, outside):
        folder.mkdir()
    writer = floor()
    (outside / "b.bin").write_bytes(writer.data)
    (inside / "b.bin").symlink_to(outside / "b.bin")
    content = writer.content | {"buffers": [{"uri": "b.bin", "byteLength": len(writer.data)}]}
    (inside / "s.gltf").write_text(json.dumps(content))
    with given([str(inside)]), pytest.raises(ValueError, match=r"leads by a link to|outside its folder"):
        read_document(inside / "s.gltf")
    with given([str(inside)]):
        allow([outside])
        assert read_document(inside / "s.gltf").files == (inside / "s.gltf", outside / "b.bin")
        pictures = content | {"images": [{"uri": f"{k}.png"} for k in range(2)]}
        (inside / "s.gltf").write_text(json.dumps(pictures))
        assert read_document(inside / "s.gltf").files[1:] == (outside / "b.bin", inside / "0.png", inside / "1.png")
        (inside / "s.gltf").write_text(json.dumps(content).replace("b.bin", "../outside/b.bin"))
        with pytest.raises(ValueError, match="outside its folder"):
            read_document(inside / "s.gltf")
