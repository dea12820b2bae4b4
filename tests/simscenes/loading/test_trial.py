"""Scene files that crash Mitsuba, or would: one line each, and this process lives on."""

import os
import struct
import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sensor_model.files.door import VARIABLE, allow
from sensor_model.files.python import python
from simscenes.backend import activate
from simscenes.loading import load
from simscenes.loading.checks import trial, trial_process
from simscenes.loading.checks.complete import check_complete
from simscenes.loading.checks.meshes import _placed_texture, check_faces, check_mesh_file
from simscenes.loading.load import build_scene

CORNERS = b"".join(struct.pack("<3f", *p) for p in [(0, 0, 0), (1, 0, 0), (0, 1, 0)])


@pytest.fixture(autouse=True)
def nothing_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def ply(*face: int, vertices: int = 3, faces: int = 1) -> bytes:
    """A triangle; its header may announce more."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n"
    head += f"property float z\nelement face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    return head.encode() + CORNERS + struct.pack("<B3i", 3, *face)


def serialized(*face: int, vertices: int = 3) -> bytes:
    body = struct.pack("<I", 0x1000) + b"m\0" + struct.pack("<QQ", vertices, 1) + CORNERS + struct.pack("<3I", *face)
    return struct.pack("<HH", 0x041C, 4) + zlib.compress(body) + struct.pack("<QI", 0, 1)


def with_a_wrong_sum(mesh: bytes) -> bytes:
    """The checksum that ends the compressed part, before the 12 bytes that end the file."""
    return mesh[:-13] + bytes([mesh[-13] ^ 0xFF]) + mesh[-12:]


def scene_of(folder: Path, name: str, content: bytes) -> Path:
    (folder / name).write_bytes(content)
    shape = f'<shape type="{Path(name).suffix[1:]}" id="m"><string name="filename" value="{name}"/></shape>'
    (folder / "scene.xml").write_text(f'<scene version="3.0.0">{shape}</scene>')
    return folder / "scene.xml"


@pytest.mark.parametrize(("name", "make"), [("m.ply", ply), ("m.serialized", serialized)])
def test_mesh_indices_out_of_range_are_one_line_whether_mitsuba_crashes_or_reads_on(
    name: str, make: Any, tmp_path: Path
) -> None:
    mi = activate()
    assert build_scene(scene_of(tmp_path, name, make(0, 1, 2)), mi).shapes == ("m",)
    with pytest.raises(
        ValueError, match=r"mesh 'm' has 3 vertices, but a face names vertex 900|Mitsuba crashes on it \(SIG"
    ):
        build_scene(scene_of(tmp_path, name, make(0, 1, 900)), mi)  # as the memory beyond happens to be
    with pytest.raises(ValueError, match=r"'scene' cannot be loaded: Mitsuba crashes on it \(SIG"):
        build_scene(scene_of(tmp_path, name, make(0, 1, 2**30)), mi)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("m.ply", ply(0, 1, 2, vertices=10**9)),
        ("m.ply", ply(0, 1, 2, faces=10**9)),
        ("m.ply", ply(0, 1, 2)[:-30]),
        ("m.ply", ply(0, 1, 2).replace(b"vertex 3", b"vertex -1")),
        ("m.ply", ply(0, 1, 2).replace(b"vertex 3", b"vertex " + b"9" * 5000)),
        ("m.serialized", serialized(0, 1, 2, vertices=10**9)),
        ("m.serialized", with_a_wrong_sum(serialized(0, 1, 2, vertices=10**9))),
    ],
    ids=["vertices", "faces", "cut short", "fewer than none", "5000 digits", "serialized", "damaged after the counts"],
)
def test_a_mesh_that_announces_more_than_it_holds_is_refused_unread(name: str, content: bytes, tmp_path: Path) -> None:
    path = scene_of(tmp_path, name, content)
    with pytest.raises(ValueError, match=rf"{name} announces at least \d+ bytes"):
        build_scene(path, activate())


def test_every_mesh_of_a_scene_is_checked() -> None:
    whole = {"faces": [0, 1, 2], "vertex_positions": [0.0] * 9}
    params = {f"{name}.{key}": value for name in ("first", "second") for key, value in whole.items()}
    check_faces(params)
    for name in ("first", "second"):
        with pytest.raises(ValueError, match=f"a mesh '{name}' has 3 vertices, but a face names vertex 3"):
            check_faces(params | {f"{name}.faces": [0, 1, 3]})


def test_the_texture_that_has_to_be_placed_is_found_among_all_inputs() -> None:
    even, uneven = np.full((2, 2, 3), 0.5), np.arange(12.0).reshape(2, 2, 3)
    others = {f"{name}.{part}": value for name in "abcdef" for part, value in (("to_uv", None), ("data", even))}
    assert _placed_texture(others) == ""
    for name in ("brdf.alpha", "brdf.reflectance", "zeta"):
        texture = {f"{name}.to_uv": None, f"{name}.data": uneven}
        assert _placed_texture(others | texture) == name.rpartition(".")[2]
    assert _placed_texture({"board.to_uv": None, "board.color0": 1.0}) == "board"


def test_whole_meshes_of_every_kind_pass_the_check_of_sizes(tmp_path: Path) -> None:
    text = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    text += b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    flat = struct.pack("<HH", 0x041C, 4) + zlib.compress(
        struct.pack("<I", 0x1000) + b"m\0" + struct.pack("<QQ", 40_000, 0) + bytes(480_000)
    )  # compresses best
    for name, content in (("a.ply", text), ("b.ply", ply(0, 1, 2)), ("c.serialized", flat), ("d.obj", b"")):
        (tmp_path / name).write_bytes(content)
        check_mesh_file(tmp_path / name)


BALL = '<scene version="3.0.0"><shape type="sphere" id="ball">{}</shape></scene>'
SLIDE = '<bsdf type="diffuse"><texture type="{}" name="reflectance"/></bsdf>'


@pytest.mark.parametrize(
    ("inside", "needs"),
    [
        (SLIDE.format("bitmap"), "'bitmap' without a parameter 'filename'"),
        (SLIDE.format("volume"), "'volume' without a child of kind volume"),
        ('<bsdf type="blendbsdf"/>', "'blendbsdf' without 2 children of kind bsdf"),
        ('<bsdf type="blendbsdf"><bsdf type="diffuse"/><float name="weight" value="0"/></bsdf>', "without 2 children"),
        ('</shape><shape type="merge">', "'merge' without a child of kind shape"),
    ],
    ids=["bitmap", "volume", "blendbsdf", "half a blendbsdf", "merge"],
)
def test_what_a_plugin_cannot_do_without_is_said_before_mitsuba_sees_the_file(
    inside: str, needs: str, tmp_path: Path
) -> None:
    (tmp_path / "scene.xml").write_text(BALL.format(inside))
    for trusted in (False, True):
        with pytest.raises(ValueError, match=needs):
            build_scene(tmp_path / "scene.xml", activate(), allow_outside=trusted)


@pytest.mark.parametrize("inner", [{"type": "bitmap"}, {"type": "volume"}])
def test_a_dict_is_checked_for_the_same(inner: dict[str, Any]) -> None:
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": inner}}
    with pytest.raises(ValueError, match=f"{inner['type']!r} without"):
        build_scene({"type": "scene", "ball": ball}, activate())
    with pytest.raises(ValueError, match="without 2 children"):
        build_scene({"type": "scene", "ball": {"type": "sphere", "bsdf": {"type": "blendbsdf"}}}, activate())


@pytest.mark.parametrize(
    ("plugin", "kinds"),
    [("merge", ["shape"]), ("merge", ["ref"]), ("blendbsdf", ["bsdf", "ref"]), ("blendbsdf", ["float", "bsdf", "bsdf"]),
     ("blendbsdf", ["bsdf", "float", "bsdf"]), ("blendbsdf", ["bsdf", "bsdf", "float"])],
)  # fmt: skip
def test_a_plugin_with_no_more_children_than_it_needs_is_complete_in_any_order(plugin: str, kinds: list[str]) -> None:
    check_complete(plugin, [], kinds, "the scene")
    with pytest.raises(ValueError, match=f"{plugin!r} without"):
        check_complete(plugin, [], [kind for kind in kinds if kind == "float"], "the scene")


def test_parameters_that_are_not_set_are_no_fault(tmp_path: Path) -> None:
    """Rationale: a hair has none of two ways to say its colour, which Mitsuba lists and cannot read."""
    (tmp_path / "scene.xml").write_text(BALL.format('<bsdf type="hair"/>'))
    assert build_scene(tmp_path / "scene.xml", activate()).shapes == ("ball",)


def test_a_file_is_tried_once_for_each_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(trial._Process, "load", lambda self, scene, *_: asked.append(scene) or "")
    path = scene_of(tmp_path, "m.ply", ply(0, 1, 2))
    for _ in range(2):
        build_scene(path, activate())
    assert len(asked) == 1
    build_scene(scene_of(tmp_path, "m.ply", ply(0, 2, 1)), activate())  # the mesh beside it changed
    assert len(asked) == 2
    for _ in range(2):
        build_scene(path, activate(), allow_outside=True)  # a trusted file can be black as well
    assert len(asked) == 3


def test_a_file_that_failed_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = ["it crashes", ""]
    monkeypatch.setattr(trial._Process, "load", lambda self, scene, *_: answers.pop(0))
    path = scene_of(tmp_path, "m.ply", ply(0, 1, 2))
    with pytest.raises(ValueError, match="it crashes"):
        build_scene(path, activate())
    assert build_scene(path, activate()).shapes == ("m",)


def stand_in(code: str, monkeypatch: pytest.MonkeyPatch) -> "trial._Process":
    """A process that runs this instead of serving."""
    monkeypatch.setattr(trial, "_START", code)
    return trial._Process("scalar_rgb")


def test_a_hang_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "SECONDS", 0.5)
    process = stand_in("import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); time.sleep(99)", monkeypatch)
    assert process.load(Path("a.xml")) == "scene 'a' cannot be loaded: Mitsuba did not finish within 0 s"
    assert process.running is None


def test_a_process_that_leaves_for_lack_of_work_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = f"import os, sys; f = {str(tmp_path / 'ran')!r}; os.path.exists(f) or (open(f, 'w'), os._exit(0)); "
    process = stand_in(first + "sys.stdin.readline(); print('\"\"', flush=True)", monkeypatch)
    assert process.load(Path("a.xml")) == ""
    assert (tmp_path / "ran").exists()
    assert "ends before it answers" in stand_in("pass", monkeypatch).load(Path("a.xml"))


def test_an_interrupted_trial_leaves_no_answer_for_the_next_file(monkeypatch: pytest.MonkeyPatch) -> None:
    process = stand_in("import sys\nfor line in sys.stdin: print('\"' + line[11] + '\"', flush=True)", monkeypatch)
    select = trial.select.select

    def interrupted(*args: Any) -> Any:
        time.sleep(0.2)
        raise KeyboardInterrupt

    assert process.load(Path("a")) == "a"
    monkeypatch.setattr(trial.select, "select", interrupted)
    with pytest.raises(KeyboardInterrupt):
        process.load(Path("b"))
    monkeypatch.setattr(trial.select, "select", select)
    assert process.load(Path("c")) == "c"
    process.stop()


def test_the_process_ends_when_nothing_is_asked() -> None:
    code = "from simscenes.loading.checks import trial_process as p; p.IDLE = 0.1; p.serve()"
    words = python(code)
    assert os.waitstatus_to_exitcode(os.waitpid(os.spawnv(os.P_NOWAIT, words[0], words), 0)[1]) == 0


@pytest.mark.slow
def test_no_plugin_crashes_for_being_bare_so_that_the_trial_is_for_what_nobody_thought_of(tmp_path: Path) -> None:
    import sys

    sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
    from tests.fuzz.readers.scenes import bare

    mi, crashes = activate(), []
    for name, content in bare():
        (tmp_path / name).write_bytes(content)
        try:
            build_scene(tmp_path / name, mi)
        except ValueError as error:
            crashes += [f"{name}: {error}"] if "crashes" in str(error) else []
    assert crashes == []


def test_a_link_that_was_allowed_after_the_trial_process_began_is_followed_there_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: that process knew what was allowed when it began. Found by `python -m tests.fuzz`."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))  # nothing is remembered
    monkeypatch.delenv(VARIABLE, raising=False)
    (tmp_path / "outside").mkdir()
    (tmp_path / "scene").mkdir()
    (tmp_path / "outside" / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "scene" / "m.obj").symlink_to(tmp_path / "outside" / "m.obj")
    shapes = ("<shape type='sphere'/>", "<shape type='obj'><string name='filename' value='m.obj'/></shape>")
    first, second = (tmp_path / "scene" / name for name in ("first.xml", "second.xml"))
    for file, shape in zip((first, second), shapes, strict=True):
        file.write_text(f"<scene version='3.0.0'>{shape}<emitter type='constant'/></scene>")
    trial.check_survives(first, [first], "scalar_rgb")
    allow([tmp_path / "outside"])
    trial.check_survives(second, [second, tmp_path / "scene" / "m.obj"], "scalar_rgb")


def test_a_scene_is_tried_once_for_each_variant_version_content_and_choice_of_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried, versions = list[tuple[Any, ...]](), {"drjit": "1.0", "mitsuba": "3.6"}

    class Recording:
        def __init__(self, variant: str) -> None:
            self.variant = variant

        def load(self, scene: Path, parameters: Any = (), *_: Any) -> str:
            tried.append((self.variant, *parameters))
            return ""

    monkeypatch.setattr(trial, "_Process", Recording)
    monkeypatch.setattr(trial, "_PROCESSES", {})
    monkeypatch.setattr(trial.importlib.metadata, "version", versions.__getitem__)
    scene, part = tmp_path / "scene.xml", tmp_path / "part.xml"
    scene.write_text("a")
    part.write_text("b")

    def is_tried(variant: str = "rgb", parameters: Any = ()) -> bool:
        before = len(tried)
        trial.check_survives(scene, [scene, part], variant, parameters)
        return len(tried) > before

    assert is_tried()
    assert not is_tried()
    assert is_tried("spectral")
    assert is_tried(parameters=[("size", "1")])
    assert is_tried(parameters=[("size", "2")])
    for name in versions:
        versions[name] += ".1"
        assert is_tried(), name
    monkeypatch.setattr(trial, "FORMAT", f"{trial.FORMAT} and more")
    assert is_tried()
    part.write_text("c")
    assert is_tried()
    scene.write_text("c")
    assert is_tried()
    part.rename(tmp_path / "other.xml")
    part = tmp_path / "other.xml"
    assert is_tried()
    assert not any(map(is_tried, ["rgb"]))


def test_a_scene_is_tried_with_all_its_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def loaded(source: Any, *_: Any, **__: Any) -> Any:
        raise ValueError(repr(source.parameters))

    monkeypatch.setattr(load, "load_here", loaded)
    said = trial_process._tried(tmp_path / "a.xml", activate().variant(), [["size", "2"], ["depth", "3"]], False)
    assert said == "(('size', '2'), ('depth', '3'))"
