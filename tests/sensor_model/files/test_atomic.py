"""The one atomic writer: what is there stays until what replaces it is complete."""

import os
from pathlib import Path

import pytest

from sensor_model.files.atomic import atomic


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
