"""Claims about a store at a URL, and about what a node of a cluster does with a task; without a cluster."""

import itertools
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.ledger.source import hashed
from novags.testbed.ledger.store import SEAL
from novags.testbed.study.elsewhere import nodes as elsewhere
from novags.testbed.study.elsewhere.nodes import Away
from novags.testbed.study.elsewhere.remote import FETCHED, Remote
from novags.testbed.study.engines import node
from novags.testbed.study.engines.needs import Needs, fits, read_needs, resources
from novags.testbed.study.engines.worker import Outcome
from novags.testbed.study.entry import Order
from novags.testbed.study.plan import StudyPlan

fsspec = pytest.importorskip("fsspec")
QUIET = Console(quiet=True)
counter = itertools.count()


@pytest.fixture(params=["memory", "file"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return f"memory://store{next(counter)}" if request.param == "memory" else f"file://{tmp_path}/remote"


@pytest.fixture
def tasks(fake: ModuleType) -> list[Any]:
    return [fake.task("a"), fake.task("b", "a")]


@pytest.fixture
def make(
    fake: ModuleType, tasks: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., dict[str, Any]]:
    """Make `b`, or find it, on a node with a disk of its own."""

    def on(disk: str, url: str, chain: Any = None) -> dict[str, Any]:
        chain = tuple(tasks) if chain is None else chain
        away = Away(chain, (1,) * len(chain), url, str(tmp_path / disk), "fake_stages:make")
        return elsewhere.make(away, QUIET)

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return on


def scratch(tmp_path: Path, disk: str) -> Path:
    return elsewhere.scratch_folder(tmp_path / disk)


def count(tmp_path: Path, disk: str, key: str) -> int:
    path = scratch(tmp_path, disk) / "run" / f".{key}.count"
    return len(path.read_text()) if path.exists() else 0


def files(url: str) -> dict[str, bytes]:
    fs, root = fsspec.core.url_to_fs(url)
    return {str(path)[len(root) :]: fs.cat_file(path) for path in fs.find(root)}


def write(url: str, name: str, content: bytes) -> None:
    fs, root = fsspec.core.url_to_fs(url)
    fs.pipe_file(f"{root}/{name}", content)


def test_a_node_fetches_what_another_made_and_the_store_is_laid_out_as_on_a_disk(
    make: Callable[..., dict[str, Any]], tasks: list[Any], url: str, tmp_path: Path
) -> None:
    first = make("one", url)
    assert (first["made"], count(tmp_path, "one", "a"), count(tmp_path, "one", "b")) == (True, 1, 1)
    folder = scratch(tmp_path, "one") / "run"
    local = {f"/run/{p.relative_to(folder).as_posix()}": p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    apart = (".count", ".process", "/.made.json")  # what tests count; and what explains, without being sealed
    assert files(url) == {
        name: content for name, content in local.items() if not name.endswith(apart) and "/.same/" not in name
    }
    second = make("two", url)
    assert (second["made"], second["content"]) == (False, first["content"])
    assert count(tmp_path, "two", "a") + count(tmp_path, "two", "b") == 0
    assert (scratch(tmp_path, "two") / "run" / "b" / "2.txt").read_text() == "b2(a0()a1()a2()a3())"


@pytest.mark.parametrize("harm", ["changed", "gone", "seal cut", "seal of another", "seal gone", "path"])
def test_what_is_damaged_in_the_store_is_made_again_where_it_is_needed(
    make: Callable[..., dict[str, Any]], tasks: list[Any], url: str, tmp_path: Path, harm: str
) -> None:
    make("one", url)
    whole = {name: content for name, content in files(url).items() if name.endswith(".txt")}
    seal = files(url)[f"/run/a/{SEAL}"]
    fs, root = fsspec.core.url_to_fs(url)
    if harm == "changed":
        write(url, "run/a/1.txt", b"a1[]")
    elif harm == "gone":
        fs.rm_file(f"{root}/run/a/1.txt")
    elif harm == "seal cut":
        write(url, f"run/a/{SEAL}", seal[:50])
    elif harm == "seal of another":
        write(url, f"run/a/{SEAL}", files(url)[f"/run/b/{SEAL}"])
    elif harm == "seal gone":
        fs.rm_file(f"{root}/run/a/{SEAL}")
    else:
        record = files(url)["/run/a/made.json"]
        hostile = record.replace(b'"1.txt"', b'"../../1.txt"')
        assert hostile != record
        write(url, "run/a/made.json", hostile)
        write(url, f"run/a/{SEAL}", seal.replace(hashed(record).encode(), hashed(hostile).encode()))
    make("two", url)
    assert [count(tmp_path, "two", key) for key in "ab"] == [1, 0]
    assert {name: content for name, content in files(url).items() if name.endswith(".txt")} == whole
    make("three", url)
    assert [count(tmp_path, "three", key) for key in "ab"] == [0, 0]
    assert not list(tmp_path.rglob(FETCHED))


def test_what_a_killed_node_has_half_fetched_is_not_believed(
    make: Callable[..., dict[str, Any]], tasks: list[Any], url: str, tmp_path: Path
) -> None:
    make("one", url)
    whole = files(url)
    half = scratch(tmp_path, "two") / "run" / "a"
    half.mkdir(parents=True)
    (half / FETCHED).write_bytes(whole[f"/run/a/{SEAL}"])
    (half / "made.json").write_bytes(whole["/run/a/made.json"])  # a record that says that all is there
    fs, root = fsspec.core.url_to_fs(url)
    fs.rm_file(f"{root}/run/a/{SEAL}")
    make("two", url)
    assert (half / "3.txt").read_bytes() == whole["/run/a/3.txt"]
    assert count(tmp_path, "two", "a") == 1


def test_a_study_knows_finished_entries_by_their_seals_alone(
    make: Callable[..., dict[str, Any]], tasks: list[Any], url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(elsewhere, "depends", lambda task: {})
    plan = StudyPlan(None, {task.key: task for task in tasks}, ())  # type: ignore[arg-type]
    here = tmp_path / "here"
    assert elsewhere.known(plan, Remote(url), here) == {}
    first = make("one", url)
    found = elsewhere.known(plan, Remote(url), here)
    assert {key: outcome.state for key, outcome in found.items()} == {"a": "done", "b": "done"}
    assert (found["b"].said["content"], found["b"].said["made"]) == (first["content"], False)
    assert sorted(path.name for path in here.rglob("*") if path.is_file()) == [SEAL, SEAL]
    monkeypatch.setattr(elsewhere, "depends", lambda task: {"lpips": True} if task.key == "b" else {})
    assert set(elsewhere.known(plan, Remote(url), here)) == {"a"}  # b has to be scored anew
    fs, root = fsspec.core.url_to_fs(url)
    fs.rm_file(f"{root}/run/a/{SEAL}")
    assert elsewhere.known(plan, Remote(url), here) == {}


@pytest.mark.parametrize(("gone", "left"), [("a", {"c"}), ("c", {"a"})])
def test_an_entry_that_lacks_any_of_its_inputs_is_not_known(
    make: Callable[..., dict[str, Any]], fake: ModuleType, tmp_path: Path, gone: str, left: set[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(elsewhere, "depends", lambda task: {})
    tasks, url = (fake.task("a"), fake.task("c"), fake.task("b", "a", "c")), f"memory://store{next(counter)}"
    plan = StudyPlan(None, {task.key: task for task in tasks}, ())  # type: ignore[arg-type]
    make("one", url, tasks)
    assert set(elsewhere.known(plan, Remote(url), tmp_path / "here")) == {"a", "b", "c"}
    fs, root = fsspec.core.url_to_fs(url)
    fs.rm_file(f"{root}/run/{gone}/{SEAL}")
    assert set(elsewhere.known(plan, Remote(url), tmp_path / "here")) == left


def test_a_url_that_nothing_serves_is_one_line() -> None:
    with pytest.raises(ValueError, match=r"store nothing://x: .*pip install 'novags\[cluster\]' brings fsspec"):
        Remote("nothing://x")


@pytest.fixture
def ended() -> Iterator[None]:
    yield
    node._end_kept()


def request(fake: ModuleType, folder: Path, marker: Any = None, **config: Any) -> dict[str, Any]:
    task = fake.task("a", **config)
    return {"task": Order(task, task.folder(folder), None, {}, 1), "marker": marker}


@pytest.mark.usefixtures("ended")
# Windows ends processes without signals, so nothing there can name the one that did.
@pytest.mark.skipif(os.name != "posix", reason="names the signals of POSIX systems")
def test_a_node_keeps_its_process_for_the_next_task_and_says_what_was_killed(fake: ModuleType, tmp_path: Path) -> None:
    told: list[Any] = []

    def do(name: str, marker: Any = None, **config: Any) -> tuple[Outcome, str]:
        return node.do("fake_stages:make", request(fake, tmp_path / name, marker, **config), {}, told.append)

    outcome, log = do("one")
    assert (outcome.state, log) == ("done", "making a\n")
    assert told[0] == ("write", 0, 0, "")
    (kept,) = node._kept.values()
    assert do("two", fails="refused")[0] == Outcome("failed", "it does not suit me", "write")
    assert list(node._kept.values()) == [kept]
    with pytest.raises(node.Lost) as lost:
        do("three", fails="killed_once")
    assert "SIGKILL" in lost.value.said
    assert lost.value.log == "making a\n"
    assert do("three", fails="killed_once")[0].state == "done"
    outcome, log = do("four", fails="crashed")
    assert (outcome.state, outcome.said) == ("failed", "its process was ended by SIGSEGV")
    (tmp_path / "marker").write_text("here")
    assert do("five", marker=(str(tmp_path / "marker"), "here"))[0].state == "done"
    for marker in ((str(tmp_path / "marker"), "there"), (str(tmp_path / "none"), "here")):
        outcome, _ = do("six", marker=marker)
        assert (outcome.state, "does not see the store" in outcome.said) == ("machine", True)
    assert not (tmp_path / "six").exists()


def test_needs_are_of_all_tasks_or_of_one_kind() -> None:
    assert read_needs([]) == dict.fromkeys(("set", "capture", "run"), Needs(1, 0.0, None))
    found = read_needs(["cpus=2,memory=500MB", "run:gpus=0.5,memory=8", "set:cpus=16"])
    assert found == {
        "set": Needs(16, 0.0, 5e8), "capture": Needs(2, 0.0, 5e8), "run": Needs(2, 0.5, 8e9)
    }  # fmt: skip
    assert resources(found["run"]) == {"CPU": 2.0, "GPU": 0.5, "memory": 8e9}
    assert resources(Needs()) == {"CPU": 1.0, "GPU": 0.0}
    assert fits({"CPU": 2.0, "memory": 5.0}, {"CPU": 2.0, "memory": 6.0})
    assert not fits({"CPU": 1.0, "GPU": 1.0}, {"CPU": 2.0})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("render:cpus=1", "there are no tasks 'render' in 'render:cpus=1'; there are set, capture, run"),
        ("cpus=0", "cpus must be a whole number >= 1, got 0"),
        ("cpus=1.5", "cpus must be a whole number >= 1, got 1.5"),
        ("gpus=1.5", "gpus must be a whole number or below 1, got 1.5"),
        ("cpus=2GB", "'cpus=2GB' in 'cpus=2GB' must be cpus=N, gpus=N, or memory=N"),
        ("run:", "'' in 'run:' must be cpus=N"),
        ("cores=2", "'cores=2' in 'cores=2' must be cpus=N"),
    ],
)
def test_needs_that_mean_nothing_are_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match="needs: ") as error:
        read_needs([text])
    assert said in str(error.value)


def test_a_forged_entry_under_a_name_that_anybody_knows_is_not_believed(
    make: Callable[..., dict[str, Any]], tasks: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: the folder for temporary files held one that was called the same for everybody, and was believed."""
    make("one", f"memory://store{next(counter)}")
    forged = tmp_path / "tmp" / "novags-scratch"
    shutil.copytree(scratch(tmp_path, "one"), forged)
    monkeypatch.setattr(tempfile, "tempdir", str(forged.parent))
    away = Away(tuple(tasks), (1, 1), f"memory://store{next(counter)}", None, "fake_stages:make")
    assert elsewhere.make(away, QUIET)["made"]
    (own,) = [folder for folder in forged.parent.iterdir() if folder != forged]
    assert own.name.startswith("novags-scratch-")
    assert own.stat().st_mode & 0o777 == 0o700
    assert not elsewhere.make(away, QUIET)["made"]  # what this user made is kept


@pytest.mark.usefixtures("make")
def test_a_scratch_folder_that_another_has_made_is_refused_with_what_to_do(tmp_path: Path) -> None:
    folder = scratch(tmp_path, "one")
    folder.rmdir()
    (tmp_path / "theirs").mkdir()
    folder.symlink_to(tmp_path / "theirs")
    with pytest.raises(OSError, match=f"{folder} is a link, .*: give --scratch DIR, .*, or remove .*/scratch/name"):
        scratch(tmp_path, "one")
    assert list((tmp_path / "theirs").iterdir()) == []


@pytest.mark.usefixtures("make")
def test_the_name_of_the_scratch_folder_leads_nowhere_else(tmp_path: Path) -> None:
    scratch(tmp_path, "one")
    (tmp_path / "cache" / "novags" / "scratch" / "name").write_text("../../theirs")
    with pytest.raises(OSError, match="does not hold the name of a scratch folder: remove it"):
        scratch(tmp_path, "one")
