"""Where the pictures of a COLMAP or LLFF folder lie: in images/, or of a shrunk scene in images_2/, images_4/, ..."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from simscenes.sets.names import check_order
from simscenes.sets.readers.bare import SUFFIXES
from simscenes.sets.readers.finding import find_files


def picture_folder(folder: Path) -> Path:
    """images/; where that is missing, the largest of the shrunk pictures: images_N/ of the smallest N."""
    whole = folder / "images"
    if whole.is_dir():
        return whole
    shrunk = {int(match[1]): path for path in folder.glob("images_*")
              if path.is_dir() and (match := re.fullmatch(r"images_(\d{1,3})", path.name))}  # fmt: skip
    return shrunk[min(shrunk)] if shrunk else whole


def sorted_pictures(pictures: Path) -> list[Path]:
    """The pictures of a folder in the order of their names, without hidden files, which archives made on a Mac have."""
    return sorted(file for file in pictures.glob("[!.]*") if file.suffix.lower() in SUFFIXES and file.is_file())


def named_pictures(pictures: Path, names: Sequence[str]) -> list[Path | None]:
    """The file of each image that a model lists; None: not there.

    Tools that shrink LLFF scenes number the pictures anew. So in images_N/, if no name is there and the counts agree,
    the order of the names decides, as in the loaders of LLFF and MultiNeRF.

    Args:
        pictures: The folder of the pictures.
        names: Relative to images/.

    Raises:
        ValueError: If names have another order by their numbers than by their letters.
    """
    found = find_files(pictures, names)
    if any(found) or pictures.name == "images":
        return found
    files = sorted_pictures(pictures)
    if len(files) != len(names):
        return found
    place = {name: i for i, name in enumerate(sorted(names))}
    check_order(list(place), [file.name for file in files], str(pictures), "the image")
    return [files[place[name]] for name in names]
