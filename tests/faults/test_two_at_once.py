"""Two processes that want the same folder: one works there, the other waits or is told who is at work."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from novags.testbed.ledger.contents import read_json
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.exr import read_exr
from simscenes.sets.pictures.png import write_png

VIEWS = 24  # enough that two captures overlap


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("two")
    names, rng = [f"{i:04d}" for i in range(VIEWS)], np.random.default_rng(0)
    write_cameras(folder / "set", names, orbit_rig(VIEWS, 24, 24, 50.0, radius=3.0))
    for name in names:
        write_png(folder / "set" / "images" / f"{name}.png", rng.integers(20, 250, (24, 24, 3)).astype(np.uint8))
    return folder


def electrons(capture: Path) -> tuple[float, set[float]]:
    """Mean signal by the record, and by the images."""
    record = read_json(capture / "capture.json")
    gain, black = record["sensor"]["gain"], record["sensor"]["black_level"]
    views = sorted((capture / "truth").iterdir())
    assert len(views) == VIEWS
    means = [float(read_exr(view)[0]["clean.G"].mean() - black) / gain for view in views]
    return record["electrons"], {min((5.0, 20.0), key=lambda e: abs(e - mean)) for mean in means}


def begins(server, folder: Path, command: list[str]) -> Any:
    """A capture that has stopped in the middle of its work."""
    running = server.start(folder, command, events=command[3], kill=30, signal=signal.SIGSTOP)
    until(running.stopped)
    return running


def until(happens: Callable[[], bool]) -> None:
    give_up = time.monotonic() + 60
    while not happens():
        assert time.monotonic() < give_up
        time.sleep(0.005)


@pytest.mark.parametrize("trial", range(3))
def test_two_captures_at_once_into_one_folder_never_mix(server, photographs: Path, trial: int) -> None:
    command = ["capture", "set", "--out", f"{trial}/capture", "--electrons"]
    results = [running.wait() for running in [server.start(photographs, [*command, e]) for e in ("5", "20")]]
    assert 0 in [result.code for result in results]
    assert all(result.code == 0 or "in use by" in result.line for result in results), [
        result.said for result in results
    ]
    recorded, found = electrons(photographs / str(trial) / "capture")
    assert found == {recorded}


def test_a_folder_in_use_is_refused_in_one_line(server, photographs: Path, page) -> None:
    command = ["capture", "set", "--out", "used/capture"]
    first = begins(server, photographs, command)
    try:
        refused = server.run(photographs, command)
    finally:
        os.kill(first.process, signal.SIGCONT)
    assert refused.code == 1
    assert page["another process writes there"].fullmatch(refused.said.strip()), refused.said
    assert f"(process {first.process} on " in refused.said
    assert first.wait().code == 0


@pytest.mark.parametrize("other", ["20", "5"])
def test_who_waits_comes_second_and_keeps_or_replaces_the_result(server, photographs: Path, page, other: str) -> None:
    command = ["capture", "set", "--out", f"waited {other}/capture", "--wait", "--electrons"]
    first = begins(server, photographs, [*command, "20"])
    try:
        second = server.start(photographs, [*command, other, "--overwrite"])
        until(lambda: second.said("waiting for"))
    finally:
        os.kill(first.process, signal.SIGCONT)
    results = [first.wait(), second.wait()]
    assert [result.code for result in results] == [0, 0], [result.said for result in results]
    assert page["another process writes there, `--wait`"].search(results[1].said)
    assert ("unchanged, kept" in results[1].said) == (other == "20")
    assert electrons(photographs / f"waited {other}" / "capture") == (float(other), {float(other)})


@pytest.mark.parametrize(
    ("name", "reader", "row"),
    [
        ("render", ["capture", "set", "--out", "x"], "input not finished: set"),
        ("capture", ["reconstruct", "capture", "--out", "x"], "input not finished: capture"),
        ("reconstruct", ["score", "run"], "input not finished: run"),
    ],
)
def test_what_is_not_finished_is_not_read(
    server, begun: Callable[..., Path], stages, page, name: str, reader: list[str], row: str
) -> None:
    folder, stage = begun(name), stages[name]
    events = server.run(begun(name, "whole"), stage.command, events=stage.out).events
    middle = next(k for k, event in enumerate(events) if event.endswith(("0001.png", ".exr", "events.jsonl")))
    assert server.run(folder, stage.command, events=stage.out, kill=middle + 3).code == -9
    found = server.run(folder, reader)
    assert found.code == 2
    assert page[row].fullmatch(found.line)
    assert not (folder / "x").exists()
