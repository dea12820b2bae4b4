"""OBJ files with incomplete corners, which Mitsuba would fill with what memory held before."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from simscenes.backend import activate
from simscenes.loading import contents
from simscenes.loading.contents import parameters_in
from simscenes.loading.load import build_scene
from simscenes.loading.obj_files import complete
from simscenes.sets.pictures.png import write_png

CORNERS = b"v 0 0 0\nv 2 0 0\nv 0 2 0\nv 0 0 2\n"
VALUES = b"vt .1 .2\nvt .3 .4\nvt .5 .6\nvn 0 .6 .8\n"
WHOLE = b"f 1/1/1 2/2/1 3/3/1\n"


def loaded(folder: Path, content: bytes) -> dict[str, np.ndarray]:
    """Texture coordinates and normals of each corner of each face, in order: [F, 3, 2] and [F, 3, 3]."""
    (folder / "meshes").mkdir(exist_ok=True)
    (folder / "meshes" / "m.obj").write_bytes(content)
    (folder / "scene.xml").write_text(
        '<scene version="3.0.0"><shape type="obj" id="m"><string name="filename" value="meshes/m.obj"/></shape></scene>'
    )
    mi = activate("scalar_rgb")
    params = parameters_in(build_scene(folder / "scene.xml", mi).scene, mi)
    faces = np.array(params["m.faces"]).reshape(-1, 3)
    found = {
        name: np.array(params[f"m.vertex_{name}"]).reshape(-1, size)[faces]
        for name, size in (("texcoords", 2), ("normals", 3))
        if len(params[f"m.vertex_{name}"])
    }
    if "texcoords" in found:
        found["texcoords"][..., 1] = 1 - found["texcoords"][..., 1]  # as Mitsuba turns the images of textures over
    return found


def test_indices_from_the_end_are_those_of_the_lines_above(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="counted from the end"):
        found = loaded(tmp_path, CORNERS + VALUES + b"f -4/-3/-1 -3/-2/-1 -2/-1/-1\nvt .9 .9\nf 4/-1/1 2/2/1 3/3/1\n")
    np.testing.assert_allclose(
        found["texcoords"], [[[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]], [[0.9, 0.9], [0.3, 0.4], [0.5, 0.6]]], atol=1e-6
    )


@pytest.mark.parametrize("face", [b"f 2 4 3", b"f -3 -1 -2", b"  f\t2 4  3\r", b"f 2// 4// 3//", b"f 2/ 4/ 3/"])
def test_a_corner_without_values_gets_the_normal_of_its_face_and_no_texture_coordinate(
    face: bytes, tmp_path: Path
) -> None:
    with pytest.warns(UserWarning, match=r"m\.obj: not every corner"):
        found = loaded(tmp_path, CORNERS + VALUES + WHOLE + face + b"\n" + WHOLE)
    placed = [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]]
    np.testing.assert_allclose(found["texcoords"], [placed, [[0, 0]] * 3, placed], atol=1e-6)
    across = np.cross([-2, 0, 2], [-2, 2, 0])
    np.testing.assert_allclose(
        found["normals"], [[[0, 0.6, 0.8]] * 3, [across / np.linalg.norm(across)] * 3, [[0, 0.6, 0.8]] * 3], atol=1e-6
    )


def test_values_that_no_corner_names_are_as_if_they_were_not_there(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="not every corner"):
        found = loaded(tmp_path, CORNERS + VALUES + b"f 1//1 2//1 3//1\n")
    assert set(found) == {"normals"}
    np.testing.assert_allclose(found["normals"], [[[0, 0.6, 0.8]] * 3], atol=1e-6)


@pytest.mark.parametrize("allow_outside", [False, True])
def test_textures_beside_a_completed_file_are_found(tmp_path: Path, allow_outside: bool) -> None:
    folder = tmp_path / "my scene"
    (folder / "tex").mkdir(parents=True)
    (folder / "m.obj").write_bytes(CORNERS + VALUES + WHOLE + b"f 2 4 3\n")
    write_png(folder / "tex" / "a b.png", np.full((2, 2, 3), 200, np.uint8))
    paint = '<texture type="bitmap" name="reflectance"><string name="filename" value="tex/a b.png"/></texture>'
    (folder / "s.xml").write_text(
        '<scene version="3.0.0"><shape type="obj"><string name="filename" value="m.obj"/>'
        f'<bsdf type="diffuse">{paint}</bsdf></shape></scene>'
    )
    with pytest.warns(UserWarning, match="not every corner"):
        scene = build_scene(folder / "s.xml", activate("scalar_rgb"), allow_outside=allow_outside)
    assert scene.scene.shapes()[0].bsdf().class_name() == "SmoothDiffuse"


def test_corners_of_one_face_are_completed_one_by_one(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="not every corner"):
        found = loaded(tmp_path, CORNERS + VALUES + b"f 1/1/1 2/2 3\n")
    np.testing.assert_allclose(found["texcoords"], [[[0.1, 0.2], [0.3, 0.4], [0, 0]]], atol=1e-6)
    np.testing.assert_allclose(found["normals"], [[[0, 0.6, 0.8], [0, 0, 1], [0, 0, 1]]], atol=1e-6)


@pytest.mark.parametrize(
    "content",
    [
        CORNERS + VALUES + WHOLE + b"f 1/1/1 2/2/1 3/3/1 4/1/1\r\n",
        CORNERS + b"f 1 2 3\nf 2 4 3\n",
        CORNERS + b"vn 0 0 1\nf 1//1 2//1 3//1\n",
        CORNERS + b"vt 0 0\nf 1/1 2/1 3/1\nf 1/1/ 2/1/ 3/1/",
        CORNERS + VALUES + WHOLE + b"f 1 2 x\n",
        b"",
    ],
)
def test_files_that_are_whole_or_that_mitsuba_refuses_are_left_as_they_are(content: bytes) -> None:
    assert complete(content) is content


def test_a_file_of_many_faces_is_looked_through_once() -> None:
    """A pattern that tries a line again from every corner would take hours here."""
    content = CORNERS + VALUES + (b"f " + b"1/1/1 " * 30_000 + b"\n") * 3
    assert complete(content) is content
    assert complete(content + b"f " + b"1/1/1 " * 30_000 + b"1\n").count(b"vn") == 2


@pytest.mark.parametrize("first", ["ball", "instance"])
def test_the_shapes_of_groups_are_found_wherever_the_instance_stands(
    first: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Shape:
        """Stands in for Mitsuba's."""

    ball, instance, grouped = Shape(), Shape(), Shape()
    own = [ball, instance] if first == "ball" else [instance, ball]
    mi, scene = SimpleNamespace(Shape=Shape), SimpleNamespace(shapes=lambda: own)
    monkeypatch.setattr(contents, "_repeats", lambda shape: shape is instance)
    monkeypatch.setattr(contents, "objects_in", lambda scene, mi: [*own, grouped, "a material"])
    assert contents.surfaces_in(scene, mi) == [ball, grouped]
