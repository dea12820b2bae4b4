"""Claims about what of a store can go."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from novags.testbed.ledger.contents import write_json
from novags.testbed.ledger.pruning import entries, unreferenced
from novags.testbed.ledger.store import named, write_seal
from sensor_model.files.atomic import write_text

COST = {"seconds": {"render": 1.0}, "peak_bytes": 1, "group": "g", "work": 1.0, "pixels": 1.0, "threads": 1}


def made(store: Path, kind: str, key: str, *needs: str, text: str = "x") -> Path:
    """A complete entry, made from others."""
    folder = store / kind / named(f"{kind}-a", key * 16)
    write_text(folder / "a.txt", text)
    write_seal(folder, key * 16, {need * 16: "content" for need in needs} | {"lpips": False}, COST, ())
    return folder


def study(folder: Path, *keys: str) -> Path:
    """The folder of a study with these runs."""
    runs = [{"values": {}, "key": key * 16, "folder": "x"} for key in keys]
    write_json(folder / "study.json", {"file": "a.toml", "table": {}, "runs": runs})
    return folder


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """Two sets, each with a capture and a run of it; and an unfinished run."""
    root = tmp_path / "store"
    for first, second, third in ("abc", "def"):
        made(root, "set", first)
        made(root, "capture", second, first)
        made(root, "run", third, second)
    write_text(root / "run" / named("run-a", "9" * 16) / "part.txt", "x" * 100)
    return root


def there(store: Path) -> list[str]:
    return sorted(path.name[-1] for path in store.glob("*/*-*"))


def test_what_a_study_refers_to_stays_with_all_that_it_was_made_from(
    store: Path, tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    kept = study(tmp_path / "out", "c")
    assert call("store", "prune", str(store), str(kept), "--dry-run") == 0
    assert there(store) == ["9", *"abcdef"]
    said = capsys.readouterr().out
    assert "would remove 4 entries" in said
    assert "(1 unfinished) of 7" in said
    assert call("store", "prune", str(store), str(kept)) == 0
    assert there(store) == ["a", "b", "c"]
    assert "removed 4 entries" in capsys.readouterr().out
    assert {entry.complete for entry in entries(store)} == {True}


def test_several_studies_keep_what_any_of_them_needs(store: Path, tmp_path: Path, call: Callable[..., int]) -> None:
    assert call("store", "prune", str(store), str(study(tmp_path / "a", "c")), str(study(tmp_path / "b", "e"))) == 0
    assert there(store) == list("abcde")


def test_entries_that_are_at_work_are_kept(
    store: Path, tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    (busy,) = (store / "run").glob("*-9999*")
    assert busy in {entry.folder for entry in unreferenced(entries(store), ["c" * 16])}
    hold = "import sys, time; from pathlib import Path; from sensor_model.files.lock import locked\n" \
        "with locked(Path(sys.argv[1])):\n    print('held', flush=True); time.sleep(60)"  # fmt: skip
    with subprocess.Popen([sys.executable, "-c", hold, str(busy)], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        assert call("store", "prune", str(store), str(study(tmp_path / "out", "c"))) == 0
        other.kill()
    assert "another process is at work there, kept" in capsys.readouterr().out
    assert there(store) == ["9", *"abc"]


def test_sizes_are_counted(store: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]) -> None:
    made(store, "set", "7", text="x" * 2_000_000)
    assert call("store", "size", str(store)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "set: 3 entries, 2.0 MB"
    assert lines[-1].startswith("all: 8 entries, 2.0 MB (1 unfinished)")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["prune", "store"], "prune needs the studies whose entries stay"),
        (["size", "store", "out"], "belong to prune"),
        (["size", "out"], "is no store"),
        (["prune", "store", "nothing"], "nothing"),
    ],
)
def test_wrong_requests_are_one_line(
    store: Path, tmp_path: Path, words: list[str], said: str, call: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    study(tmp_path / "out", "c")
    monkeypatch.chdir(tmp_path)
    assert call("store", *words) != 0
    assert said in " ".join(capsys.readouterr().err.split())
    assert len(there(store)) == 7
