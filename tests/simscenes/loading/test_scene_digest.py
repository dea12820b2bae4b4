"""A scene's digest: it tells apart what looks different, and nothing else."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes.backend import activate
from simscenes.loading.digest import content_digest
from simscenes.loading.load import build_scene
from simscenes.loading.reference import SceneRef
from simscenes.sets.pictures.png import write_png


def scene(mi: Any, change: str = "") -> dict[str, Any]:
    """A painted mesh made in Python in a little fog; `change` names the one thing that is different."""

    def either(name: str, changed: Any, usual: Any) -> Any:
        return changed if change == name else usual

    pixels = np.linspace(0.1, 0.9, 48, dtype=np.float32).reshape(4, 4, 3)
    paint = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(either("pixels", pixels[::-1].copy(), pixels)),
        "wrap_mode": either("wrap_mode", "mirror", "repeat"),
        "filter_type": either("filter_type", "nearest", "bilinear"),
    }
    fog = {"type": "homogeneous", "phase": {"type": either("phase", "rayleigh", "isotropic")}}
    triangle = mi.Mesh("triangle", 3, 1)
    params = mi.traverse(triangle)
    params["vertex_positions"] = np.array([0, 0, 0, 1, 0, 0, 0, 1, either("vertex", 1, 0)], np.float32)
    params["faces"] = np.array([0, 1, 2], np.uint32)
    params.update()
    sphere = {
        "type": "sphere",
        "flip_normals": either("flip_normals", True, False),
        "to_world": mi.ScalarTransform4f().translate([0, 0, either("to_world", 1.0, 0.0)]),
    }
    ball = {**sphere, "bsdf": {"type": "diffuse", "reflectance": paint}}
    cloud = {"type": "sphere", "center": [3, 0, 0], "bsdf": {"type": "null"}, "interior": fog}
    lights = [("sky", {"type": "constant"}), ("lamp", {"type": "point"})]
    return {
        "type": "scene",
        "ball": ball,
        "cloud": cloud,
        "triangle": triangle,
        **dict(either("order", lights[::-1], lights)),
    }


CHANGES = "pixels wrap_mode filter_type phase vertex flip_normals to_world order".split()


@pytest.mark.parametrize("change", CHANGES)
def test_whatever_changes_the_picture_changes_the_digest(change: str) -> None:
    mi = activate()
    same, again, other = (build_scene(scene(mi, c), mi).digest for c in ("", "", change))
    assert same == again
    assert other != same


def test_a_file_is_known_by_what_it_and_its_includes_say_not_by_where_it_lies(tmp_path: Path) -> None:
    mi = activate()

    def digest(folder: str, normals: str) -> str:
        (tmp_path / folder).mkdir()
        ball = f'<shape type="sphere"><boolean name="flip_normals" value="{normals}"/></shape>'
        for name, content in (("scene", '<include filename="part.xml"/>'), ("part", ball)):
            (tmp_path / folder / f"{name}.xml").write_text(f'<scene version="3.0.0">{content}</scene>')
        return build_scene(tmp_path / folder / "scene.xml", mi).digest

    assert digest("a", "false") == digest("b", "false") != digest("c", "true")


def test_the_letters_of_files_count_and_where_each_ends(tmp_path: Path) -> None:
    """Rationale: wrap modes "repeat" and "mirror" are as long, and no number says which of them it is."""

    def digest(*contents: str) -> str:
        files = tuple(tmp_path / f"{i}.xml" for i in range(len(contents)))
        for file, content in zip(files, contents, strict=True):
            file.write_text(content)
        return content_digest(files, {})

    contents = [("repeat",), ("mirror",), ("rep", "eat"), ("repe", "at"), ("eat", "rep"), ("a", "aa"), ("aa", "a")]
    assert len({digest(*each) for each in contents}) == len(contents)
    assert digest("repeat") == digest("repeat")


def test_two_files_with_exchanged_contents_are_another_scene(tmp_path: Path) -> None:
    """The scene file says the same, and all numbers are there as before, but at the other ball."""
    mi = activate()

    def digest(folder: str, *grey: int) -> str:
        (tmp_path / folder).mkdir()
        balls = ""
        for i, value in enumerate(grey):
            write_png(tmp_path / folder / f"{i}.png", np.full((4, 4, 3), value, np.uint8))
            paint = f'<texture type="bitmap" name="reflectance"><string name="filename" value="{i}.png"/></texture>'
            balls += f'<shape type="sphere" id="ball {i}"><bsdf type="diffuse">{paint}</bsdf></shape>'
        (tmp_path / folder / "scene.xml").write_text(f'<scene version="3.0.0">{balls}</scene>')
        return build_scene(tmp_path / folder / "scene.xml", mi).digest

    assert digest("a", 50, 200) == digest("b", 50, 200) != digest("c", 200, 50)


def test_two_parameters_that_change_places_make_another_scene() -> None:
    values = {"red.reflectance.value": 0.1, "blue.reflectance.value": 0.9}
    names = list(values)
    other = dict(zip(names, reversed(values.values()), strict=True))
    assert content_digest({}, values) == content_digest({}, dict(reversed(values.items()))) != content_digest({}, other)


def test_no_byte_counts_for_the_file_or_the_parameter_beside_its_own(tmp_path: Path) -> None:
    def of_files(*contents: str) -> str:
        files = tuple(tmp_path / str(i) for i in range(len(contents)))
        for file, content in zip(files, contents, strict=True):
            file.write_text(content)
        return content_digest(files, {})

    assert of_files("ab", "c") == of_files("ab", "c") != of_files("a", "bc")
    assert content_digest({}, {"ab": "c"}) != content_digest({}, {"a": "bc"})


def test_what_a_parameter_chooses_counts_beside_the_file_that_it_is_of(tmp_path: Path) -> None:
    """The wrap mode of a texture, which Mitsuba lists nowhere."""
    mi = activate()
    write_png(tmp_path / "a.png", np.full((4, 4, 3), 90, np.uint8))
    paint = ('<texture type="bitmap" name="reflectance"><string name="filename" value="a.png"/>'
             '<string name="wrap_mode" value="$wrap"/></texture>')  # fmt: skip

    def digest(radius: str, *given: str) -> str:
        ball = (
            f'<shape type="sphere"><float name="radius" value="{radius}"/><bsdf type="diffuse">{paint}</bsdf></shape>'
        )
        text = f'<scene version="3.0.0"><default name="wrap" value="repeat"/>{ball}</scene>'
        (tmp_path / "scene.xml").write_text(text)
        return build_scene(SceneRef.of(tmp_path / "scene.xml").given(given), mi).digest

    mirrored = digest("1", "wrap=mirror")
    assert mirrored == digest("1", "wrap=mirror")
    assert len({mirrored, digest("1"), digest("1", "wrap=clamp"), digest("2", "wrap=mirror")}) == 4


@pytest.mark.parametrize("first", ["auto", "scalar"])
def test_a_digest_is_the_same_whichever_variant_a_process_loaded_first(first: str) -> None:
    """Mitsuba's own values take their class's name from the first: `ScalarAffineTransform4f` or `AffineTransform4f`."""
    ours = (
        "from simscenes.backend import activate\n"
        "from simscenes.loading.digest import content_digest\n"
        f"mi = activate({first!r})\n"
        "mi = activate()\n"
        "values = mi.ScalarTransform4f(), mi.ScalarTransform3f(), mi.ScalarPoint3f(1), mi.ScalarColor3f(1)\n"
        "print(content_digest(dict(enumerate(values)), {}))\n"
    )
    said = subprocess.run([sys.executable, "-c", ours], check=True, capture_output=True, text=True).stdout
    assert said.strip() == "71f5704c49b932745b2f2e757e4ef4be893426d749cb08ee86bc66e7a5b82330"  # as sets on disk have it
