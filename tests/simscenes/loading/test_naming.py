"""Shapes of a foreign file are told apart in set.json: by their ids, their files or their kinds, never by nothing."""

import json
from pathlib import Path

from simscenes import Rig, render_set
from simscenes.backend import using_variant
from simscenes.loading.load import build_scene
from simscenes.rigs import intrinsics, look_at

FILE = """<scene version="3.0.0">
  <bsdf type="diffuse" id="Red-BSDF"/>
  <shape type="sphere" id="Ball"><ref id="Red-BSDF"/></shape>
  <shape type="sphere"><bsdf type="diffuse"/></shape>
  <shape type="rectangle" id="Sphere_2"/>
  <shape type="sphere"/>
  <shape type="obj"><string name="filename" value="meshes/teapot lid.obj"/></shape>
  <shape type="obj" id="table"><string name="filename" value="meshes/teapot lid.obj"/></shape>
  <shape type="shapegroup" id="group"><shape type="sphere" id="inner"><ref id="Red-BSDF"/></shape></shape>
  <shape type="instance" id="copy"><ref id="group"/></shape>
  <emitter type="constant"/>
</scene>"""


def test_every_shape_of_a_file_has_a_name_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "teapot lid.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "scene.xml").write_text(FILE)
    rig = Rig(viewmats=look_at((0, -4, 0), (0, 0, 0))[None], Ks=intrinsics(3, 3, 40)[None], width=3, height=3)
    render_set(tmp_path / "scene.xml", rig, tmp_path / "set", spp=2, plan="rgb")
    meta = json.loads((tmp_path / "set" / "set.json").read_text())
    assert meta["shapes"] == ["Ball", "Sphere", "Sphere_2", "Sphere_3", "teapot lid", "table", "copy"]
    assert meta["materials"][:2] == ["Red-BSDF", "Sphere.SmoothDiffuse"]


def test_materials_within_groups_are_told_apart(tmp_path: Path) -> None:
    group = "".join('<shape type="sphere"><bsdf type="diffuse"/></shape>' for _ in range(2))
    scene = f'<shape type="shapegroup" id="group">{group}</shape><shape type="instance"><ref id="group"/></shape>'
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{scene}<emitter type="constant"/></scene>')
    with using_variant("scalar") as mi:
        loaded = build_scene(tmp_path / "scene.xml", mi)
    assert loaded.shapes == ("group",)
    assert loaded.materials == ("Sphere.SmoothDiffuse", "Sphere_2.SmoothDiffuse")
