"""Claims about how often a stage opens the JSON files of the folders that it is made from."""

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders import capture as captures
from novags.testbed.ledger import hashes
from novags.testbed.study.cells.presets import EXPERIMENTS, Preset, adapted
from novags.testbed.study.place import photograph

COUNTED = ("set.json", "capture.json", "transforms.json")
_counting: list[Counter[Path]] = []


def _hear(event: str, about: tuple) -> None:
    """Of every file that Python opens, by whatever function."""
    if event == "open" and _counting and isinstance(about[0], str) and Path(about[0]).name in COUNTED:
        _counting[-1][Path(about[0])] += 1


sys.addaudithook(_hear)


@contextmanager
def counted(folder: Path) -> Iterator[dict[str, int]]:
    """How often each of the files in `folder` is opened meanwhile, by its name there."""
    found: dict[str, int] = {}
    _counting.append(heard := Counter())
    try:
        yield found
    finally:
        _counting.remove(heard)
        found |= {path.relative_to(folder).as_posix(): n for path, n in heard.items() if path.is_relative_to(folder)}


@pytest.fixture(scope="module")
def preset(tmp_path_factory: pytest.TempPathFactory, ball_xml: str) -> Preset:
    scene = tmp_path_factory.mktemp("scene") / "ball.xml"
    scene.write_text(ball_xml)
    return adapted(
        EXPERIMENTS["demo"], scene=str(scene), n_views=4, width=24, height=24, spp=4, points=60,
        iterations=5, methods=("naive",), device="cpu",
    )  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, preset: Preset, quiet: Console) -> Path:
    """A set, a capture of it and a run, written long enough ago that the hashes of their files may be remembered."""
    folder = tmp_path_factory.mktemp("opened")
    stages.reconstruct(photograph(preset, folder, quiet), folder / "run", preset.reconstruct("naive"), quiet)
    time.sleep(hashes.SETTLED / 1e9 + 0.1)  # the time of change cannot be set back
    return folder


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a process that has opened nothing, of a user who has no cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(hashes, "_SEEN", {})
    monkeypatch.setattr(captures, "_OPENED", {})
    hashes._base.cache_clear()


SET = {"set/set.json": 1, "set/transforms.json": 1}
BOTH = {**SET, "capture/capture.json": 1, "capture/transforms.json": 1}


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize("stage", ["capture", "reconstruct", "score"])
def test_a_stage_opens_each_record_and_each_camera_file_of_its_inputs_once(
    made: Path, preset: Preset, quiet: Console, tmp_path: Path, stage: str
) -> None:
    do: dict[str, Callable[[], object]] = {
        "capture": lambda: stages.capture(made / "set", tmp_path / "capture", preset.capture, quiet),
        "reconstruct": lambda: stages.reconstruct(
            made / "capture", tmp_path / "run", preset.reconstruct("naive"), quiet
        ),
        "score": lambda: stages.score(made / "run", quiet),
    }
    with counted(made) as found:
        do[stage]()
    assert found == (SET if stage == "capture" else BOTH)


def test_a_capture_that_was_opened_is_not_shared_with_another_record(made: Path) -> None:
    """Rationale: digests leave costs out, so an edited record that is put back would stay in use."""
    path = made / "capture" / captures.RECORD
    whole = path.read_text()
    first = captures.open_capture(made / "capture")
    assert captures.open_capture(made / "capture") is first
    path.write_text(whole.replace('"seconds": ', '"seconds": 9', 1))
    try:
        assert captures.open_capture(made / "capture").record.stage["seconds"] != first.record.stage["seconds"]
    finally:
        path.write_text(whole)
    assert captures.open_capture(made / "capture").record.stage["seconds"] == first.record.stage["seconds"]
