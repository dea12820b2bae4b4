"""Claims about files that people edit, cut or mix up: one line that names the file, never a traceback."""

import copy
import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders import shapes
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.run import open_run
from novags.testbed.folders.set import open_source
from novags.testbed.ledger.contents import read_json
from novags.testbed.report.rows import deviations, rows_of
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.scores.comparing import recovered_shares
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from simscenes import orbit_rig
from simscenes.sets.multiview import load_set, write_cameras
from tests.miniatures import unsealed

QUIET = Console(quiet=True)
ODD: list[Any] = [
    None, True, "x", "800", [], {}, [1], {"a": 1}, 0, -1, 10**400, 1e308, float("nan"), float("inf"), 10**18, 1e-320,
    "\ud800", [[1, 2], [3]], "a\0b", "a" * 5000, 2**63,
]  # fmt: skip


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set of photographs, a capture and a run of it."""
    folder = tmp_path_factory.mktemp("line")
    names = [f"{i:04d}" for i in range(4)]
    write_cameras(folder / "set", names, orbit_rig(4, 32, 32, 50.0, radius=3.0))
    (folder / "set" / "images").mkdir()
    light = np.random.default_rng(0)
    for name in names:
        cv2.imwrite(str(folder / "set" / "images" / f"{name}.png"), light.integers(9, 200, (32, 32, 3), dtype=np.uint8))
    stages.capture(folder / "set", folder / "capture", CaptureConfig(sensor="a7s2-iso6400"), QUIET)
    config = adapted(EXPERIMENTS["demo"], points=20, iterations=1).reconstruct("naive")
    stages.reconstruct(folder / "capture", folder / "run", config, QUIET)
    stages.score(folder / "run", QUIET)
    for record in ("capture/capture.json", "run/run.json"):
        unsealed(folder / record)
    return folder


def places(value: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inside = value.items() if isinstance(value, dict) else enumerate(value[:3]) if isinstance(value, list) else ()
    return [here, *(place for key, part in inside for place in places(part, (*here, key)))]


def mutated(value: Any, rng: random.Random) -> Any:
    """The value with one place of it removed or replaced by something odd."""
    value, (*way, last) = copy.deepcopy(value), rng.choice(places(value)[1:])
    owner = value
    for key in way:
        owner = owner[key]
    if rng.random() < 0.25:
        del owner[last]
    else:
        owner[last] = rng.choice(ODD)
    return value


def use_transforms(path: Path) -> None:
    source = open_source(path.parent, QUIET)
    source.radiance(0)
    source.rig.project([[0.0, 0.0, 0.0]])


def use_capture(path: Path) -> None:
    capture = open_capture(path.parent)
    capture.clean(0), capture.linear16(0), capture.raw(0)
    assert capture.record.exposure.time >= 0


def use_run(path: Path) -> None:
    run = open_run(path.parent)
    rows_of({"a": run})
    deviations(run)


def use_metrics(path: Path) -> None:
    scores = read_json(path, shapes.METRICS)["methods"]
    recovered_shares(scores, dict.fromkeys(scores, "naive"), {})


@pytest.mark.parametrize(
    ("file", "use"),
    [
        ("set/transforms.json", use_transforms), ("capture/capture.json", use_capture), ("run/run.json", use_run),
        ("run/metrics.json", use_metrics),
    ],
)  # fmt: skip
def test_records_with_odd_values_are_used_or_refused_by_name(
    file: str, use: Callable[[Path], None], line: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(line / Path(file).parent, tmp_path / "copy"))
    shutil.rmtree(folder / "sparse", ignore_errors=True)
    path, rng, refused = folder / Path(file).name, random.Random(1), []
    whole = json.loads(path.read_text())
    use(path)
    for _ in range(60):
        path.write_text(json.dumps(mutated(whole, rng)))
        try:
            use(path)
        except ValueError as error:
            refused.append(str(error))
    assert all(str(folder) in text and "\n" not in text for text in refused)
    assert len(refused) >= 8


@pytest.mark.parametrize(
    ("content", "message"),
    [("[" * 100_000, "nested too deeply"), ("[1]", "must be an object"), ("\xff", "not UTF-8"), ("", "not valid JSON"),
     ('{"a": 1' + "0" * 5000 + "}", "digit")],
)  # fmt: skip
def test_files_that_are_no_record_are_refused_by_name(content: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "r.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(ValueError, match=rf"r\.json.*{message}"):
        read_json(tmp_path / "r.json")


def camera_file(folder: Path, **changes: Any) -> Path:
    content = json.loads((folder / "transforms.json").read_text())
    frame = content["frames"][0]
    for name, value in changes.items():
        (frame if name in frame else content)[name] = value
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


POSE = [[1.0, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"w": "800"}, r'w must be a finite number, got "800"'),
        ({"fl_x": 10**400}, r"whole numbers must be below 2"),
        ({"w": 0}, "w must lie between 0 and"),
        ({"fl_x": -3.0}, "fl_x must lie between 0 and"),
        ({"cx": 1e9}, "cx must lie between"),
        ({"k1": 1e30}, "k1 must lie between"),
        ({"frames": {"a": 1}}, "frames must be a list, got"),
        ({"frames": [{"file_path": "x"}]}, r"frames\[0\].transform_matrix must be there"),
        ({"file_path": 3}, r"frames\[0\].file_path must be text, got 3"),
        ({"transform_matrix": POSE[:2]}, r"frames\[0\].transform_matrix must be 4 x 4 finite numbers"),
        ({"transform_matrix": [*POSE[:3], [1, 2, 3, 1]]}, r"must end in the row 0 0 0 1 \(is it transposed\?\)"),
        ({"transform_matrix": [[2.0, 0, 0, 1], *POSE[1:]]}, r"frames\[0\].*must be a rotation and a translation"),
        (
            {"transform_matrix": [[-1.0, 0, 0, 1], *POSE[1:]]},
            r"frames\[0\].*no mirror\); it mirrors, as if one axis or three",
        ),
        ({"transform_matrix": [[1.0, 0, 0, 1e200], *POSE[1:]]}, "coordinates up to 1e"),
        ({"file_path": "y" * 5000}, "File name too long.*rename it"),
    ],
)
def test_a_camera_file_says_what_is_wrong_and_where(
    changes: dict[str, Any], message: str, line: Path, tmp_path: Path
) -> None:
    folder = camera_file(Path(shutil.copytree(line / "set", tmp_path / "set")), **changes)
    with pytest.raises(ValueError, match=message):
        open_source(folder, QUIET)


@pytest.mark.parametrize("part", ["images16", "raw", "truth"])
def test_a_picture_of_another_size_in_a_capture_is_refused_by_name(part: str, line: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(line / "capture", tmp_path / "capture"))
    config = CaptureConfig(sensor="a7s2-iso6400", max_size=28)
    stages.capture(line / "set", tmp_path / "small", config, QUIET)
    (file,) = (folder / part).glob("0002.*")
    shutil.copyfile(tmp_path / "small" / part / file.name, file)
    capture = open_capture(folder)
    read = {"images16": capture.linear16, "raw": capture.raw, "truth": capture.clean}[part]
    with pytest.raises(ValueError, match=rf"{part}/{file.name} must be 32 x 32 px, got 28 x 28"):
        read(2)


def test_truth_that_lacks_a_channel_or_has_another_size_is_refused_by_name(line: Path, tmp_path: Path) -> None:
    from simscenes.sets.pictures.exr import write_exr

    folder = Path(shutil.copytree(line / "set", tmp_path / "set"))
    (folder / "set.json").write_text("{}")
    write_exr(folder / "gt" / "0001.exr", dict.fromkeys("RGB", np.ones((9, 9), np.float32)))
    views = load_set(folder)
    with pytest.raises(ValueError, match=r"0001\.exr must be 32 x 32 px, got 9 x 9"):
        views.radiance(1)
    with pytest.raises(ValueError, match=r"0001\.exr lacks the channels Z, distance, N\.X"):
        views.geometry(1)


def test_small_faults_that_only_many_damaged_files_show(tmp_path: Path) -> None:
    """Rationale: each was found by `python -m tests.fuzz`, in records that looked right but for one value."""
    from novags.testbed.console.terminal import Console
    from novags.testbed.folders.run import Run
    from novags.testbed.folders.runs import runs_in
    from novags.testbed.ledger.code import Code
    from novags.testbed.ledger.contents import UNFINISHED
    from novags.testbed.ledger.stage import _Stage
    from simscenes.job.identity import is_complete, seconds_spent

    deep, quiet = "[" * 3000 + "]" * 3000, Console(quiet=True)
    for name in ("set.json", "seconds.json", "events.jsonl"):
        (tmp_path / name).write_text(deep)
    assert not is_complete(tmp_path, "d", [])
    assert seconds_spent(tmp_path, "d") == {}
    with pytest.raises(ValueError, match=r"events.jsonl, line 1(: it)? is nested (too deeply|more than 64 deep)"):
        Run(tmp_path, {}).events()
    for seconds in ("{}", "[1]", "null", "1" + "0" * 400):
        (tmp_path / UNFINISHED).write_text(f'{{"key": "k", "seconds": {seconds}}}')
        with pytest.raises(ValueError, match=rf"{UNFINISHED}.*(seconds must be a finite number|below 2\*\*64)"):
            _Stage("score", tmp_path, "metrics.json", Code({}, {}), (), (), quiet).earlier_cost({"key": "k"})
    (tmp_path / UNFINISHED).unlink()
    (tmp_path / "experiment.json").write_text('{"command": null, "preset": {}}')
    (tmp_path / "results.json").write_text('{"axes": {"method": []}, "rows": []}')
    with pytest.raises(ValueError, match="holds no finished run"):
        runs_in([tmp_path])
