"""Claims about what makes a render stale: the content of the scene and of all files that it names, and nothing else."""

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.stages import rendering
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.stages.rendering import rig_of, scene_digest
from simscenes import Optics

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
    def render() -> int:
        stages.render(tmp_path / "set", RenderConfig(scene=str(scene), **TINY), QUIET, overwrite=True)
        return (tmp_path / "set" / "gt" / "0001.exr").stat().st_mtime_ns  # its bytes are the same each time

    first = render()
    assert render() == first
    (scene.parent / "ball.ply").write_text(PLY.replace("0 1 0", "0 2 0"))
    assert render() != first


def test_another_way_to_write_the_same_path_renders_nothing_again(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(scene.parent)
    found = set()
    for path in ("scene.xml", "./scene.xml", str(scene)):
        stages.render(tmp_path / "set", RenderConfig(scene=path, **TINY), QUIET)
        found.add((tmp_path / "set" / "gt" / "0001.exr").stat().st_mtime_ns)
    assert len(found) == 1


def test_a_further_layout_renders_nothing_again_and_never_outlives_its_set(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "set"
    stages.render(out, RenderConfig(scene=str(scene), **TINY), QUIET)
    before = (out / "gt" / "0001.exr").stat().st_mtime_ns
    stages.render(out, RenderConfig(scene=str(scene), export=("blender",), **TINY), QUIET)
    assert (out / "gt" / "0001.exr").stat().st_mtime_ns == before
    assert (out / "blender" / "transforms_train.json").exists()
    stages.render(out, RenderConfig(scene=str(scene), seed=1, **TINY), QUIET, overwrite=True)
    assert not (out / "blender").exists()


@pytest.mark.parametrize("wrong", [{"optics": Optics(camera="Box Brownie")}, {"variant": "cuda_ad"}])
def test_what_cannot_be_rendered_costs_no_finished_set(
    wrong: dict[str, Any], scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from simscenes import backend

    monkeypatch.setattr(backend, "_working_cuda", lambda: (False, "no GPU here"))
    out = tmp_path / "set"
    stages.render(out, RenderConfig(scene=str(scene), **TINY), QUIET)
    before = sorted((p, p.stat().st_mtime_ns) for p in out.rglob("*"))
    with pytest.raises(ValueError, match="camera must be|does not work"):
        stages.render(out, RenderConfig(scene=str(scene), **{**TINY, **wrong}), QUIET, overwrite=True)
    assert sorted((p, p.stat().st_mtime_ns) for p in out.rglob("*")) == before


def test_cameras_that_a_layout_cannot_hold_are_refused_before_anything_is_rendered(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = rig_of(RenderConfig(scene=str(scene), **TINY))
    Ks = rig.Ks * [[[1.0], [1.1], [1.0]]]
    monkeypatch.setattr(sys.modules[rig_of.__module__], "rig_of", lambda _: replace(rig, Ks=Ks))
    config = RenderConfig(scene=str(scene), export=("blender",), **TINY)
    with pytest.raises(ValueError, match="the Blender layout holds one field of view for all"):
        stages.render(tmp_path / "set", config, QUIET)
    assert not (tmp_path / "set" / "gt").exists()


def test_the_seed_reaches_the_plan_and_the_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = list[int]()

    def noted(*_: Any, seed: int, **more: Any) -> Any:
        given.append(seed)
        raise ValueError("far enough")

    monkeypatch.setattr(importlib.import_module("simscenes.transport.planner"), "plan_transport", noted)
    monkeypatch.setattr(importlib.import_module("simscenes.job.render_set"), "render_set", noted)
    config = RenderConfig(scene="cornell", seed=7)
    with pytest.raises(ValueError, match="far enough"):
        rendering.plan_of(config)
    with pytest.raises(ValueError, match="far enough"):
        rendering.render_views(tmp_path, config, rig_of(config), "auto", QUIET)
    assert given == [7, 7]
