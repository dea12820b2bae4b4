"""Mitsuba scenes: the XML file, its meshes and its pictures; every plugin bare in every place."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from tests.fuzz.case import Reader
from tests.fuzz.damage import structure

SCENE = """<scene version="3.0.0">
  <default name="size" value="12"/>
  <integrator type="aov"><string name="aovs" value="d:depth"/><integrator type="path">
    <integer name="max_depth" value="4"/><integer name="rr_depth" value="3"/>
    <boolean name="hide_emitters" value="true"/></integrator></integrator>
  <sensor type="perspective"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0,-4,1.5" target="0,0,0.5" up="0,0,1"/></transform>
    <film type="hdrfilm"><integer name="width" value="$size"/><integer name="height" value="9"/>
      <rfilter type="box"/></film>
    <sampler type="independent"><integer name="sample_count" value="4"/></sampler></sensor>
  <bsdf type="twosided" id="paint"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
    <string name="filename" value="t.png"/><transform name="to_uv"><scale value="2"/></transform>
    </texture></bsdf></bsdf>
  <shape type="ply" id="m"><string name="filename" value="m.ply"/><ref id="paint"/></shape>
  <shape type="obj"><string name="filename" value="m.obj"/><bsdf type="roughplastic">
    <rgb name="diffuse_reflectance" value="0.2,0.3,0.4"/><float name="alpha" value="0.2"/></bsdf></shape>
  <shape type="serialized"><string name="filename" value="m.serialized"/><bsdf type="blendbsdf">
    <float name="weight" value="0.5"/><bsdf type="conductor"/><bsdf type="dielectric"/></bsdf></shape>
  <shape type="shapegroup" id="group"><shape type="sphere" id="ball"><point name="center" x="0" y="0" z="0.5"/>
    <float name="radius" value="0.3"/></shape></shape>
  <shape type="instance" id="copy"><ref id="group"/><transform name="to_world"><translate x="1"/></transform></shape>
  <shape type="cube"><transform name="to_world"><rotate z="1" angle="30"/><scale value="0.2"/></transform>
    <medium type="homogeneous" name="interior"><rgb name="albedo" value="0.5"/><phase type="hg"/></medium>
    <bsdf type="null"/></shape>
  <shape type="disk"><emitter type="area"><spectrum name="radiance" value="400:1, 700:2"/></emitter></shape>
  <emitter type="envmap"><string name="filename" value="e.exr"/><float name="scale" value="0.5"/></emitter>
  <emitter type="point"><rgb name="intensity" value="1,2,3"/><point name="position" value="0,0,2"/></emitter>
</scene>"""
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]], np.float32)
FACES = np.array([[0, 1, 2], [1, 3, 2]], np.uint32)


def make(folder: Path) -> None:
    import cv2

    from simscenes.sets.pictures.exr import write_exr

    (folder / "scene.xml").write_text(SCENE)
    write_exr(folder / "e.exr", {c: np.ones((4, 8), np.float32) for c in "RGB"})
    cv2.imwrite(str(folder / "t.png"), np.full((4, 4, 3), 99, np.uint8))
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    )
    head += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    body = CORNERS.tobytes() + b"".join(b"\3" + face.tobytes() for face in FACES)
    (folder / "m.ply").write_bytes(head.encode() + body)
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + ["vt 0 0", "vn 0 0 1", "f 1/1/1 2/1/1 3/1/1", "f 2 4 3"]
    (folder / "m.obj").write_text("\n".join(lines))
    mesh = struct.pack("<I", 0x1000) + b"m\0" + struct.pack("<QQ", 4, 2) + CORNERS.tobytes() + FACES.tobytes()
    data = struct.pack("<HH", 0x041C, 4) + zlib.compress(mesh)
    (folder / "m.serialized").write_bytes(data + struct.pack("<QI", 0, 1))


def read(folder: Path, file: Path) -> object:
    """Load; a bare plugin has a file of its own, everything else is damaged beside the scene."""
    return loaded(file if file.suffix == ".xml" else folder / "scene.xml")


def loaded(path: Path) -> object:
    """Load a scene, and look at a few pixels by geometry and light."""
    from simscenes.backend import activate
    from simscenes.loading.load import build_scene
    from simscenes.render.framing import own_rig

    mi = activate()
    try:
        scene = build_scene(path, mi)
    except ValueError as error:
        if "did not finish" in str(error):
            raise RuntimeError("Mitsuba hangs") from error
        raise
    return own_rig(scene, mi, 4, 3)


def make_given(folder: Path) -> None:
    """The scene, and what is given for its parameters: a line each."""
    make(folder)
    (folder / "given.txt").write_text("size=14\n")


def read_given(folder: Path, file: Path) -> None:
    """Load with the parameters of the file, as from the command line."""
    from simscenes.backend import activate
    from simscenes.loading.load import build_scene
    from simscenes.loading.reference import SceneRef
    from simscenes.render.framing import own_rig

    given = file.read_text("utf-8", "replace").splitlines()
    mi = activate()
    own_rig(build_scene(SceneRef.of(folder / "scene.xml").given(given), mi), mi, 4, 3)


BALL = '<shape type="sphere" id="b">{}</shape>'
SENSOR = '<sensor type="perspective">{}</sensor>'


def places(plugin: str) -> list[tuple[str, str]]:
    """(tag, scene) of a bare plugin in each place where one of its tag may stand, whether it belongs there or not."""

    def me(tag: str, name: str = "") -> str:
        return f'<{tag} type="{plugin}"{f" name={name!r}" if name else ""}/>'

    inside = {
        "shape": ["{}", '<shape type="shapegroup" id="g">{}</shape><shape type="instance"><ref id="g"/></shape>',
                  '<shape type="merge">{}</shape>'],
        "bsdf": [BALL, "{}" + BALL.format(""), BALL.format('<bsdf type="twosided">{}</bsdf>'),
                 BALL.format('<bsdf type="mask">{}</bsdf>')],
        "emitter": ["{}" + BALL.format(""), BALL],
        "sensor": ["{}" + BALL.format(""), BALL],
        "film": [SENSOR + BALL.replace("{}", "")],
        "sampler": [SENSOR + BALL.replace("{}", "")],
        "rfilter": [SENSOR.format('<film type="hdrfilm">{}</film>') + BALL.replace("{}", "")],
        "integrator": ["{}" + BALL.format("")],
        "medium": ["{}" + BALL.format("")],
        "phase": [BALL.format('<medium type="homogeneous" name="interior">{}</medium>')],
    }  # fmt: skip
    named = {
        "texture": [("reflectance", BALL.format('<bsdf type="diffuse">{}</bsdf>')),
                    ("radiance", BALL.format('<emitter type="area">{}</emitter>'))],
        "spectrum": [("intensity", '<emitter type="point">{}</emitter>' + BALL.replace("{}", ""))],
        "medium": [("interior", BALL)],
        "volume": [("sigma_t", BALL.format('<medium type="heterogeneous" name="interior">{}</medium>'))],
    }  # fmt: skip
    found = [(tag, form.format(me(tag))) for tag, forms in inside.items() for form in forms]
    found += [(tag, form.format(me(tag, name))) for tag, forms in named.items() for name, form in forms]
    return [(tag, f'<scene version="3.0.0">{scene}</scene>') for tag, scene in found]


def plugins() -> list[str]:
    """Every plugin of this Mitsuba."""
    from simscenes.loading.checks.untrusted import mitsuba_folder

    return sorted(path.name.partition(".")[0] for path in (mitsuba_folder() / "plugins").iterdir())


def bare() -> list[tuple[str, bytes]]:
    """Every plugin bare in every place, each in a scene of its own."""
    return [(f"bare-{name}-{i}.xml", s.encode()) for name in plugins() for i, (_, s) in enumerate(places(name))]


def with_mitsuba() -> None:
    """What readers of scenes import."""
    import mitsuba  # noqa: F401

    import simscenes.loading.load
    import simscenes.render.framing  # noqa: F401
    from simscenes.backend import choose_variant

    choose_variant("auto")  # tries what works here, in other processes, once for all children
    structure.PLUGINS[:] = plugins()


FILES = ("scene.xml", "m.ply", "m.obj", "m.serialized", "t.png", "e.exr")
READERS = [
    Reader("Mitsuba scene", make, read, FILES, also=bare, share=0.2, prepare=with_mitsuba),
    Reader(
        "Mitsuba parameters",
        make_given,
        read_given,
        ("given.txt",),
        share=0.1,
        prepare=with_mitsuba,
        placed=False,
        odd=False,
    ),
]
