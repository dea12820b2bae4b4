"""Folders of this user alone: this user put their content there, so it may be believed, and compiled code run.

A folder that somebody else owns, or can write to, may hold anything, under any name.
"""

from __future__ import annotations

import os
import shutil
import stat
from contextlib import suppress
from pathlib import Path


def cache_folder(kind: str) -> Path:
    """Where this user's machine remembers things of a kind; may not exist yet, and may be deleted at any time."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "novags" / kind


def own_folder(folder: Path) -> Path:
    """Make a folder that nobody else can write to, if it is not there.

    A folder of this user's that others could write to is made anew: its content may be theirs.

    Raises:
        OSError: If it cannot be made, or somebody else's folder, a link or a file is in its place.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        folder.mkdir(0o700)
    if stat.S_ISDIR((found := folder.lstat()).st_mode) and _is_open(found) and found.st_uid == os.getuid():
        shutil.rmtree(folder)
        folder.mkdir(0o700)
    if why := _why_not(folder.lstat()):
        raise OSError(f"{folder} {why}, so its content could be somebody else's")
    return folder


def _why_not(found: os.stat_result) -> str:
    """Why something is not a folder of this user alone; "" if it is one."""
    if not stat.S_ISDIR(found.st_mode):
        return "is a link" if stat.S_ISLNK(found.st_mode) else "is not a folder"
    if found.st_uid not in (os.getuid(), 0):  # root may do everything anyway
        return f"belongs to the user with number {found.st_uid}"
    return "can be written to by others" if _is_open(found) else ""


def _is_open(found: os.stat_result) -> bool:
    return bool(found.st_mode & (stat.S_IWGRP | stat.S_IWOTH))


def remembered(kind: str, name: str) -> bool:
    """Whether `remember` was called with this by this user on this machine."""
    try:
        return (own_folder(cache_folder(kind)) / name).is_file()
    except OSError:
        return False


def remember(kind: str, name: str) -> None:
    """Remember something; where that is not possible, because the home is read-only, say, it is forgotten."""
    with suppress(OSError):
        (own_folder(cache_folder(kind)) / name).touch()
