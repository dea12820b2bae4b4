"""Claims about the one door: what is let in, what is refused, and that a refusal costs one line and no wait."""

import json
import os
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from sensor_model.files import door
from sensor_model.files.atomic import appending, atomic, remove, write_text
from sensor_model.files.door import (
    admitted,
    check_links,
    enter,
    given,
    opened,
    read_bytes,
    read_text,
    resolved,
)
from sensor_model.files.python import python


@pytest.fixture(autouse=True)
def _nothing_given(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What a test gives is forgotten after it."""
    monkeypatch.delenv(door.VARIABLE, raising=False)
    with given([]):
        yield


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that was given, beside which lie a file and a folder that were not."""
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    (inside / "own").write_text("own")
    (outside / "secret").write_text("secret")
    enter(inside)
    return inside


def fifo(path: Path) -> None:
    os.mkfifo(path)


def a_socket(path: Path) -> None:
    here = os.getcwd()
    os.chdir(path.parent)  # its whole path may be longer than a socket's can be
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    finally:
        os.chdir(here)


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (fifo, "a FIFO"),
        (a_socket, "a socket"),
        (Path.mkdir, "a folder"),
        (lambda path: path.symlink_to("/dev/zero"), "a device"),
        (lambda path: path.symlink_to("/dev/null"), "a device"),
    ],
    ids=["fifo", "socket", "folder", "zero", "null"],
)
@pytest.mark.parametrize("read", [opened, admitted, read_bytes, read_text])
def test_what_is_not_a_regular_file_is_refused_by_its_kind(
    tmp_path: Path, make: Callable[[Path], None], kind: str, read: Callable[[Path], object]
) -> None:
    make(tmp_path / "given")
    with pytest.raises(ValueError, match=f"given must be a (regular )?file, got {kind}"):
        read(tmp_path / "given")


def test_what_git_leaves_in_place_of_a_large_file_is_refused_by_name(tmp_path: Path) -> None:
    note = f"version https://git-lfs.github.com/spec/v1\noid sha256:{'0a' * 32}\nsize 50331648\n"
    (tmp_path / "points.ply").write_text(note)
    (tmp_path / "about.txt").write_text("\n" + note)
    for read in (opened, admitted, read_bytes, read_text):
        with pytest.raises(ValueError, match="points.ply is not the file itself but what Git LFS puts .* git lfs pull"):
            read(tmp_path / "points.ply")
    assert read_text(tmp_path / "about.txt") == "\n" + note


def test_a_file_of_any_size_on_paper_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    path.write_bytes(b"[1]")
    os.truncate(path, 1 << 40)
    for read in (opened, admitted, read_bytes, read_text):
        with pytest.raises(ValueError, match=r"sparse must have at most [\d,]+ bytes .* got 1,099,511,627,776"):
            read(path)
    with pytest.raises(ValueError, match="at most 3 bytes"):
        read_bytes(path, most=3)


def test_a_missing_file_is_an_error_of_the_system_that_names_it(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="missing"):
        opened(tmp_path / "missing")


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_text_is_read_with_and_without_a_byte_order_mark_and_with_any_line_ends(tmp_path: Path, mark: bytes) -> None:
    (tmp_path / "text").write_bytes(mark + "é\r\nb\rc\n".encode())
    assert read_text(tmp_path / "text") == "é\nb\nc\n"


def test_text_of_another_encoding_is_refused_by_name_and_place(tmp_path: Path) -> None:
    (tmp_path / "text").write_bytes("caf\xe9 au lait".encode("latin-1"))
    with pytest.raises(ValueError, match=r"text is not UTF-8 text \(byte 3\)"):
        read_text(tmp_path / "text")


def test_a_link_inside_a_given_folder_is_followed(folder: Path) -> None:
    (folder / "link").symlink_to("own")
    assert read_text(folder / "link") == "own"


def test_a_link_out_of_a_given_folder_is_refused_with_the_option_that_allows_it(folder: Path) -> None:
    (folder / "link").symlink_to("../outside/secret")
    with pytest.raises(ValueError, match=r"link leads by a link to .*outside/secret.*--allow-links .*outside "):
        read_text(folder / "link")
    (folder / "below").symlink_to("../outside")
    with pytest.raises(ValueError, match="--allow-links"):
        read_text(folder / "below" / "secret")
    door.allow([folder.parent / "outside"])
    assert read_text(folder / "link") == read_text(folder / "below" / "secret") == "secret"


def test_links_may_lead_to_each_of_several_folders_that_are_allowed_or_named(folder: Path) -> None:
    others = [folder.parent / name for name in ("first", "second")]
    for k, other in enumerate(others):
        other.mkdir()
        (other / "file").write_text(str(k))
        (folder / f"link{k}").symlink_to(other / "file")
    with given([str(other) for other in others]):
        assert [read_text(folder / f"link{k}") for k in range(2)] == ["0", "1"]
    for k in range(2):
        with pytest.raises(ValueError, match="--allow-links"):
            read_text(folder / f"link{k}")
    door.allow(others)
    assert [read_text(folder / f"link{k}") for k in range(2)] == ["0", "1"]


def test_a_link_may_lead_to_another_folder_that_was_given(folder: Path) -> None:
    (folder / "link").symlink_to("../outside/secret")
    enter(folder.parent / "outside")
    assert read_text(folder / "link") == "secret"


def test_a_folder_whose_name_begins_alike_is_another_one(folder: Path) -> None:
    (folder.parent / "inside2").mkdir()
    (folder.parent / "inside2" / "secret").write_text("secret")
    (folder / "link").symlink_to("../inside2/secret")
    with pytest.raises(ValueError, match="--allow-links"):
        read_text(folder / "link")


def test_links_on_the_way_to_what_was_given_are_the_users_own(folder: Path) -> None:
    (folder.parent / "latest").symlink_to("outside")
    enter(folder.parent / "latest")
    assert read_text(folder.parent / "latest" / "secret") == "secret"


def test_the_folder_above_a_link_is_that_of_its_target(folder: Path) -> None:
    (folder / "run").mkdir()
    (folder.parent / "latest").symlink_to("inside/run")
    enter(folder.parent / "latest")
    assert resolved(folder.parent / "latest" / ".." / "own") == folder / "own"
    assert read_text(folder.parent / "latest" / ".." / "own") == "own"
    (folder / "link").symlink_to("../outside")
    with pytest.raises(ValueError, match="--allow-links"):
        read_text(folder / "link" / ".." / "outside" / "secret")


def test_a_folder_behind_a_link_out_of_a_given_one_is_not_given_by_being_opened(folder: Path) -> None:
    (folder / "run").symlink_to("../outside")
    with pytest.raises(ValueError, match="--allow-links"):
        enter(folder / "run")


def test_a_command_line_gives_its_folders_and_files_and_takes_them_back(folder: Path) -> None:
    outside = folder.parent / "outside"
    (folder / "link").symlink_to("../outside/secret")
    with given(["command", str(outside / "secret"), "--x", "\0"]):
        assert read_text(folder / "link") == "secret"
    with pytest.raises(ValueError, match="--allow-links"):
        read_text(folder / "link")


def test_what_was_allowed_reaches_child_processes_through_their_environment(folder: Path) -> None:
    door.allow([folder])
    door.allow([folder.parent / "outside"])
    (folder.parent / "a:b").mkdir()
    door.allow([folder.parent / "a:b"])
    allowed = json.loads(os.environ[door.VARIABLE])
    assert allowed == [os.path.realpath(place) for place in (folder, folder.parent / "outside", folder.parent / "a:b")]
    (folder / "link").symlink_to("../outside/secret")
    program = (
        "import sys; from sensor_model.files.door import enter, read_text; enter(sys.argv[1]); "
        "print(read_text(sys.argv[1] + '/link'))"
    )
    done = subprocess.run(python(program, str(folder)), capture_output=True, text=True, check=True)
    assert done.stdout == "secret\n"


@pytest.mark.parametrize("read", [check_links, resolved, enter])
def test_a_link_to_itself_is_refused_in_one_line(tmp_path: Path, read: Callable[[Path], object]) -> None:
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    for name in ("loop", "a"):
        with pytest.raises(ValueError, match=f"{name} is a link that leads to itself"):
            read(tmp_path / name)


def test_nothing_is_written_or_removed_behind_a_link_out_of_a_given_folder(folder: Path) -> None:
    outside = folder.parent / "outside"
    (folder / "renders").symlink_to("../outside")
    for act in (
        lambda: write_text(folder / "renders" / "secret", "gone"),
        lambda: remove(folder / "renders" / "secret"),
    ):
        with pytest.raises(ValueError, match="--allow-links"):
            act()
    with pytest.raises(ValueError, match="--allow-links"), atomic(folder / "renders" / "new"):
        pass
    assert [path.name for path in outside.iterdir()] == ["secret"]
    assert (outside / "secret").read_text() == "secret"


def test_a_link_under_the_name_of_a_file_is_replaced_not_followed(folder: Path) -> None:
    (folder / "page.html").symlink_to("../outside/secret")
    write_text(folder / "page.html", "page")
    assert (folder / "page.html").read_text() == "page"
    assert (folder.parent / "outside" / "secret").read_text() == "secret"


def test_a_log_goes_on_only_in_a_file_of_our_own(folder: Path) -> None:
    with appending(folder / "log") as file:
        file.write(b"one ")
    with appending(folder / "log") as file:
        file.write(b"two")
    assert (folder / "log").read_text() == "one two"
    victim = folder.parent / "outside" / "secret"
    (folder / "link").symlink_to(victim)
    os.link(victim, folder / "second name")
    os.mkfifo(folder / "fifo")
    for name in ("link", "second name", "fifo"):
        with pytest.raises(ValueError, match="not a file that novags made: remove it"):
            appending(folder / name)
    assert victim.read_text() == "secret"
