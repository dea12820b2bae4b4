"""Claims about folders of this user alone: what others could have put there is not believed."""

import os
import stat
from pathlib import Path

import pytest

from sensor_model.files import own
from sensor_model.files.own import cache_folder, own_folder, remember, remembered


def given_to_another(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if os.getuid() == 0:
        os.chown(folder, 12345, -1)
    else:
        monkeypatch.setattr(own.os, "getuid", lambda: 12345)


def test_it_is_made_so_that_nobody_else_can_write_to_it(tmp_path: Path) -> None:
    folder = own_folder(tmp_path / "a" / "b")
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    (folder / "file").touch()
    assert own_folder(folder) == folder
    assert (folder / "file").exists()


@pytest.mark.parametrize("kind", ["link", "file", "another's"])
def test_what_may_be_somebody_elses_is_refused(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "elsewhere").mkdir(0o700)
    if kind == "link":
        (tmp_path / "folder").symlink_to(tmp_path / "elsewhere")
    elif kind == "file":
        (tmp_path / "folder").touch()
    else:
        (tmp_path / "folder").mkdir(0o700)
        given_to_another(tmp_path / "folder", monkeypatch)
    why = {"link": "is a link", "file": "is not a folder", "another's": "belongs to the user with number"}[kind]
    with pytest.raises(OSError, match=f"folder {why}.*so its content could be somebody else's"):
        own_folder(tmp_path / "folder")


@pytest.mark.parametrize("mode", [0o770, 0o777, 0o1777])
def test_one_that_others_could_write_to_is_made_anew(mode: int, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "theirs").touch()
    (tmp_path / "folder").chmod(mode)
    assert list(own_folder(tmp_path / "folder").iterdir()) == []
    assert stat.S_IMODE((tmp_path / "folder").stat().st_mode) == 0o700


def test_what_others_remember_in_a_shared_cache_is_not_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: a file with the right name in it said that a scene had been tried, and it was loaded."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert not remembered("scenes", "a")
    remember("scenes", "a")
    assert remembered("scenes", "a")
    given_to_another(cache_folder("scenes"), monkeypatch)
    assert not remembered("scenes", "a")
    remember("scenes", "b")  # says nothing
    assert not (cache_folder("scenes") / "b").exists()
