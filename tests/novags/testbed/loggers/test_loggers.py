"""Claims about loggers: every loss arrives once, under its step; none costs the work anything."""

import io
import json
import re
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.loggers import LOGGERS, Sink
from novags.testbed.loggers import following as module
from novags.testbed.loggers.following import logged

EVENT = {"step": 10, "iteration": 10, "photometric": 0.25, "lost": "inf", "named": None, "wrong": "nan"}
Sent = list[tuple[str, int, dict[str, float]]]


def write(run: Path, *steps: int, end: str = "\n") -> None:
    run.mkdir(exist_ok=True, parents=True)
    with (run / "events.jsonl").open("a") as file:
        file.write("".join(json.dumps(EVENT | {"step": step, "photometric": 1 / step}) + "\n" for step in steps)[:-1])
        file.write(end)


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> Sent:
    """What a logger of the test got; its closing is the step -1."""
    found: Sent = []

    def sink(folder: Path, name: str) -> Sink:
        def add(step: int, values: Mapping[str, float]) -> None:
            found.append((name, step, dict(values)))

        return Sink(add, lambda: found.append((name, -1, {})))

    monkeypatch.setitem(LOGGERS, "tensorboard", sink)
    monkeypatch.setattr(module, "POLL", 0.01)
    return found


def test_lines_arrive_while_the_work_goes_on_and_all_in_the_end(sent: Sent, tmp_path: Path) -> None:
    said, arrived = io.StringIO(), threading.Event()
    with logged(tmp_path / "run", "tensorboard", Console(stream=said)):
        write(tmp_path / "run", 10, 20)
        for _ in range(500):
            if len(sent) == 2:
                break
            arrived.wait(0.01)
        assert [step for _, step, _ in sent] == [10, 20]
        write(tmp_path / "run", 30, end="\n{")  # the next line is being written
    assert [(name, step) for name, step, _ in sent] == [("run", 10), ("run", 20), ("run", 30), ("run", -1)]
    assert sent[1][2] == {"iteration": 10.0, "photometric": 0.05}  # numbers alone, and finite ones
    assert said.getvalue().strip() == f"tensorboard: {tmp_path / 'run.logs' / 'tensorboard'}"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]  # the logger of the test writes nothing


def test_steps_of_before_are_not_sent_again_and_those_after_a_checkpoint_once(sent: Sent, tmp_path: Path) -> None:
    write(tmp_path / "all" / "kept", 10, 20)
    write(tmp_path / "all" / "interrupted", 10, 20, 30)
    with logged(tmp_path / "all", "tensorboard", Console(quiet=True)):
        (tmp_path / "all" / "interrupted" / "events.jsonl").unlink()  # it goes on from a checkpoint
        write(tmp_path / "all" / "interrupted", 10, 20, 30, 40)
        write(tmp_path / "all" / "other", 10)
    assert [each[:2] for each in sent if each[1] > 0] == [("interrupted", 40), ("other", 10)]
    (tmp_path / "all" / "kept" / "events.jsonl").write_text('{"step": "damaged"}\n')
    with logged(tmp_path / "all", "tensorboard", Console(quiet=True)):
        write(tmp_path / "all" / "other", 20)
    assert [each[:2] for each in sent if each[1] > 10] == [("interrupted", 40), ("other", 20)]


def test_a_run_that_begins_anew_where_another_one_was_is_sent_whole(sent: Sent, tmp_path: Path) -> None:
    """Rationale: its steps were taken for steps of the earlier run, and only those beyond it arrived."""
    events = tmp_path / "run" / "events.jsonl"
    write(tmp_path / "run", 10, 20, 30)
    with logged(tmp_path / "run", "tensorboard", Console(quiet=True)):
        text = events.read_text().replace("0.1", "0.7").replace("0.05", "0.6")
        events.write_text(text + text.splitlines()[0].replace("10", "40") + "\n")
    assert [(step, values["photometric"]) for _, step, values in sent if step > 0] == [
        (10, 0.7), (20, 0.6), (30, 1 / 30), (40, 0.7)
    ]  # fmt: skip


def test_a_logger_that_fails_costs_a_note_and_no_work(
    sent: Sent, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(folder: Path, name: str) -> Sink:
        raise OSError("the disk is full")

    monkeypatch.setitem(LOGGERS, "tensorboard", broken)
    said = io.StringIO()
    with logged(tmp_path / "run", "tensorboard", Console(stream=said)):
        write(tmp_path / "run", 10)
    assert "--log tensorboard ended with an error, and the work went on: OSError: the disk is full" in said.getvalue()
    with pytest.raises(ZeroDivisionError), logged(tmp_path / "run", "tensorboard", Console(quiet=True)):
        raise ZeroDivisionError  # of the work, not of the logger


def test_without_its_package_nothing_begins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    with (
        pytest.raises(ValueError, match=r"--log rerun needs its package, which is not installed: pip install .*rerun"),
        logged(tmp_path, "rerun", Console(quiet=True)),
    ):
        raise AssertionError
    with logged(tmp_path, None, Console(quiet=True)):
        pass


def test_tensorboard_shows_every_value(tmp_path: Path) -> None:
    reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    with logged(tmp_path / "run", "tensorboard", Console(quiet=True)):
        write(tmp_path / "run", 10, 20, 40)
    found = reader.EventAccumulator(str(tmp_path / "run.logs" / "tensorboard" / "run"))
    found.Reload()
    assert sorted(found.Tags()["scalars"]) == ["iteration", "photometric"]
    shown = [(each.step, each.value) for each in found.Scalars("photometric")]
    assert shown == [(10, pytest.approx(0.1)), (20, pytest.approx(0.05)), (40, pytest.approx(0.025))]


def wandb_records(data: bytes) -> Iterator[bytes]:
    """The records of a .wandb file: LevelDB's log format, in blocks of 32 KiB, after a header of seven bytes."""
    place, whole = 7, b""
    while place + 7 <= len(data):
        if 32768 - place % 32768 < 7:  # no header fits into the rest of the block
            place += 32768 - place % 32768
            continue
        _, length, kind = struct.unpack("<IHB", data[place : place + 7])
        whole += data[place + 7 : place + 7 + length]
        place += 7 + length
        if kind in (1, 4):  # the only, or the last part of one
            yield whole
            whole = b""


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning", "ignore::UserWarning")
def test_wandb_keeps_every_value_offline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wandb = pytest.importorskip("wandb")
    records = pytest.importorskip("wandb.proto.wandb_internal_pb2")
    for name, value in {"WANDB_MODE": "offline", "WANDB_SILENT": "true", "WANDB_DIR": str(tmp_path)}.items():
        monkeypatch.setenv(name, value)
    with logged(tmp_path / "run", "wandb", Console(quiet=True)):
        write(tmp_path / "run", 10, 20, 40)
    wandb.teardown()  # its service writes; what ends a process waits for it, too
    (file,) = (tmp_path / "run.logs" / "wandb").rglob("*.wandb")
    found = []
    for data in wandb_records(file.read_bytes()):
        record = records.Record()
        record.ParseFromString(data)
        items = {item.key or ".".join(item.nested_key): json.loads(item.value_json) for item in record.history.item}
        if items:
            found.append((items["_step"], items["photometric"]))
    assert found == [(10, 0.1), (20, 0.05), (40, 0.025)]


def test_rerun_keeps_every_value(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    for steps in ((10, 20, 40), (50,)):
        with logged(tmp_path / "run", "rerun", Console(quiet=True)):
            write(tmp_path / "run", *steps)
    second, first = sorted((tmp_path / "run.logs" / "rerun").iterdir())
    assert (first.name, second.name) == ("run.rrd", "run-1.rrd")
    for file, rows, values in ((first, 3, ("0.1", "0.05", "0.025")), (second, 1, ("0.02",))):
        told = subprocess.run([sys.executable, "-m", "rerun", "rrd", "print", "-vvv", str(file)], capture_output=True,
                              text=True, check=True).stdout  # fmt: skip
        (chunk,) = re.findall(rf"with {rows} rows [^\n]* - /photometric .*?(?=Chunk|\Z)", told, re.S)
        assert [value for value in values if f"[{value}]" not in chunk] == []
