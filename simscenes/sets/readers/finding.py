"""The image files that a camera file lists, however it spells them."""

from __future__ import annotations

import os
import unicodedata
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from simscenes.sets.readers.bare import SUFFIXES

# Suffixes that a listed name may lack. Case decides here only where a folder holds several of them.
ADDED = ("", ".png", ".jpg", ".jpeg", ".JPG", ".JPEG", ".PNG")
BELOW = ("*", "*/*")  # where pictures are looked for that do not lie where they should


def find_file(folder: Path, listed: str) -> Path | None:
    """The image that a camera file lists, as `find_files` finds it; None: not there."""
    return find_files(folder, [listed])[0]


def find_files(folder: Path, listed: Sequence[str]) -> list[Path | None]:
    r"""The images that a camera file lists; None: not there.

    A name is tried unchanged, with / for \, with its suffix added, and in either form of Unicode. If none of these
    exists, a file whose name differs only in case is taken, if there is just one and no other listed name has it.

    Args:
        folder: What the names are relative to.
        listed: The names.

    Raises:
        ValueError: If a name cannot be a file's name.
    """
    found = [_exact(folder, name) for name in listed]
    taken = {file for file in found if file is not None}
    folders = _Folders()
    for i, name in enumerate(listed):
        if found[i] is None:
            alike = [file for file in _ignoring_case(folder, name, folders) if file not in taken]
            found[i] = alike[0] if len(alike) == 1 else None
    return found


def spelt(folder: Path, listed: Sequence[str], files: Sequence[Path | None]) -> list[str]:
    """What a message calls listed images: their names, and for a missing one the file found under another suffix or in
    another folder: lists name folders of the computer that they were written on.

    Args:
        folder: What the names are relative to.
        listed: The names.
        files: As `find_files` found them.
    """
    folders, names = _Folders(), []
    missing = any(file is None for file in files)
    every = [folder, *(inner for depth in BELOW for inner in sorted(folder.glob(depth)))] if missing else []
    below = [inner for inner in every if inner.is_dir() and not inner.is_symlink()]
    for name, file in zip(listed, files, strict=True):
        near = None
        if file is None:
            place = Path(name.replace("\\", "/"))
            near = _another_suffix(folder / place, folders)
            near = near or next((f for inner in below if (f := _another_suffix(inner / place.name, folders))), None)
        names.append(name if near is None else f"{name} ({Path(os.path.relpath(near, folder)).as_posix()} is there)")
    return names


def _exact(folder: Path, listed: str) -> Path | None:
    slashed = (listed, listed.replace("\\", "/"))
    forms = dict.fromkeys(unicodedata.normalize(form, name) for name in slashed for form in ("NFC", "NFD"))
    paths = (folder / (form + suffix) for form in dict.fromkeys((listed, *forms)) for suffix in ADDED)
    try:
        return next((path for path in paths if path.is_file()), None)
    except OSError as error:
        raise ValueError(f"{folder} cannot hold the image {listed[:60]!r} ({error.strerror}): rename it") from error


class _Folders(dict[Path, dict[str, list[Path]]]):
    """The files of each folder by names in lower case; each is looked into once."""

    def __missing__(self, folder: Path) -> dict[str, list[Path]]:
        self[folder] = defaultdict(list)
        with suppress(OSError, ValueError):  # no folder, or nobody may look into it, or a name with a zero byte
            for path in sorted(folder.iterdir()):
                self[folder][_lower(path.name)].append(path)
        return self[folder]


def _ignoring_case(folder: Path, listed: str, folders: _Folders) -> list[Path]:
    """Files below `folder` whose path differs in case alone."""
    path = Path(listed.replace("\\", "/"))
    if path.is_absolute() or not path.parts:
        return []
    *above, last = path.parts
    places = [folder]
    for part in above:
        inner = [[place / part] if part == ".." else folders[place].get(_lower(part), []) for place in places]
        places = [path for paths in inner for path in paths]
    names = {_lower(last + suffix) for suffix in ADDED}
    return [file for place in places for name in names for file in folders[place].get(name, []) if file.is_file()]


def _another_suffix(path: Path, folders: _Folders) -> Path | None:
    """A picture of the same folder and stem."""
    names = (_lower(stem + suffix) for stem in (path.stem, path.name) for suffix in SUFFIXES)
    return next((file for name in names for file in folders[path.parent].get(name, [])), None)


def _lower(name: str) -> str:
    return unicodedata.normalize("NFC", name).lower()
