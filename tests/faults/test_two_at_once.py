"""Two processes that want the same folder: one works there, the other waits or is told who is at work."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from novags.testbed.cache import read_json
from simscenes import orbit_rig
from simscenes.sets.exr import read_exr
from simscenes.sets.multiview import write_cameras
from simscenes.sets.png import write_png

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


@pytest.mark.parametrize("trial", range(3))
def test_two_captures_at_once_into_one_folder_never_mix(server, photographs: Path, trial: int, page) -> None:
    out = f"{trial}/capture"
    both = [
        server.start(photographs, ["capture", "set", "--out", out, "--sensor", "a7s2-iso6400-3chip", "--electrons", e])
        for e in ("5", "20")
    ]
    results = [wait() for wait in both]
    assert sorted(result.code for result in results) == [0, 1], [result.said for result in results]
    refused = next(result for result in results if result.code)
    assert page["another process writes there"].fullmatch(refused.line), refused.said
    assert len(refused.said.strip().splitlines()) == 1
    recorded, found = electrons(photographs / out)
    assert found == {recorded}


def test_who_waits_comes_second_and_the_last_one_stays(server, photographs: Path, page) -> None:
    command = ["capture", "set", "--out", "waited/capture", "--wait", "--electrons"]
    first, second = (server.start(photographs, [*command, e]) for e in ("5", "20"))
    results = [first(), second()]
    assert [result.code for result in results] == [0, 0], [result.said for result in results]
    said = page["another process writes there, `--wait`"]
    waited = [result for result in results if said.search(result.said)]
    assert len(waited) == 1
    recorded, found = electrons(photographs / "waited" / "capture")
    assert found == {recorded}
    assert recorded == (5.0 if waited[0] is results[0] else 20.0)


def test_who_waits_for_the_same_work_keeps_it(server, photographs: Path) -> None:
    command = ["capture", "set", "--out", "same/capture", "--wait"]
    results = [wait() for wait in [server.start(photographs, command) for _ in range(2)]]
    assert [result.code for result in results] == [0, 0]
    assert sum("unchanged, kept" in result.said for result in results) == 1


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
