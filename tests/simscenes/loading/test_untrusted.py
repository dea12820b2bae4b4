"""Scene files nobody vouches for: nothing outside their folder is read or run, and checking them always ends."""

import os
import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from simscenes.backend import activate
from simscenes.loading.checks.untrusted import check_xml
from simscenes.loading.load import build_scene
from simscenes.sets.pictures.exr import write_exr

BALL = '<shape type="sphere" id="ball">{}</shape>'
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def mesh(name: str) -> str:
    return f'<shape type="obj" id="mesh"><string name="filename" value="{name}"/></shape>'


def wrapped(content: str) -> str:
    return f'<scene version="3.0.0">{content}</scene>'


def write(path: Path, content: str, encoding: str = "utf-8") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content, encoding=encoding)
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene's folder, beside it a mesh that it must not read."""
    write(tmp_path / "secret" / "mesh.obj", TRIANGLE)
    (tmp_path / "scene").mkdir()
    return tmp_path / "scene"


def refused(path: Path, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build_scene(path, activate())


@pytest.mark.parametrize("kind", ["evil", "../../secret/evil", "./evil", "sphere.so"])
def test_code_beside_the_scene_is_not_run(kind: str, folder: Path) -> None:
    for plugins in (folder / "plugins", folder.parent / "secret"):
        write(plugins / "evil.so", "no library, but Mitsuba would hand it to the loader")
    path = write(folder / "scene.xml", wrapped(BALL.format("") + f'<shape type="{kind}"/>'))
    refused(path, "'plugins'")
    shutil.rmtree(folder / "plugins")
    refused(path, "plugin")


def test_code_in_the_working_directory_is_not_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(folder.parent / "plugins" / "evil.so", "")
    monkeypatch.chdir(folder.parent)
    refused(write(folder / "scene.xml", wrapped('<shape type="evil"/>')), "plugin type 'evil'")
    with pytest.raises(ValueError, match="plugin type 'evil'"):
        build_scene({"type": "scene", "ball": {"type": "sphere", "bsdf": {"type": "evil"}}}, activate())


def test_the_working_directory_is_not_searched(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder.parent / "secret")
    mi = activate()
    before = str(mi.file_resolver())
    path = write(folder / "scene.xml", wrapped(mesh("mesh.obj")))
    refused(path, "outside its folder")
    assert build_scene(path, mi, allow_outside=True).shapes == ("mesh",)
    write(folder / "mesh.obj", TRIANGLE)
    assert build_scene(path, mi).shapes == ("mesh",)
    assert str(mi.file_resolver()) == before


def test_a_path_is_no_shorter_for_its_slashes(folder: Path) -> None:
    name = "/" * 5000 + str(folder.parent / "secret" / "mesh.obj")
    refused(write(folder / "scene.xml", wrapped(mesh(name))), "outside its folder")


def test_no_further_folder_is_searched(folder: Path) -> None:
    (folder / "deep").mkdir()
    (folder / "deep" / "link.obj").symlink_to(folder.parent / "secret" / "mesh.obj")
    path = write(folder / "scene.xml", wrapped('<path value="deep"/>' + mesh("link.obj")))
    refused(path, "outside its folder")
    assert build_scene(path, activate(), allow_outside=True).shapes == ("mesh",)


def test_an_include_is_sought_beside_the_file_that_names_it(folder: Path) -> None:
    write(folder / "scene.xml", wrapped('<include filename="deep/part.xml"/>'))
    write(folder / "deep" / "part.xml", wrapped('<include filename="leaf.xml"/>'))
    write(folder / "leaf.xml", wrapped(BALL.format("")))
    write(folder / "deep" / "leaf.xml", wrapped(mesh("../secret/mesh.obj")))
    refused(folder / "scene.xml", "outside its folder")
    write(folder / "deep" / "leaf.xml", wrapped(BALL.format("")))
    assert build_scene(folder / "scene.xml", activate()).shapes == ("ball",)


def test_another_encoding_hides_nothing(folder: Path) -> None:
    (folder / "&a;").mkdir()
    text = '<!DOCTYPE x [<!ENTITY a "q/w/e/r/t">]>' + wrapped(mesh("&a;/../../secret/mesh.obj"))
    for encoding in ("utf-16", "utf-16-le", "utf-32"):
        refused(write(folder / "scene.xml", text, encoding), "UTF-8")
    declared = '<?xml version="1.0" encoding="{}"?>' + wrapped(BALL.format(""))
    refused(write(folder / "scene.xml", declared.format("latin1")), "UTF-8")
    assert build_scene(write(folder / "scene.xml", declared.format("UTF-8"), "utf-8-sig"), activate()).shapes


def test_a_link_to_a_scene_is_the_scene_it_points_to(folder: Path) -> None:
    write(folder / "mesh.obj", TRIANGLE)
    real = write(folder / "scene.xml", wrapped(mesh("mesh.obj")))
    link = folder.parent / "link.xml"
    link.symlink_to(real)
    assert build_scene(link, activate()).shapes == ("mesh",)
    (folder / "mesh.obj").unlink()
    (folder / "mesh.obj").symlink_to(folder.parent / "secret" / "mesh.obj")
    refused(link, "outside its folder")


def test_the_files_a_scene_names_are_listed(folder: Path) -> None:
    parts = '<default name="m" value="mesh"/><include filename="part.xml"/>'
    write(folder / "scene.xml", wrapped(parts + mesh("no.obj")))
    write(folder / "part.xml", wrapped(mesh("$m.obj")))
    write(folder / "mesh.obj", TRIANGLE)
    assert check_xml(folder / "scene.xml") == tuple(folder / name for name in ("scene.xml", "part.xml", "mesh.obj"))


def test_long_lists_of_numbers_are_no_paths(folder: Path) -> None:
    matrix = " ".join(f"{float(k % 5 == 0):.17f}" for k in range(16))
    pairs = ", ".join(f"{w}:0.5{w:014d}" for w in range(390, 700, 10))
    assert min(len(matrix), len(pairs)) > 255
    turned = f'<transform name="to_world"><matrix value="{matrix}"/></transform>'
    painted = f'<bsdf type="diffuse"><spectrum name="reflectance" value="{pairs}"/></bsdf>'
    ball = f'<shape type="cube" id="ball">{painted}{turned}</shape>'
    for default in ("", f'<default name="numbers" value="{"0.25 " * 2000}"/>'):
        assert build_scene(write(folder / "scene.xml", wrapped(default + ball)), activate()).shapes == ("ball",)


def doubling() -> str:
    defaults = "".join(
        f'<default name="{b}" value="{f"${a}" * 10}"/>' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
    )
    return f'<default name="a" value="{"x" * 1000}"/>' + defaults


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (doubling(), "larger than"),
        (
            '<default name="a" value="x"/>' + "".join(f'<default name="p{i}" value="1"/>' for i in range(300)),
            "parameters",
        ),
        (BALL.format('<bsdf type="mask">' * 60_000 + '<bsdf type="diffuse"/>' + "</bsdf>" * 60_000), "128 deep"),
    ],
    ids=["parameters that double", "parameters without number", "nests"],
)
def test_a_small_file_cannot_ask_for_endless_work(content: str, message: str, folder: Path) -> None:
    refused(write(folder / "scene.xml", wrapped(content)), message)


def test_includes_are_limited_in_number_as_well_as_in_depth(folder: Path) -> None:
    for i in range(15):
        write(folder / f"part{i}.xml", wrapped(f'<include filename="part{i + 1}.xml"/>' * 2))
    write(folder / "part15.xml", wrapped(""))
    refused(folder / "part0.xml", "1000 files")


def test_a_deep_scene_within_the_limit_loads(folder: Path) -> None:
    nested = '<bsdf type="mask">' * 120 + '<bsdf type="diffuse"/>' + "</bsdf>" * 120
    assert build_scene(write(folder / "scene.xml", wrapped(BALL.format(nested))), activate()).shapes == ("ball",)


def blends(count: int) -> str:
    """Each blend holds the one before it twice: with references written out, 2**count materials."""
    halves = '<float name="weight" value="0.5"/><ref id="b{0}"/><ref id="b{0}"/>'
    made = (f'<bsdf type="blendbsdf" id="b{i + 1}">{halves.format(i)}</bsdf>' for i in range(count))
    return '<bsdf type="diffuse" id="b0"/>' + "".join(made) + BALL.format(f'<ref id="b{count}"/>')


def test_references_cannot_multiply_without_end(folder: Path) -> None:
    refused(write(folder / "scene.xml", wrapped(blends(30))), "objects once its references")
    renamed = blends(30).replace('<ref id="b', '<ref id="c').replace("</bsdf><bsdf", "</bsdf>{}<bsdf")
    aliases = (f'<alias id="b{i}" as="c{i}"/>' for i in range(1, 31))
    first = '<bsdf type="diffuse" id="c0"/>'
    refused(write(folder / "scene.xml", wrapped(first + renamed.format(*aliases))), "objects once its references")
    assert build_scene(write(folder / "scene.xml", wrapped(blends(10))), activate()).shapes == ("ball",)


def test_objects_that_hold_each_other_are_refused(folder: Path) -> None:
    pair = '<bsdf type="twosided" id="a"><ref id="b"/></bsdf><bsdf type="twosided" id="b"><ref id="a"/></bsdf>'
    refused(write(folder / "scene.xml", wrapped(pair + BALL.format('<ref id="a"/>'))), "circle")


def test_a_texture_that_is_cut_short_or_declares_too_much_is_refused_unread(tmp_path: Path) -> None:
    """Mitsuba fills what is missing of a JPEG with grey, and reserves what an EXR file declares."""
    texture = '<texture type="bitmap"><string name="filename" value="{}"/></texture>'
    picture = np.random.default_rng(0).integers(0, 255, (16, 16, 3), np.uint8)
    for name in ("a.jpg", "whole.jpg"):
        cv2.imwrite(str(tmp_path / name), picture)
    write_exr(tmp_path / "a.exr", {c: np.zeros((4, 8), np.float32) for c in "RGB"})
    cut = (tmp_path / "a.jpg").read_bytes()[:-40]
    large = (
        (tmp_path / "a.exr").read_bytes().replace(struct.pack("<4i", 0, 0, 7, 3), struct.pack("<4i", 0, 0, 10**8, 3))
    )
    for name, content, reason in (("a.jpg", cut, "cut short"), ("a.exr", large, "declares 100000001 x 4 pixels")):
        (tmp_path / "scene.xml").write_text(wrapped(texture.format(name) + texture.format("whole.jpg")))
        check_xml(tmp_path / "scene.xml")
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=f"{name} .*{reason}"):
            check_xml(tmp_path / "scene.xml")


@pytest.mark.parametrize("tag", ["shape", "emitter"])
def test_a_fifo_that_a_scene_names_is_refused_and_not_waited_for(folder: Path, tag: str) -> None:
    kind = "ply" if tag == "shape" else "envmap"
    os.mkfifo(folder / "pipe.exr")
    content = f'<{tag} type="{kind}"><string name="filename" value="pipe.exr"/></{tag}>'
    refused(write(folder / "scene.xml", wrapped(content)), "pipe.exr must be a regular file, got a FIFO")


def test_files_in_every_folder_that_a_scene_searches_are_found_and_checked(tmp_path: Path) -> None:
    paint = '<texture type="bitmap" name="reflectance"><string name="filename" value="{}"/></texture>'
    shapes = "".join(f'<shape type="sphere"><bsdf type="diffuse">{paint.format(name)}</bsdf></shape>' for name in "ab")
    scene, files = tmp_path / "scene.xml", [tmp_path / "first" / "a", tmp_path / "second" / "b"]
    paths = '<path value="first"/><path value="second"/>'
    scene.write_text(f'<scene version="3.0.0">{paths}{shapes}</scene>')
    for file in files:
        file.parent.mkdir()
        file.write_bytes(b"")
    assert set(check_xml(scene, allow_outside=True)) == {scene, *files}
    for file in files:
        content = file.read_bytes()
        file.unlink()
        os.mkfifo(file)
        with pytest.raises(ValueError, match=f"{file.parent.name}/{file.name}"):
            check_xml(scene, allow_outside=True)
        file.unlink()
        file.write_bytes(content)
        os.mkfifo(tmp_path / file.name)  # in the folder of the scene, where Mitsuba looks first
        with pytest.raises(ValueError, match=f"{tmp_path.name}/{file.name} must be a regular file, got a FIFO"):
            check_xml(scene, allow_outside=True)
        (tmp_path / file.name).unlink()
