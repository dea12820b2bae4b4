"""A folder of dark photographs with their cameras, and the raw files that lie beside them."""

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from shlex import quote
from typing import NoReturn

from novags.testbed.console.terminal import Console, warnings_as_notes
from novags.testbed.folders.photographs import raw_files
from novags.testbed.folders.photographs.linear import find_linear
from novags.testbed.folders.set import READ_FROM, Source, open_source, source_of
from novags.testbed.importing.published.datasets import DEPTH, Dataset, scene_names, scenes_below
from novags.testbed.importing.published.posed import has_cameras
from novags.testbed.importing.split import Split, divided
from novags.testbed.importing.stored import PICTURES, Depth, depth_of
from novags.testbed.ledger.contents import folder_digest
from sensor_model.files.reading import some
from simscenes.sets.readers.nerf_synthetic import is_nerf_synthetic

SHOWN = 4  # folders in a message


@dataclass(frozen=True)
class Dark:
    """Dark photographs and their cameras.

    Attributes:
        source: Cameras and files, at the size of the capture.
        depth: Of the files that have cameras.
        raws: The raw file of each view; empty without them.
        beside: Other files of a published data set, as `Dataset.beside`.
    """

    source: Source
    depth: Depth
    raws: tuple[Path, ...]
    beside: Mapping[str, Path] = field(default_factory=dict)

    @property
    def files(self) -> tuple[Path, ...]:
        """The pictures that have cameras, one a view."""
        return self.source.views.files

    @property
    def dark_files(self) -> tuple[Path, ...]:
        """The dark ones among them."""
        alone = self.source.views.lit_alone
        return tuple(file for i, file in enumerate(self.files) if i not in alone)

    def digest(self) -> str:
        """Hash of all its files that are read, wherever they are."""
        views = self.source.views
        pictures = {f"images/{name}": file for name, file in zip(views.names, self.files, strict=True)}
        raws = {f"raw/{name}": file for name, file in zip(views.names, self.raws, strict=False)}
        points = {} if (file := views.points_file) is None else {"ply_file_path": file}
        return folder_digest(views.path, READ_FROM, beside=pictures | raws | points | dict(self.beside))


def open_dark(
    folder: Path, dataset: Dataset | None, split: Split, max_size: int | None, console: Console
) -> Dark:  # fmt: skip
    """Open dark photographs with their cameras: any folder that can be captured, with or without raw files in raw/.

    Args:
        folder: Of the photographs.
        dataset: The published data set that it is a scene of.
        split: Which views are held out.
        max_size: As for `open_source`.
        console: Where notes go.

    Raises:
        ValueError: If there are no pictures or no cameras (and then how to get them), or a raw file is missing.
    """
    if dataset is not None:
        with warnings_as_notes(console):
            views = dataset.open_scene(folder, split)
        source = source_of(views, console, max_size)
    elif has_cameras(folder) or is_nerf_synthetic(folder):
        source = open_source(folder, console, max_size)
    else:
        _without_cameras(folder)
    source = replace(source, views=divided(source.views, split))
    files = source.views.files
    if bad := [file for file in files if file.suffix.lower() not in PICTURES]:
        raise ValueError(f"{bad[0]} is neither a photograph nor camera raw ({', '.join(PICTURES)}): convert it to "
                         "16-bit PNG")  # fmt: skip
    depth = depth_of(next(file for i, file in enumerate(files) if i not in source.views.lit_alone))
    beside = {} if dataset is None else dataset.beside(folder, source.views)
    return Dark(source, depth, files if depth == "raw" else _raws_beside(folder, source), beside)


def _without_cameras(folder: Path) -> NoReturn:
    if scenes := scenes_below(folder):
        raise ValueError(f"{folder} is not a scene, but contains scenes ({scene_names(scenes)}): import one of "
                         "them, or all with novags study FILE --data")  # fmt: skip
    found = [file for place in (folder, folder / "images") for file in place.glob("*")]
    count = sum(file.suffix.lower() in PICTURES for file in found)
    if not count and (below := list(islice(_with_pictures(folder), SHOWN + 1))):
        posed = [place for place in below if has_cameras(place) or is_nerf_synthetic(place)]
        names = some([str(place.relative_to(folder)) for place in posed or below], SHOWN)
        which = "that folder" if len(posed or below) == 1 else "one of these folders"
        raise ValueError(f"{folder} holds no pictures itself; pictures {'with cameras ' if posed else ''}are in "
                         f"{names}: give {which}")  # fmt: skip
    if not count:
        raise ValueError(f"{folder} holds no pictures ({', '.join(PICTURES)})")
    raise ValueError(
        f"{folder} holds {count} pictures and no cameras (transforms.json or a COLMAP model in sparse/0): make them "
        f"by novags poses {quote(str(folder))} --out SET, then novags import SET; where it is too dark for that, put "
        "the dark pictures under the names of the lit ones beside a model of the lit ones"
    )


def _with_pictures(folder: Path, depth: int = DEPTH) -> Iterator[Path]:
    """The folders at most `depth` below that hold pictures, themselves or in images/; none inside another."""
    for below in sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
        with suppress(PermissionError):  # lost+found of a disk, other users' folders
            places = (below, below / "images")
            if any(file.suffix.lower() in PICTURES for place in places for file in place.glob("*")):
                yield below
            elif depth > 1:
                yield from _with_pictures(below, depth - 1)


def _raws_beside(folder: Path, source: Source) -> tuple[Path, ...]:
    views = source.views
    listed = [os.path.relpath(file, folder) for file in views.files]
    found = [find_linear(folder, name, ("raw",), raw_files.SUFFIXES) for name in listed]
    missing = [name for name, file in zip(views.names, found, strict=True) if file is None]
    if len(missing) == len(found):
        return ()
    if missing:
        raise ValueError(
            f"{folder / 'raw'} has no file of {len(missing)} of {len(found)} views ({', '.join(missing[:4])}): add "
            "them, or move raw/ away"
        )
    return tuple(file for file in found if file is not None)
