"""Claims about files of a set, a capture or a run that are not as they were written: another view's, or edited ones.

Every command that reads such a folder says which file is wrong; what a command does not read changes nothing for it.
"""

import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.ledger import hashes
from novags.testbed.ledger.contents import HOW, read_digest

CAMERAS = ("transforms.json", "sparse/0/cameras.bin", "sparse/0/images.bin", "sparse/0/points3D.bin",
           "sparse/0/rigs.bin", "sparse/0/frames.bin", "points3D.ply", "nb-info.json", "train_list.txt",
           "test_list.txt", "val_list.txt")  # fmt: skip
# One file of every kind that a folder holds.
KINDS = {
    "set": ("gt/0003.exr", "images/0003.png", "depths/0003.png", *CAMERAS),
    "capture": ("raw/0003.dng", "images16/0003.png", "images/0003.png", "truth/0003.exr", *CAMERAS),
    "naive": ("point_cloud.ply", "cameras.json", "events.jsonl", "enhanced/0003.png", "renders/0008.png",
              "renders_train/0003.png", "exr/0008.exr"),
}  # fmt: skip
FILES = [f"{folder}/{kind}" for folder, kinds in KINDS.items() for kind in kinds]
RECORDS = ("set/set.json", "capture/capture.json", "naive/run.json", "naive/metrics.json")
LINE = tuple(KINDS)
SCORES = RECORDS[-1]
PICTURE = "renders/0008.png"  # the kind that scores of pictures read of a run
OTHERS = tuple(file for file in (*FILES, *RECORDS) if file.startswith("naive/") and not file.endswith(PICTURE))


@dataclass(frozen=True)
class Command:
    """What is typed, the folders that it reads, and which of their files it does not."""

    words: str
    folders: tuple[str, ...]
    unread: tuple[str, ...] = ()

    def reads(self, file: str) -> bool:
        return file.split("/")[0] in self.folders and file not in self.unread


OF_SET = tuple(file for file in (*FILES, *RECORDS) if file.startswith("set/"))
COMMANDS = {
    "plan": Command("plan set --sensor a7s2-iso6400-3chip --electrons 20", ("set",)),
    "capture": Command("capture set --out out", ("set",)),
    "capture of a capture": Command("capture capture --out out", ("capture",), OF_SET),
    "import": Command("import set --out out", ("set",)),
    "import with lit": Command("import capture --out out --lit set", ("capture", "set")),
    "denoise": Command("denoise capture --out out --no-adapt --turns 1", ("capture",), OF_SET),
    "reconstruct": Command("reconstruct capture --out out --method naive --points 60 --iterations 5",
                           ("set", "capture")),
    "score": Command("score naive", LINE, (SCORES,)),  # which it makes again, as another test says
    "score pictures": Command("score --renders naive/renders --set set --out out", ("set", "naive"), OTHERS),
    "score clean": Command("score --renders naive/renders --set capture --reference clean --out out", LINE, OTHERS),
    "report": Command("report naive --out out", LINE),
    "report on a study": Command("report study --out out", LINE),
    "export-results": Command("export-results naive --out out", LINE, (SCORES,)),
    "video": Command("video naive --out out.mp4 --seconds 0.2", LINE, (SCORES,)),
    "view": Command("view naive", LINE, (SCORES,)),
}  # fmt: skip


@pytest.fixture
def place(experiment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A set, a capture, a scored run, and the tables of a study that has this run alone; the working directory."""
    monkeypatch.setattr("novags.testbed.viewer.server.check_installed", lambda: None)
    monkeypatch.setattr("novags.testbed.viewer.server.serving", serving)
    monkeypatch.delenv(hashes.VERIFY, raising=False)
    return copied(experiment, tmp_path / "place", monkeypatch)


@contextmanager
def serving(*_: object) -> Iterator[None]:
    """All is opened, and Ctrl-C pressed."""
    raise KeyboardInterrupt
    yield


def copied(experiment: Path, place: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for folder in LINE:
        shutil.copytree(experiment / folder, place / folder)
    score = json.loads((place / SCORES).read_text())["methods"]["naive"]["mean"]["enhanced"]["aligned_psnr"]
    row = {"state": "done", "run": 1, "method": "naive", "folder": "../naive", "enhanced.aligned_psnr": score}
    (place / "study").mkdir()
    (place / "study" / "study.json").write_text(json.dumps({"file": "study.toml", "table": {}}))
    (place / "study" / "results.json").write_text(json.dumps({"axes": {"method": ["naive"]}, "rows": [row]}))
    monkeypatch.chdir(place)
    return place


def exchange(file: Path) -> None:
    """Put another view's file in its place, or change a number or a byte of it; its size stays where that is edited."""
    before = file.read_bytes()
    others = (path for path in sorted(file.parent.iterdir()) if path.stem.isdigit())
    if file.stem.isdigit():
        file.write_bytes(next(content for path in others if (content := path.read_bytes()) != before))
    elif file.suffix in (".json", ".jsonl", ".txt"):
        text = before.decode()
        number = re.search(r"(?<=[\s:])\d+\.\d\d+", text) or re.search(r"\d+", text)
        assert number is not None
        # The first digit behind the point: of 17 digits the last may not change the number.
        at = number.start() + number[0].index(".") + 1 if "." in number[0] else number.end() - 1
        file.write_text(f"{text[:at]}{(int(text[at]) + 1) % 10}{text[at + 1 :]}")
    else:
        middle = len(before) // 2
        file.write_bytes(before[:middle] + bytes([before[middle] ^ 1]) + before[middle + 1 :])


def refusal(name: str, file: str, call: Callable[..., int], capsys: pytest.CaptureFixture[str]) -> str:
    """How a command refuses an exchanged file: "" if it says so by name, else what it said last."""
    code, said = call(*COMMANDS[name].words.split()), capsys.readouterr().err
    if name == "report on a study" and code == 0:  # the page of all runs says what it leaves out, and why
        code, said = 2, Path("out").read_text()
        Path("out").unlink()
    folder, _, inside = file.partition("/")
    of_record = f"{folder} has changed since" in said and file in RECORDS
    named = f"{folder}: {inside} not as written (checksum)" in said or of_record
    return "" if code == 2 and named else f"{code}: {said.strip().splitlines()[-1:]}"[:300]


def test_the_table_has_every_kind_of_file(place: Path) -> None:
    views = [path for path in place.rglob("*") if path.is_file() and path.stem.isdigit()]
    there = {path.relative_to(place).parent for path in views}
    assert there == {Path(file).parent for file in FILES if Path(file).stem.isdigit()}
    visible = [path for folder in LINE for path in (place / folder).rglob("*") if path.name[0] != "."]
    single = {path.relative_to(place).as_posix() for path in visible if path.is_file() and path not in views}
    assert single == {file for file in (*FILES, *RECORDS) if not Path(file).stem.isdigit()}


@pytest.mark.parametrize("file", FILES)
def test_every_command_that_reads_an_exchanged_file_names_it(
    file: str, place: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    exchange(place / file)
    readers = [name for name, command in COMMANDS.items() if command.reads(file)]
    assert len(readers) >= 5
    assert {name: said for name in readers if (said := refusal(name, file, call, capsys))} == {}


@pytest.mark.parametrize(
    ("file", "name"),
    [(file, name) for file in RECORDS for name, command in COMMANDS.items() if command.reads(file)],
)
def test_every_command_that_reads_an_edited_record_names_it(
    file: str, name: str, place: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    exchange(place / file)
    assert refusal(name, file, call, capsys) == ""


def test_edited_scores_are_made_again(
    place: Path, call: Callable[..., int], without_costs: Callable[[Any], Any]
) -> None:
    before = without_costs(json.loads((place / SCORES).read_text()))
    exchange(place / SCORES)
    assert call("score", "naive") == 0
    assert without_costs(json.loads((place / SCORES).read_text())) == before


LEAVING = [name for name, command in COMMANDS.items() if command.unread and name != "score"]


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in LEAVING])
def test_an_equal_copy_is_not_exchanged(name: str, place: Path, call: Callable[..., int]) -> None:
    """Rationale: an archive that is unpacked elsewhere has the same files with other times."""
    assert call(*COMMANDS[name].words.split()) == 0
    assert name != "report on a study" or "not as written" not in Path("out").read_text()


@pytest.mark.parametrize("name", LEAVING)
def test_a_file_that_a_command_does_not_read_changes_nothing(
    name: str, experiment: Path, place: Path, tmp_path: Path, call: Callable[..., int],
    capsys: pytest.CaptureFixture[str], without_costs: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    found = []
    for where in (place, copied(experiment, tmp_path / "exchanged", monkeypatch)):
        monkeypatch.chdir(where)
        if where != place:
            for file in COMMANDS[name].unread:
                exchange(where / file)
        assert call(*COMMANDS[name].words.split()) == 0
        found.append((capsys.readouterr().out, made(where, without_costs)))
    assert found[0] == found[1]
    assert name == "view" or found[0][1]


def made(place: Path, without_costs: Callable[[Any], Any]) -> dict[str, Any]:
    """The content of every file that a command wrote, without costs and dates."""
    files = [path for out in place.glob("out*") for path in (out, *out.rglob("*")) if path.is_file()]

    def content(path: Path) -> Any:
        text = path.read_bytes()
        if path.suffix != ".json":
            return text
        return without_costs(json.loads(re.sub(rb'("\w*datetime": )"[^"]*"', rb"\1null", text)))

    return {path.relative_to(place).as_posix(): content(path) for path in files}


@pytest.fixture
def memory(place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Hashes are remembered in a data base of this test, also those of files that were just written."""
    later = hashes.time.time_ns() + 10 * hashes.SETTLED
    monkeypatch.setattr("novags.testbed.ledger.hashes.time.time_ns", lambda: later)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    hashes._base.cache_clear()
    yield
    hashes._base.cache_clear()


@pytest.mark.usefixtures("memory")
@pytest.mark.parametrize("file", ["capture/raw/0003.dng", "naive/point_cloud.ply", "set/sparse/0/images.bin"])
def test_an_edit_that_keeps_size_and_time_is_seen_and_verify_sees_one_that_keeps_the_stamp_too(
    file: str, place: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    edited, before = place / file, os.stat(place / file)
    original = read_digest(edited)
    assert call("view", "naive") == 0  # the hashes of all files are remembered now
    base = hashes._base(HOW, os.getpid())
    assert base.find((*hashes.stamp_of(edited), edited.suffix)) == original
    exchange(edited)
    os.utime(edited, ns=(before.st_atime_ns, before.st_mtime_ns))
    after = os.stat(edited)
    assert (after.st_ino, after.st_size, after.st_mtime_ns) == (before.st_ino, before.st_size, before.st_mtime_ns)
    assert refusal("view", file, call, capsys) == ""  # by its time of change, which no user can set
    base.keep((*hashes.stamp_of(edited), edited.suffix), original)  # as if the clock had stood still
    hashes._SEEN.clear()
    assert call("view", "naive") == 0
    capsys.readouterr()
    assert call("--verify", "view", "naive") == 2
    assert f"{Path(file).relative_to(Path(file).parts[0])} not as written (checksum)" in capsys.readouterr().err
