"""What `novags study` does when something fails: a line that says what to do, or the work again; no wrong table."""

import ctypes
import json
import os
import resource
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from novags import cli
from novags.testbed.ledger import code as codes
from novags.testbed.ledger import reach, stage
from novags.testbed.ledger import store as stores
from novags.testbed.study import conduct
from novags.testbed.study.engines import choice, processes

pytestmark = [
    # A fork of this process has imported everything: seconds less for each command. Windows has no fork.
    pytest.mark.skipif(not hasattr(os, "fork"), reason="the tests start commands by os.fork, which this system lacks"),
    pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork.*:DeprecationWarning"),
]
HERE = Path(__file__).resolve().parent
STUDY = """
[grid]
scene = "cornell"
electrons = [5, 20]
method = ["naive", "oracle"]
"""


class Started:
    """A command in a child of this process, which has everything loaded."""

    def __init__(self, folder: Path, words: tuple[str, ...], prepare: Callable[[], Any]) -> None:
        self.log = folder / "said"
        self.process = os.fork()
        if self.process == 0:
            code = 1
            try:
                out = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
                os.dup2(out, 1)
                os.dup2(out, 2)
                sys.stdout, sys.stderr = (open(n, "w", buffering=1, closefd=False) for n in (1, 2))
                os.chdir(folder)
                prepare()
                sys.argv = ["novags", "study", "study.toml", "--out", "out", "--workers", "1", *words]
                cli.main()
                code = 0
            except SystemExit as stop:
                code = stop.code if isinstance(stop.code, int) else 1
            finally:
                os._exit(code)

    def wait(self) -> tuple[int, str]:
        _, status = os.waitpid(self.process, 0)
        return os.waitstatus_to_exitcode(status), self.log.read_text()


@pytest.fixture
def start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Started]:
    """Start `novags study` on stages that compute nothing."""
    monkeypatch.syspath_prepend(str(HERE))
    for module in (processes, choice):
        monkeypatch.setattr(module, "TASKS", "counting_steps:make")
    monkeypatch.setattr(stage, "environment", stage.environment)  # which `counting_steps` changes where it is loaded
    order = choice.Order

    def light(task: Any, *rest: Any) -> Any:  # so that workers need not load torch
        return order(type(task)(**{**vars(task), "config": task.config.resolved()}), *rest)

    monkeypatch.setattr(choice, "Order", light)
    (tmp_path / "study.toml").write_text(STUDY)

    def begin(*words: str, folder: Path = tmp_path, prepare: Callable[[], Any] = lambda: None) -> Started:
        return Started(folder, words, prepare)

    return begin


@pytest.fixture
def run(start: Callable[..., Started]) -> Callable[..., tuple[int, str]]:
    return lambda *words, **more: start(*words, **more).wait()


def expected(row: dict[str, Any]) -> float:
    """The score of a run by its axes."""
    from counting_steps import value_of

    return value_of(f"scene {row['scene']}, {row['electrons']:g} e-, seed {row['seed']}, {row['method']} {row['seed']}")


def rows(folder: Path) -> list[dict[str, Any]]:
    """The rows of the table; every score in it must be the one of its run."""
    found: list[dict[str, Any]] = json.loads((folder / "out" / "results.json").read_text())["rows"]
    for row in found:
        assert ("lit.psnr" in row) == (row["state"] == "done")
        assert row.get("lit.psnr") in (None, expected(row))
    return found


def states(folder: Path) -> list[str]:
    return [row["state"] for row in rows(folder)]


def made(folder: Path) -> list[str]:
    return (folder / "made").read_text().splitlines()


def one_line(said: str) -> str:
    (line,) = [line for line in said.splitlines() if line.startswith("novags: ")]
    assert "Traceback" not in said
    return line


def test_failed_runs_keep_their_rows_until_they_are_tried_again(
    run: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    (tmp_path / "faults").write_text("capture 20 refused\nrun oracle refused")
    code, said = run()
    assert code == 1
    assert "--retry-failed" in said
    found = rows(tmp_path)
    assert [row["state"] for row in found] == ["done", "failed", "skipped", "skipped"]
    assert found[1]["reason"] == found[2]["reason"] == "it does not suit me"
    assert (found[1]["stage"], found[2]["stage"]) == ("write", "write")
    assert "making scene cornell, 20 e-" in (tmp_path / "out" / found[2]["log"]).read_text()
    before = made(tmp_path)
    (tmp_path / "faults").unlink()
    assert run()[0] == 1  # nothing is tried again unless asked for
    assert rows(tmp_path) == found
    assert made(tmp_path) == before
    assert run("--retry-failed")[0] == 0
    assert states(tmp_path) == ["done"] * 4
    again = made(tmp_path)[len(before) :]
    assert sorted(line.split(":")[0] for line in again) == ["capture"] + ["run"] * 3


def test_an_interruption_or_a_kill_of_a_later_start_costs_no_finished_row(
    run: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    def stopped(self: Any, work: Any) -> None:
        raise KeyboardInterrupt

    def killed(*told: Any, **more: Any) -> None:
        os._exit(9)

    assert run()[0] == 0
    found, text = rows(tmp_path), (tmp_path / "study.toml").read_text()
    assert run(prepare=lambda: setattr(choice.OneMachine, "run", stopped))[0] != 0
    assert rows(tmp_path) == found
    more = text.replace("[5, 20]", "[1, 5, 20]")
    (tmp_path / "study.toml").write_text(more)
    assert run(prepare=lambda: setattr(choice.OneMachine, "run", stopped))[0] != 0
    assert states(tmp_path) == ["waiting"] * 2 + ["done"] * 4
    assert [row["run"] for row in rows(tmp_path)] == [1, 2, 3, 4, 5, 6]
    (tmp_path / "study.toml").write_text(text.replace("[5, 20]", "[5]"))
    code, said = run()
    assert code == 2
    assert "holds 2 finished runs (scene cornell, electrons 20" in one_line(said)
    (tmp_path / "study.toml").write_text(text)
    assert run()[0] == 0
    assert rows(tmp_path) == found
    (tmp_path / "study.toml").write_text(more)
    assert run(prepare=lambda: setattr(conduct, "conduct", killed))[0] == 9  # study.json is new, the tables are not
    (tmp_path / "study.toml").write_text(text)
    assert run()[0] == 0
    assert rows(tmp_path) == found


def test_a_damaged_table_is_refused_and_made_again_where_it_may_be_overwritten(
    run: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    assert run()[0] == 0
    found, before = rows(tmp_path), made(tmp_path)
    (tmp_path / "out" / "results.json").write_text('{"rows": [{"sta')
    code, said = run()
    assert code == 2
    assert "results.json" in one_line(said)
    assert run("--overwrite")[0] == 0
    assert rows(tmp_path) == found
    assert made(tmp_path) == before


@pytest.mark.parametrize(("how", "said"), [("full", "No space left on device"), ("read-only", "Read-only file system")])
def test_a_fault_of_the_disk_in_a_stage_stops_the_study_and_fails_no_run(
    run: Callable[..., tuple[int, str]], tmp_path: Path, how: str, said: str
) -> None:
    (tmp_path / "faults").write_text(f"run oracle {how}")
    code, text = run()
    assert code == 1
    assert said in one_line(text)
    assert "finished work is kept; fix that and run the same command again" in one_line(text)
    assert set(states(tmp_path)) <= {"done", "waiting"}
    before = made(tmp_path)
    (tmp_path / "faults").unlink()
    assert run()[0] == 0
    assert states(tmp_path) == ["done"] * 4
    assert len(made(tmp_path)) - len(set(made(tmp_path))) == 1  # the one that was under way
    assert made(tmp_path)[: len(before)] == before


def test_a_full_disk_is_one_line_wherever_it_shows_first(run: Callable[..., tuple[int, str]], tmp_path: Path) -> None:
    for size in (500, 5000):  # too little for study.json; enough for that, but not for an entry
        code, said = run(prepare=lambda size=size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)))
        assert code == 1
        assert "File too large" in one_line(said)
        assert not (tmp_path / "out" / "results.json").exists() or "done" not in states(tmp_path)
        assert not list(tmp_path.rglob("*.partial*"))
    assert run()[0] == 0
    assert states(tmp_path) == ["done"] * 4


def bound_by_permissions() -> None:
    """Give up root's right to write where the permission bits forbid it, for this process and those it starts."""
    if os.geteuid() == 0:
        libc = ctypes.CDLL(None, use_errno=True)
        header, data = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
        assert libc.prctl(24, 1, 0, 0, 0) == 0  # PR_CAPBSET_DROP, CAP_DAC_OVERRIDE
        assert libc.capget(header, data) == 0
        for word in (0, 1):
            data[word] &= ~(1 << 1)  # effective and permitted
        assert libc.capset(header, data) == 0


# Root may write anywhere. Only Linux can take that right from a process alone, by its capabilities.
@pytest.mark.skipif(sys.platform != "linux", reason="takes the rights of root away by Linux capabilities")
def test_a_folder_that_may_not_be_written_to_is_one_line_and_finished_work_can_be_read_there(
    run: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    (tmp_path / "store").mkdir(mode=0o555)
    code, said = run(prepare=bound_by_permissions)
    assert (code, "Permission denied" in one_line(said)) == (1, True)
    assert not (tmp_path / "made").exists()
    (tmp_path / "store").chmod(0o755)
    assert run(prepare=bound_by_permissions)[0] == 0
    before = (rows(tmp_path), made(tmp_path))
    folders = [path for path in (tmp_path / "store").rglob("*") if path.is_dir()]
    for path in (*folders, tmp_path / "store"):
        path.chmod(0o555)
    try:
        assert run(prepare=bound_by_permissions)[0] == 0  # nothing has to be written there
        assert (rows(tmp_path), made(tmp_path)) == before
    finally:
        for path in (tmp_path / "store", *folders):
            path.chmod(0o755)


def test_what_is_damaged_in_the_store_is_made_again_and_nothing_else(
    run: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    assert run()[0] == 0
    whole, count = rows(tmp_path), len(made(tmp_path))
    store = tmp_path / "store"
    set_, capture = next((store / "set").glob("cornell*")), next((store / "capture").glob("cornell*-5e*"))
    run_ = next((store / "run").glob("oracle-cornell*20e*"))
    other = next((store / "run").glob("naive-cornell*20e*"))
    (set_ / "content.txt").write_text("scene nowhere")
    shutil.copy(capture / "large.txt", capture / "content.txt")
    (run_ / stores.SEAL).write_text("{")
    (run_ / "metrics.json").write_text((run_ / "metrics.json").read_text().replace('"psnr": ', '"psnr": 9'))
    shutil.copy(other / "metrics.json", next((store / "run").glob("naive-cornell*-5e*")) / "metrics.json")
    assert run()[0] == 0
    assert [row["lit.psnr"] for row in rows(tmp_path)] == [row["lit.psnr"] for row in whole]
    again = made(tmp_path)[count:]
    assert sorted(again) == sorted(["set: scene cornell", "capture: scene cornell, 5 e-, seed 0",
                                    "run: scene cornell, 20 e-, seed 0, oracle 0"])  # fmt: skip
    assert count == len(made(tmp_path)) - len(again)
    assert run()[0] == 0
    assert made(tmp_path)[count:] == again


def test_a_clock_that_runs_backwards_and_files_from_the_future_change_nothing(
    run: Callable[..., tuple[int, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def backwards() -> None:
        start, now = time.time(), time.time
        os.environ["CLOCK"] = "backwards"
        time.time = lambda: 2 * start - now()  # type: ignore[assignment]
        time.time_ns = lambda: int(1e9 * time.time())  # type: ignore[assignment]

    assert run(prepare=backwards)[0] == 0
    assert states(tmp_path) == ["done"] * 4
    before = made(tmp_path)
    future = time.time() + 1e7
    for path in tmp_path.rglob("*"):
        os.utime(path, (future, future))
    (tmp_path / "study.toml").write_text(STUDY.replace("[5, 20]", "[5, 20, 80]"))
    assert run(prepare=backwards)[0] == 0
    assert states(tmp_path) == ["done"] * 6
    assert len(made(tmp_path)) == len(set(made(tmp_path))) == len(before) + 3


def test_two_versions_of_novags_share_a_store_and_no_entry_that_their_code_makes_otherwise(
    run: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    for name in ("novags", "simscenes", "sensor_model"):
        shutil.copytree(
            Path(codes.ROOT) / name, tmp_path / "other" / name, ignore=shutil.ignore_patterns("__pycache__")
        )
    changed = tmp_path / "other" / "novags" / "testbed" / "stages" / "capturing.py"
    changed.write_text(changed.read_text() + "ANOTHER = 1\n")

    def workers_of_another() -> None:
        sys.path.insert(0, str(tmp_path / "other"))

    def another() -> None:
        workers_of_another()
        codes.ROOT = reach.ROOT = str(tmp_path / "other")
        for remembered in (codes._code_of, codes._beside, codes._content, reach._module, reach._next, reach._of_ours):
            remembered.cache_clear()

    assert run()[0] == 0
    first, count = rows(tmp_path), len(made(tmp_path))
    code, said = run("--overwrite", "--store", "mixed", prepare=workers_of_another)
    assert (code, "is another version than the planner of this study" in one_line(said)) == (1, True)
    assert set(states(tmp_path)) == {"waiting"}
    count = len(made(tmp_path))  # sets are made alike by both
    assert run(prepare=another)[0] == 0
    assert [row["lit.psnr"] for row in rows(tmp_path)] == [row["lit.psnr"] for row in first]
    # The captures come out equal, and so the runs of before are kept under their new keys.
    assert sorted(line.split(":")[0] for line in made(tmp_path)[count:]) == ["capture"] * 2
    assert not {row["folder"] for row in rows(tmp_path)} & {row["folder"] for row in first}
    count = len(made(tmp_path))
    assert run()[0] == 0
    assert rows(tmp_path) == first
    assert len(made(tmp_path)) == count


def test_two_studies_at_once_make_what_they_share_once_though_a_third_was_killed_there(
    start: Callable[..., Started], tmp_path: Path
) -> None:
    (tmp_path / "faults").write_text("capture cornell slow0.3\nset cornell slow0.3")
    killed = start()
    give_up = time.monotonic() + 120
    while not list((tmp_path / "store").glob("set/*/.novags.lock")) and time.monotonic() < give_up:
        time.sleep(0.005)
    os.kill(killed.process, 9)
    assert killed.wait()[0] == -9
    left = made(tmp_path) if (tmp_path / "made").exists() else []
    (tmp_path / "two").mkdir()
    (tmp_path / "two" / "study.toml").write_text(STUDY.replace('"oracle"]', '"nova-fast"]'))
    both = [start(), start("--store", "../store", folder=tmp_path / "two")]
    assert [each.wait()[0] for each in both] == [0, 0]
    assert states(tmp_path) == states(tmp_path / "two") == ["done"] * 4
    after = made(tmp_path)[len(left) :]
    assert len(after) == len(set(after))
    assert set(made(tmp_path)) == set(after) | set(left)
    assert sorted(line.split(":")[0] for line in set(made(tmp_path))) == ["capture"] * 2 + ["run"] * 6 + ["set"]
    assert not list((tmp_path / "store").rglob("*.partial*"))
