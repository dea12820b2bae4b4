"""Claims about methods that are programs: what they see, what they cost, and what every failure of one looks like."""

import base64
import hashlib
import json
import shlex
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.dataset.nerfbaselines import checksum, encoded, export_results
from novags.testbed.importing.programs import output_of
from novags.testbed.stages import command
from novags.testbed.stages.command import run_command
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.command import CommandConfig, read_commands
from simscenes.sets.pictures.exr import read_exr
from simscenes.sets.pictures.png import read_png

QUIET = Console(quiet=True)
BRIGHTEN = """
import json, pathlib, sys
import numpy as np, cv2
capture, out = map(pathlib.Path, sys.argv[1:3])
seen = sorted(path.name for path in capture.iterdir())
pathlib.Path("seen.json").write_text(json.dumps([seen, sys.argv, str(pathlib.Path.cwd())]))
held = bytearray(90_000_000)
for name in (capture / "test_list.txt").read_text().split():
    dark = cv2.imread(str(capture / "images" / pathlib.Path(name).name)).astype(float)
    cv2.imwrite(str(out / (pathlib.Path(name).stem + ".png")), np.clip(4 * dark, 0, 255).astype(np.uint8))
import time; time.sleep(0.5)
"""


def method(folder: Path, code: str, more: str = "", **settings: object) -> CommandConfig:
    (folder / "mine.py").write_text(code)
    words = f"{shlex.quote(sys.executable)} mine.py {{capture}} {{out}} {more}"
    (found,) = read_commands({"mine": {"command": words, **settings}}, folder)
    return found


def test_a_program_makes_a_run_that_is_scored_and_exported_like_any_other(capture: Path, tmp_path: Path) -> None:
    awkward = "'two words; $HOME `date` {seed}' \"*\""
    run = tmp_path / "run"
    record = run_command(capture, run, replace(method(tmp_path, BRIGHTEN, awkward), seed=3), QUIET)
    seen, words, where = json.loads((tmp_path / "seen.json").read_text())
    assert {"capture.json", "images", "images16", "raw", "transforms.json", "sparse", "test_list.txt"} <= set(seen)
    assert not {"truth", "lit"} & set(seen)
    assert words[3:] == ["two words; $HOME `date` 3", "*"]  # as they stand: no shell has looked at them
    assert Path(where) == tmp_path.resolve()
    assert not (run / ".work").exists()
    assert record["seconds"]["command"] > 0.5
    assert 90_000_000 < record["peak_bytes"] < 600_000_000  # the program's alone: this process holds more
    scores = stages.score(run, QUIET)["methods"]["mine"]
    assert scores["peak_bytes"] == record["peak_bytes"]
    assert scores["geometry"] is None
    dark = [read_png(capture / "images" / f"{name}.png") for name in ("0000", "0008")]
    lit = [read_png(capture.parent / "photos" / "images" / f"{name}.png") for name in ("0000", "0008")]
    expected = np.mean([-10 * np.log10(np.mean((np.floor(np.clip(4 * 255 * a, 0, 255)) / 255 - b) ** 2))
                        for a, b in zip(dark, lit, strict=True)])  # fmt: skip
    assert scores["mean"]["lit"]["psnr"] == pytest.approx(expected, abs=0.02)
    table = json.loads(export_results([run], tmp_path / "nb", QUIET).read_text())
    (row,) = table["methods"]
    assert row["psnr"] == pytest.approx(scores["mean"]["lit"]["psnr"], abs=0.02)
    (name,) = row["scenes"]
    one = json.loads((tmp_path / "nb" / "mine" / name / "results.json").read_text())
    assert one["metrics"]["psnr"] == row["psnr"] == row["scenes"][name]["psnr"]
    assert one["nb_info"]["method"] == "mine"
    assert one["render_dataset_metadata"]["scene"] == name
    raw = np.frombuffer(base64.b64decode(one["metrics_raw"]["psnr"]), "<f4")
    assert raw.mean() == pytest.approx(row["psnr"], abs=1e-4)
    with pytest.raises(ValueError, match=r"results.json already: choose another --out"):
        export_results([run], tmp_path / "nb", QUIET)
    with pytest.raises(ValueError, match="has no reference enhanced: it has lit"):
        export_results([run], tmp_path / "nb", QUIET, reference="enhanced", overwrite=True)
    assert json.loads((tmp_path / "nb" / "results.json").read_text()) == table  # nothing was begun


def test_a_run_with_a_flipped_bit_is_neither_scored_nor_exported(capture: Path, tmp_path: Path) -> None:
    """Rationale: half of the flipped bits of an EXR are read without a word, as other colours."""
    run = tmp_path / "run"
    run_command(capture, run, method(tmp_path, BRIGHTEN), QUIET)
    stages.score(run, QUIET)
    picture = run / "exr" / "0008.exr"
    content = bytearray(picture.read_bytes())
    content[-5] ^= 1
    picture.write_bytes(content)
    for refused in (lambda: stages.score(run, QUIET), lambda: export_results([run], tmp_path / "nb", QUIET)):
        with pytest.raises(ValueError, match=r"exr/0008\.exr not as written .* or make the run again"):
            refused()


def test_runs_of_one_method_and_one_scene_keep_a_row_each(capture: Path, tmp_path: Path) -> None:
    """Rationale: the third of them took the name, the folder and the row of the second."""
    for name, seed in (("a", 1), ("b", 2), ("c", 3)):
        config = replace(method(tmp_path, BRIGHTEN), seed=seed)
        run_command(capture, tmp_path / name / "mine", config, QUIET)
    table = json.loads(export_results([tmp_path / name for name in "abc"], tmp_path / "nb", QUIET).read_text())
    names = [row["id"] for row in table["methods"]]
    assert names == ["mine", "mine@mine", "mine@c_mine"]
    for name, row in zip(names, table["methods"], strict=True):
        (scene,) = row["scenes"]
        one = json.loads((tmp_path / "nb" / name / scene / "results.json").read_text())
        assert one["nb_info"]["method"] == name


def test_captures_that_differ_in_size_alone_are_scenes_of_their_own(
    capture: Path, photographs: Path, tmp_path: Path
) -> None:
    stages.capture(photographs, tmp_path / "capture", CaptureConfig(electrons=200.0, max_size=28), QUIET)
    for name, source in (("a", capture), ("b", tmp_path / "capture")):
        run_command(source, tmp_path / name / "mine", method(tmp_path, BRIGHTEN), QUIET)
    table = json.loads(export_results([tmp_path / "a", tmp_path / "b"], tmp_path / "nb", QUIET).read_text())
    (row,) = table["methods"]
    assert row["id"] == "mine"
    first, second = row["scenes"]
    assert second == f"{first}-9x28x21"
    for scene in (first, second):
        assert (tmp_path / "nb" / "mine" / scene / "results.json").is_file()


def test_scores_are_encoded_and_summed_as_the_other_side_reads_them() -> None:
    assert encoded([1.0, -2.5]) == "AACAPwAAIMA="  # 0000803f 000020c0
    one, other = {"psnr": [2.0, 1.0], "mae": [3.0]}, {"mae": [3.0], "psnr": [1.0, 2.0]}
    assert checksum(one) == checksum(other) == hashlib.sha256(
        b"mae" + encoded([3.0]).encode() + b"\npsnr" + encoded([1.0, 2.0]).encode() + b"\n"
    ).hexdigest()  # fmt: skip


def test_a_program_that_writes_into_its_capture_changes_nothing_that_others_see(capture: Path, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in capture.rglob("*") if path.is_file()}
    code = BRIGHTEN + (
        "\nfor path in capture.rglob('*'):\n    if path.is_file():\n        assert not path.is_symlink()\n"
        "        path.write_bytes(b'mine now')\n"
    )
    run_command(capture, tmp_path / "run", method(tmp_path, code), QUIET)
    assert {path: path.read_bytes() for path in capture.rglob("*") if path.is_file()} == before


LIGHT = """
import pathlib, sys
import numpy as np, cv2
capture, out, kind = *map(pathlib.Path, sys.argv[1:3]), sys.argv[3]
for name in (capture / "test_list.txt").read_text().split():
    light = np.linspace(0.05, 0.5, 3)[None, None, ::-1]  # blue first
    dark = cv2.imread(str(capture / "images" / pathlib.Path(name).name))
    light = np.broadcast_to(light, dark.shape)
    if kind == "8-bit":
        light = np.where(light < 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
        codes = np.round(255 * light).astype(np.uint8)
    else:
        codes = np.round(65535 * light).astype(np.uint16)
    if kind == "alpha":
        codes = np.concatenate([codes, np.full_like(codes[..., :1], 65535)], -1)
    cv2.imwrite(str(out / (pathlib.Path(name).stem + ".png")), codes)
"""


@pytest.mark.parametrize(("kind", "step"), [("8-bit", 3e-3), ("16-bit", 1e-5), ("alpha", 1e-5)])
def test_linear_light_is_read_from_every_kind_of_file_as_scores_of_pictures_read_it(
    capture: Path, tmp_path: Path, kind: str, step: float
) -> None:
    run_command(capture, tmp_path / "run", method(tmp_path, LIGHT, kind, space="linear"), QUIET)
    channels, _ = read_exr(tmp_path / "run" / "exr" / "0000.exr")
    found = [channels[c].astype(float) for c in "RGB"]
    for values, light in zip(found, np.linspace(0.05, 0.5, 3), strict=True):
        np.testing.assert_allclose(values, light, atol=step)


FAILURES = {
    "exit code": ("import sys; print('no GPU', file=sys.stderr); sys.exit(3)", "ended with exit code 3: no GPU"),
    "silent": ("raise SystemExit(1)", "ended with exit code 1: it printed nothing"),
    "killed": ("import os; os.kill(os.getpid(), 9)", "was ended by SIGKILL, as the system does when memory runs out"),
    "no pictures": ("", "lacks 2 of the 2 test views: 0000, 0008; it holds no pictures"),
    "no picture": (BRIGHTEN.replace(".png", ".txt").replace("cv2.imwrite(", "print("), "lacks 2 of the 2 test views"),
}


@pytest.mark.parametrize("what", FAILURES)
def test_a_failure_is_one_line_with_the_last_words_and_leaves_no_run(
    capture: Path, tmp_path: Path, what: str, capfd: pytest.CaptureFixture[str]
) -> None:
    code, said = FAILURES[what]
    with pytest.raises(ValueError, match=said) as error:
        run_command(capture, tmp_path / "run", method(tmp_path, code), QUIET)
    assert len(str(error.value).splitlines()) == 1
    assert not (tmp_path / "run" / "run.json").exists()
    assert not (tmp_path / "run" / ".work").exists()
    if what == "exit code":
        assert "no GPU" in capfd.readouterr().err  # in a study: its log


def test_another_program_of_the_same_name_is_other_work(tmp_path: Path) -> None:
    first = method(tmp_path, "a = 1").resolved()
    assert method(tmp_path, "a = 1").resolved() == first
    assert method(tmp_path, "a = 2").resolved() != first
    (tmp_path / "lib").mkdir()
    parts = [tmp_path / "lib" / name for name in ("one.py", "other.py")]
    for content in ("b = 1", "b = 2"):
        for part in parts:
            with_lib = method(tmp_path, "a = 1", files=["lib"]).resolved()
            part.write_text(content)
            assert method(tmp_path, "a = 1", files=["lib"]).resolved() != with_lib
    assert method(tmp_path, "a = 1", timeout=5).resolved() == first


def test_another_version_that_a_program_tells_is_other_work(tmp_path: Path) -> None:
    (tmp_path / "theirs").write_text("#!/bin/sh\necho theirs 1.$(cat number)\n")
    (tmp_path / "theirs").chmod(0o755)
    (tmp_path / "number").write_text("2")
    found = method(tmp_path, "a = 1", version="./theirs --version").resolved()
    assert found["version"] == "theirs 1.2"
    (tmp_path / "number").write_text("3")
    output_of.cache_clear()  # as of another start: one process asks once
    assert method(tmp_path, "a = 1", version="./theirs --version").resolved() != found


@pytest.mark.parametrize(
    ("script", "said"),
    [("exit 3", "ended with exit code 3"), ("true", "must print 1 to"), ("echo no licence >&2; exit 1", "no licence")],
)
def test_a_program_that_does_not_tell_its_version_is_refused_in_one_line(
    tmp_path: Path, script: str, said: str
) -> None:
    (tmp_path / "theirs").write_text(f"#!/bin/sh\n{script}\n")
    (tmp_path / "theirs").chmod(0o755)
    with pytest.raises(ValueError, match=f"version: .*theirs.*{said}"):
        method(tmp_path, "a = 1", version="./theirs").resolved()


def test_every_file_that_a_command_names_makes_it_another_program(tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "study", tmp_path / "elsewhere"
    for place in (folder, elsewhere):
        place.mkdir()
        (place / "run.sh").write_text("#!/bin/sh\n")
        (place / "run.sh").chmod(0o755)
    (folder / "a.yaml").write_text("a: 1")
    (folder / "b.yaml").write_text("b: 1")
    (folder / "python").symlink_to(sys.executable)
    for program, names in (
        (sys.executable, ["a.yaml", "b.yaml"]),
        (f"{folder}/python", ["a.yaml", "b.yaml"]),
        (f"{folder}/run.sh", ["run.sh", "a.yaml", "b.yaml"]),
        (f"{elsewhere}/run.sh", ["../elsewhere/run.sh", "a.yaml", "b.yaml"]),
    ):
        command = f"{shlex.quote(program)} --config=a.yaml b.yaml {{capture}} {{out}}"
        (found,) = read_commands({"mine": {"command": command}}, folder)
        for name in names:
            before = found.resolved()
            assert found.resolved() == before
            with (folder / name).open("a") as file:
                file.write("\n# other")
            assert found.resolved() != before, (program, name)


def test_folders_that_a_command_names_are_told_from_those_that_count(tmp_path: Path) -> None:
    for name in ("theirs/weights", "cache", "lib"):
        (tmp_path / name).mkdir(parents=True)
    command = (
        f"{shlex.quote(sys.executable)} -m theirs --weights=theirs/weights --cache cache lib . .. {{capture}} {{out}}"
    )
    for files, uncounted in (
        ([], ["theirs", "theirs/weights", "cache", "lib"]),
        (["theirs"], ["cache", "lib"]),
        (["lib", "cache", "theirs"], []),
    ):
        (found,) = read_commands({"mine": {"command": command, "files": files}}, tmp_path)
        assert found.uncounted == uncounted


WRONG = {
    "no command": ({"mine": {"timeout": 3}}, r'\[method.mine\]: it needs command = "PROGRAM {capture} {out}"'),
    "no table": ({"mine": "python"}, r"\[method.mine\]: it needs command"),
    "no out": ({"mine": {"command": "true {capture}"}}, "command must say where {out} goes"),
    "place": ({"mine": {"command": "true {capture} {out} {gpu}"}}, "{gpu} stands for nothing; there are capture, out"),
    "quote": ({"mine": {"command": "true '{capture} {out}"}}, "command: No closing quotation"),
    "program": ({"mine": {"command": "./none {capture} {out}"}}, "the program ./none was not found"),
    "setting": (
        {"mine": {"command": "true {capture} {out}", "time": 3}},
        "it has no setting 'time'; there are comm",
    ),
    "timeout": ({"mine": {"command": "true {capture} {out}", "timeout": 0}}, "timeout must be > 0 s, got 0"),
    "space": ({"mine": {"command": "true {capture} {out}", "space": "dark"}}, "space must be one of lit, linear"),
    "taken": ({"naive": {"command": "true {capture} {out}"}}, "the name naive is taken by a method of the test bed"),
    "name": ({"a b": {"command": "true {capture} {out}"}}, "a variant's name must be letters"),
    "version": ({"mine": {"command": "true {capture} {out}", "version": "./none"}}, "version: the program ./none was"),
    "files": ({"mine": {"command": "true {capture} {out}", "files": ["lib"]}}, "files: .*lib does not exist"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_mistake_in_the_table_is_refused_before_anything_runs(tmp_path: Path, what: str) -> None:
    tables, said = WRONG[what]
    with pytest.raises(ValueError, match=said):
        read_commands(tables, tmp_path)


@pytest.mark.parametrize("part", ["capture", "photos"])
def test_a_run_of_a_capture_or_set_that_changed_while_its_program_was_at_work_is_not_kept(
    part: str, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(capture.parent, tmp_path / "copy")
    images = tmp_path / "copy" / part / "images"

    def changing(*_: object) -> dict[str, object]:
        (images / "0003.png").write_bytes((images / "0004.png").read_bytes())
        return {}

    monkeypatch.setattr(command, "_reconstruct", changing)
    changed = "capture" if part == "capture" else "set"
    with pytest.raises(ValueError, match=f"the {changed} that it reads changed while"):
        run_command(tmp_path / "copy" / "capture", tmp_path / "run", method(tmp_path, "a = 1"), QUIET)
