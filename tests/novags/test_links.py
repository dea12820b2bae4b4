"""Claims about links in the folders that a command is given: where they may lead, and who says so."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from novags.commands.every import LINKS as OPTION
from novags.commands.every import PLUGIN, without_common
from sensor_model.files import outside
from sensor_model.files.door import read_bytes
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras

Call = Callable[..., int]
NAMES = [f"{i:04d}" for i in range(3)]


@pytest.fixture
def linked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A set whose pictures are links to another disk, as on clusters."""
    disk, folder = tmp_path / "disk", tmp_path / "set"
    write_cameras(folder, NAMES, orbit_rig(3, 24, 24, 50.0, radius=3.0))
    (folder / "images").mkdir()
    disk.mkdir()
    for i, name in enumerate(NAMES):
        cv2.imwrite(str(disk / f"{name}.png"), np.full((24, 24, 3), 100 + 40 * i, np.uint8))
        (folder / "images" / f"{name}.png").symlink_to(disk / f"{name}.png")
    monkeypatch.chdir(tmp_path)
    return folder


def test_links_to_another_disk_are_refused_with_the_option_that_allows_them(
    linked: Path, call: Call, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("capture", "set", "--out", "cap") == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert "0000.png leads by a link to " in line
    assert f"add {OPTION} {os.path.realpath(linked.parent / 'disk')}" in line
    assert not (linked.parent / "cap" / "capture.json").exists()


@pytest.mark.parametrize(
    "words", [[OPTION, "disk"], [f"{OPTION}=disk"], [OPTION, "."]], ids=["two words", "one word", "above"]
)
def test_the_option_allows_them_before_and_after_the_command(linked: Path, call: Call, words: list[str]) -> None:
    assert call("capture", "set", "--out", "cap", *words) == 0
    shutil.rmtree("cap")
    assert call(*words, "capture", "set", "--out", "cap") == 0


def test_a_link_that_the_command_line_names_is_the_users_own(linked: Path, call: Call) -> None:
    for name in NAMES:
        (linked / "images" / f"{name}.png").unlink()
        shutil.copyfile(linked.parent / "disk" / f"{name}.png", linked / "images" / f"{name}.png")
    (linked.parent / "behind").symlink_to("set")
    assert call("capture", "behind", "--out", "cap") == 0


def test_pictures_may_be_links_into_another_folder_that_the_command_line_names(linked: Path, call: Call) -> None:
    (linked.parent / "disk" / "cap").mkdir()
    assert call("capture", "set", "--out", "disk/cap") == 2  # of which the pictures are no part
    assert call("score", "--renders", "disk", "--set", "set") == 0


def test_a_folder_that_is_called_like_the_command_is_not_given_by_its_name(linked: Path, call: Call) -> None:
    linked.rename(linked.parent / "capture")
    with without_common(["capture", "x"])[1]:
        assert read_bytes(linked.parent / "capture" / "images" / "0000.png")
    with without_common(["plan", "capture"])[1], pytest.raises(ValueError, match=OPTION):
        read_bytes(linked.parent / "capture" / "images" / "0000.png")


def test_what_one_command_allows_the_next_does_not(linked: Path, call: Call) -> None:
    before = dict(os.environ)
    assert call("capture", "set", "--out", "cap", OPTION, "disk") == 0
    assert dict(os.environ) == before
    assert call("capture", "set", "--out", "cap2") == 2


@pytest.mark.parametrize("words", [[OPTION], [OPTION, "nowhere"], [OPTION, ""], [f"{OPTION}="]])
def test_a_folder_that_is_not_there_is_one_line(
    call: Call, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    assert call("list", "scenes", *words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{OPTION} must be followed by a folder that is there" in line


def test_all_plugins_that_are_named_are_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files, added = [tmp_path / "a.py", tmp_path / "b.py"], []
    monkeypatch.setattr(outside, "add_file", added.append)
    for file in files:
        file.touch()
    with without_common(["list", "methods", PLUGIN, str(files[0]), f"{PLUGIN}={files[1]}"])[1]:
        assert added == files


def test_all_other_words_are_left_for_the_command() -> None:
    words = ["run", "--scene", "x", "--out=y", "--help"]
    assert without_common([*words[:2], OPTION, ".", *words[2:]])[0] == words
