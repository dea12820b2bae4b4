"""Which of its frames a nerfstudio transforms.json trains on and which it holds out."""

from __future__ import annotations

import os
import posixpath
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from sensor_model.files.reading import some
from simscenes.sets.readers.finding import ADDED, find_file, find_files

TRAIN, VAL, TEST = LISTS = ("train_filenames", "val_filenames", "test_filenames")
SPLIT = {f"{key}?": [str] for key in LISTS}


@dataclass(frozen=True)
class Split:
    """Places of the frames for training and for testing, and notes for the user; the other frames are left out."""

    train: frozenset[int]
    test: frozenset[int]
    notes: tuple[str, ...] = ()

    def use(self, place: int) -> Literal["train", "test", "none"]:
        """The purpose of the frame at this place."""
        return "train" if place in self.train else "test" if place in self.test else "none"


def split_of(content: dict[str, Any], source: Path) -> Split | None:
    """The split that a transforms.json states; None: it states none. An empty list counts as none.

    Test frames are listed in test_filenames, else in val_filenames; else they are the frames that train_filenames
    lacks. Training frames are listed in train_filenames; else they are the frames that no list names. No test frame is
    trained on.

    Args:
        content: Of the file, checked.
        source: The file; listed names are relative to its folder.

    Raises:
        ValueError: If no entry of a list names a frame.
    """
    names = [frame["file_path"] for frame in content["frames"]]
    lists = {key: content[key] for key in LISTS if content.get(key)}
    if not lists:
        return None
    listed, notes = {}, []
    for key, entries in lists.items():
        found = places_of(entries, names, source.parent)
        lost = [entry for entry, places in zip(entries, found, strict=True) if not places]
        if len(lost) == len(entries):
            raise ValueError(f"{source}: {key} must name its frames, and none of {len(entries)} entries ({some(lost)}) "
                             f"does: write them like file_path ({some(names)})")  # fmt: skip
        if lost:
            notes.append(f"{len(lost)} of {len(entries)} entries of {key} in {source} name no frame: {some(lost)}")
        listed[key] = frozenset(place for places in found for place in places)
    return _decided(listed, names, source, notes)


def _decided(listed: dict[str, frozenset[int]], names: Sequence[str], source: Path, notes: list[str]) -> Split:
    every = frozenset(range(len(names)))
    told = listed.get(TEST) or listed.get(VAL)
    test = every - listed[TRAIN] if told is None else told
    train = listed.get(TRAIN, every - test - listed.get(VAL, frozenset())) - test
    if not test:
        notes.append(f"{source} lists every frame in {TRAIN} and none for testing: every 8th is held out; name others "
                     f"in {TEST}")  # fmt: skip
    if both := listed.get(TRAIN, frozenset()) & test:
        notes.append(f"{source} lists {len(both)} of {len(names)} frames for training and for testing "
                     f"({_named(both, names)}): they are held out")  # fmt: skip
    if unused := every - train - test:
        held = next((key for key in (TEST, VAL) if key in listed), "")
        why = f"neither {TRAIN} nor {held} names them" if TRAIN in listed else f"{VAL} alone names them"
        notes.append(f"{len(unused)} of {len(names)} frames of {source} are left out, as {why}: "
                     f"{_named(unused, names)}")  # fmt: skip
    return Split(train, test, tuple(notes))


def _named(places: Iterable[int], names: Sequence[str]) -> str:
    return some([names[place] for place in sorted(places)])


def places_of(entries: Sequence[str], names: Sequence[str], folder: Path) -> list[list[int]]:
    """For each entry of a list the places in `names` of the frames it means; none: [].

    First the same text counts, then the same path, then the path with or without suffix, then the same file.

    Args:
        entries: Of the list.
        names: Of the frames.
        folder: What both are relative to.
    """
    same = _places([name] for name in names)
    path = _places([_path(name)] for name in names)
    longer = _places([_path(name) + suffix for suffix in ADDED] for name in names)
    found = []
    for entry in entries:
        tried = [same.get(entry), *(path.get(_path(entry) + suffix) for suffix in ADDED), longer.get(_path(entry))]
        found.append(next((places for places in tried if places), []))
    return found if all(found) else _by_file(found, entries, names, folder)


def _by_file(found: list[list[int]], entries: Sequence[str], names: Sequence[str], folder: Path) -> list[list[int]]:
    """The same with the entries that mean the file of a frame by another path, such as an absolute one."""
    files = [None if file is None else os.path.abspath(file) for file in find_files(folder, names)]
    of_file = _places([] if file is None else [file] for file in files)
    other = (None if places else find_file(folder, entry) for places, entry in zip(found, entries, strict=True))
    more = [[] if file is None else of_file.get(os.path.abspath(file), []) for file in other]
    return [places or added for places, added in zip(found, more, strict=True)]


def _places(forms: Iterable[Iterable[str]]) -> dict[str, list[int]]:
    """The places of each form."""
    places = defaultdict(list)
    for i, several in enumerate(forms):
        for form in several:
            places[form].append(i)
    return places


def _path(name: str) -> str:
    return unicodedata.normalize("NFC", posixpath.normpath(name.replace("\\", "/")))
