"""Lit or clean pictures of the views of a dark set: which file belongs to which view."""

import warnings
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console, warnings_as_notes
from novags.testbed.folders.exchanged import refuse_exchanged
from novags.testbed.folders.photographs.linear import load_linear_set
from novags.testbed.importing.stored import PICTURES
from novags.testbed.ledger.contents import folder_digest
from sensor_model.files.door import resolved
from sensor_model.files.reading import some
from simscenes.sets.multiview import MultiviewSet, load_set
from simscenes.sets.names import check_order, file_of, view_names
from simscenes.sets.readers.bare import named_as_masks, without_masks
from simscenes.sets.readers.colmap import find_colmap


@dataclass(frozen=True)
class Twins:
    """Pictures of the dark views, one each.

    Attributes:
        folder: Where they are.
        files: In the order of the views; None: such a view has none.
        paired: How they were found: by "names", or by their "order".
    """

    folder: Path
    files: tuple[Path | None, ...]
    paired: str

    @property
    def there(self) -> tuple[Path, ...]:
        """The files without the views that have none."""
        return tuple(file for file in self.files if file is not None)

    def digest(self) -> str:
        """Hash of the files in the order of the views."""
        files = {f"{i:06d}": file for i, file in enumerate(self.files) if file is not None}
        return folder_digest(self.folder, (), beside=files)

    def record(self) -> dict[str, Any]:
        """For capture.json."""
        return {"folder": resolved(self.folder).name, "paired": self.paired}


def pictures_in(folder: Path) -> dict[str, Path]:
    """The pictures of a folder by the names of their views: the pictures that its cameras list, else all in it or in
    images/.

    Raises:
        ValueError: If the folder has no pictures, or its camera file is damaged.
    """
    if (folder / "transforms.json").is_file() or find_colmap(folder):
        views = load_linear_set(folder) or load_set(folder)
        return dict(zip(views.names, views.files, strict=True))
    files = plain_pictures(folder)
    return dict(sorted(zip(view_names(files), files, strict=True), key=lambda pair: file_of(pair[0])))


def plain_pictures(folder: Path) -> list[Path]:
    """The pictures in images/ of a folder, else directly in it, in the order of their names; cameras have no say.

    Hidden files are left out: an archive made on a Mac has one, ._NAME, for every picture. So are masks that are named
    like a picture.

    Raises:
        ValueError: If neither folder has pictures, or two have one name.
    """
    for place in (folder / "images", folder):
        if files := sorted(file for file in place.glob("[!.]*") if file.suffix.lower() in PICTURES and file.is_file()):
            return _without_doubles(files)
    raise ValueError(f"{folder} holds no pictures ({', '.join(PICTURES)})")


def _without_doubles(files: Sequence[Path]) -> list[Path]:
    """The pictures among these; of two with one stem, one that shows a mask is left out."""
    named = named_as_masks(files)
    masks = set() if len(named) == len(files) else {*named}
    alike = defaultdict[str, list[Path]](list)
    for file in files:
        alike[file.stem] += [] if file in masks else [file]
    for stem, same in alike.items():
        photographs, found = without_masks(same) if len(same) > 1 else (same, [])
        if len(photographs) > 1:
            both = " and ".join(file.name for file in photographs)
            raise ValueError(f"{files[0].parent} has more than one picture of view {stem} ({both}): leave one kind of "
                             "file there")  # fmt: skip
        masks.update(found)
    if masks:
        warnings.warn(f"{len(masks)} masks beside the pictures of {files[0].parent} are not used "
                      f"({some(sorted(file.name for file in masks))}): all pixels count", stacklevel=2)  # fmt: skip
    return [file for file in files if file not in masks]


def twins_of_lit_alone(dark: MultiviewSet) -> Twins:
    """The well-lit pictures of a set that has them of the views without a dark one, and of no other."""
    files = tuple(file if i in dark.lit_alone else None for i, file in enumerate(dark.files))
    return Twins(dark.path, files, "names")


def twins_of(dark: MultiviewSet, folder: Path, option: str, console: Console) -> Twins:
    """The picture in `folder` of each dark view: of the same name, or if no name agrees, in the same order.

    The picture of a view without a dark one is its own.

    Args:
        dark: The dark set.
        folder: Of the twins.
        option: That named it, for messages.
        console: Where notes go.

    Raises:
        ValueError: If some or all views have none, it is not clear which is whose, or a file of a set or a capture has
            changed since it was written.
    """
    if not folder.is_dir():
        raise ValueError(f"{option}: no such folder: {folder}")
    refuse_exchanged(folder)
    with warnings_as_notes(console):
        found = pictures_in(folder) | {dark.names[i]: dark.files[i] for i in dark.lit_alone}
    missing = [name for name in dark.names if name not in found]
    if not missing:
        if len(found) > len(dark):
            console.warn(f"{len(found) - len(dark)} of {len(found)} pictures of {folder} belong to no dark view")
        return Twins(folder, tuple(found[name] for name in dark.names), "names")
    if len(missing) < len(dark):
        raise ValueError(
            f"{option} {folder} has no picture of {len(missing)} of {len(dark)} views ({some(missing, 4)}): names must "
            "equal the names of the dark pictures"
        )
    if len(found) != len(dark):
        raise ValueError(
            f"{option} {folder} has {len(found)} pictures ({some(list(found), 4)}), the dark set {len(dark)} "
            f"({some(list(dark.names), 4)}), with no name in common: give them the same names, or as many, in the same "
            "order"
        )
    check_order(dark.names, tuple(found), f"{option} {folder}", "the dark view")
    _say_order(folder, f"{dark.names[0]} with {next(iter(found.values())).name}", console)
    return Twins(folder, tuple(found.values()), "order")


def _say_order(folder: Path, first: str, console: Console) -> None:
    console.warn(f"the pictures of {folder} have other names than the dark ones: paired by order, {first} and so on")


def twins_by_order(dark: MultiviewSet, folder: Path, console: Console) -> Twins:
    """The picture in `folder` of each dark view where a data set pairs them by the order of their names alone.

    All dark pictures count, also without a camera: otherwise the order would shift.

    Args:
        dark: The dark set.
        folder: Of the twins.
        console: Where notes go.

    Raises:
        ValueError: If there are not as many as dark pictures, or it is not clear which is whose.
    """
    with warnings_as_notes(console):
        places = {file: i for i, file in enumerate(plain_pictures(dark.files[0].parent))}
        found = plain_pictures(folder)
    if len(found) != len(places):
        first, last = next(iter(places)).name, list(places)[-1].name
        raise ValueError(
            f"{folder} has {len(found)} pictures ({found[0].name} to {found[-1].name}), {dark.files[0].parent} "
            f"{len(places)} ({first} to {last}): this data set pairs them by order alone, so there must be as many"
        )
    names = [file.name for file in places]
    check_order(names, [file.name for file in found], str(folder), "the dark picture")
    if [file.stem for file in places] != [file.stem for file in found]:
        _say_order(folder, f"{names[0]} with {found[0].name}", console)
    return Twins(folder, tuple(found[places[file]] for file in dark.files), "order")
