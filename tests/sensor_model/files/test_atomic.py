"""The one atomic writer: what is there stays until what replaces it is complete."""

import os
from pathlib import Path

import pytest

from sensor_model.files.atomic import appending, atomic, sweep, witnessed, write_text


def test_a_file_appears_at_the_end_of_the_block_under_a_hidden_name_until_then(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.tar.gz"
    with atomic(path) as temporary:
        temporary.write_text("whole")
        assert (temporary.parent, temporary.suffix) == (path.parent, ".gz")
        assert temporary.name.startswith(".")
        assert str(os.getpid()) in temporary.name
        assert not path.exists()
    assert [p.name for p in path.parent.iterdir()] == ["a.tar.gz"]
    assert path.read_text() == "whole"


@pytest.mark.parametrize("kind", ["file", "folder", "nothing"])
def test_a_failure_leaves_what_was_there_and_nothing_else(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before")

    def fail() -> None:
        with atomic(path) as temporary:
            if kind == "folder":
                temporary.mkdir()
                (temporary / "half").write_text("half")
            elif kind == "file":
                temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    assert path.read_text() == "before"


def test_a_block_that_writes_nothing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"a\.txt"), atomic(tmp_path / "a.txt"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_folder_replaces_an_earlier_one_as_a_whole(tmp_path: Path) -> None:
    folder = tmp_path / "0"
    for name in ("old.bin", "new.bin"):
        with atomic(folder) as temporary:
            temporary.mkdir()
            (temporary / name).write_text(name)
    assert [p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*")] == ["0", "0/new.bin"]


def test_every_witness_knows_every_file_that_appears_until_it_changes(tmp_path: Path) -> None:
    one, folder, log = tmp_path / "one", tmp_path / "folder", tmp_path / "log"
    with witnessed(Path.read_bytes) as first, witnessed(lambda file: file.name.encode()) as second:
        write_text(one, "1")
        write_text(log, "begun")
        with atomic(folder) as temporary:
            (temporary / "below").mkdir(parents=True)
            for name in ("a", "b", "below/c"):
                (temporary / name).write_text(name)
        for name in ("a", "b", "below/c"):
            assert first.unchanged(folder / name) == name.encode()
            assert second.unchanged(folder / name) == name[-1].encode()
        assert first.unchanged(one) == first.unchanged(one) == b"1"
        (folder / "b").write_text("other")
        assert first.unchanged(folder / "b") is None
        with appending(log):
            pass
        assert first.unchanged(log) is second.unchanged(log) is None


def test_a_sweep_goes_through_every_folder_that_is_named_and_no_other(tmp_path: Path) -> None:
    dead = 2**22 + 7  # no process has such a number
    for name in ("here", "gt", "images/below", "kept"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / f".a.{dead}.partial.png").touch()
        (tmp_path / name / "a.png").touch()
    (tmp_path / f".b.{dead}.partial").touch()
    sweep(tmp_path, ("gt", "images", "not there", "here"))
    left = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    assert left == ["gt/a.png", "here/a.png", "images/below/a.png", f"kept/.a.{dead}.partial.png", "kept/a.png"]
