"""Claims about what makes a render stale: the content of the scene and of all files that it names, and nothing else."""

from pathlib import Path

import pytest

from novags.testbed import stages
from novags.testbed.console import Console
from novags.testbed.render import RenderConfig, scene_digest

QUIET = Console(quiet=True)
SCENE = """<scene version="3.0.0">
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
  </sensor>
  <emitter type="constant"/>
  <include filename="ball.xml"/>
</scene>
"""
BALL = """<scene version="3.0.0">
  <shape type="ply"><string value="ball.ply" name="filename"/></shape>
</scene>
"""
PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_index
end_header
-1 -1 0
1 -1 0
0 1 0
3 0 1 2
"""
TINY = {"n_views": 3, "width": 16, "height": 16, "spp": 4}


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "scene"
    folder.mkdir()
    for name, text in (("scene.xml", SCENE), ("ball.xml", BALL), ("ball.ply", PLY)):
        (folder / name).write_text(text)
    return folder / "scene.xml"


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [("scene.xml", "0,0,4", "0,0,5"), ("ball.xml", "</scene>", " </scene>"), ("ball.ply", "0 1 0", "0 2 0")],
)
def test_a_scene_is_its_file_and_all_files_that_it_names(scene: Path, name: str, old: str, new: str) -> None:
    config = RenderConfig(scene=str(scene), **TINY)
    before = scene_digest(config)
    (scene.parent / name).write_text((scene.parent / name).read_text().replace(old, new))
    assert scene_digest(config) != before


def test_a_set_is_rendered_again_only_if_a_file_of_its_scene_changed(scene: Path, tmp_path: Path) -> None:
    def render() -> bytes:
        stages.render(tmp_path / "set", RenderConfig(scene=str(scene), **TINY), QUIET)
        return (tmp_path / "set" / "gt" / "0001.exr").read_bytes()

    first = render()
    assert render() == first
    (scene.parent / "ball.ply").write_text(PLY.replace("0 1 0", "0 2 0"))
    assert render() != first
