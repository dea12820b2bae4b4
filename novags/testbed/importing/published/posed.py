"""Scenes of photographs with cameras in a usual place: LLNeRF, LLRS, MVTV.

Pictures in images/ (or, shrunk, in images_N/), 8-bit, 16-bit or camera raw; cameras in sparse/0 (COLMAP),
transforms.json or poses_bounds.npy (LLFF).
"""

import os
from pathlib import Path

from novags.testbed.folders.photographs.linear import load_linear_set
from novags.testbed.importing.split import Split
from sensor_model.files.door import resolved
from simscenes.sets.multiview import MultiviewSet, load_photographs
from simscenes.sets.readers.colmap import find_colmap
from simscenes.sets.readers.llff import is_llff

LIT_BESIDE = "normal-light-scenes"  # the archive of LLNeRF with the lit pictures of three scenes
LIT_INSIDE = ("gt", "lit", "high")


def has_cameras(folder: Path) -> bool:
    """Whether a folder states cameras in one of these places."""
    return (folder / "transforms.json").is_file() or find_colmap(folder) is not None or is_llff(folder)


def open_scene(folder: Path, split: Split) -> MultiviewSet:  # none of these data sets publishes a split
    """The pictures of a scene with their cameras.

    Raises:
        ValueError: As `load_photographs`.
    """
    return load_linear_set(folder) or load_photographs(folder)


def lit_inside(folder: Path) -> Path | None:
    """The folder of the well-lit pictures inside a scene's, its name in upper or lower case."""
    below = {path.name.lower(): path for path in sorted(folder.iterdir()) if path.is_dir()}
    return next((below[name] for name in LIT_INSIDE if name in below), None)


def lit_beside(folder: Path) -> Path | None:
    """The folder of the well-lit pictures in the archive beside the dark scenes, or beside the folder of these."""
    found = (above / LIT_BESIDE / place.name for place in places(folder) for above in list(place.parents)[:2])
    return next((path for path in found if path.is_dir()), None)


def places(folder: Path) -> list[Path]:
    """A folder from the root: by the names that lead to it, and where links among these lead, if that is elsewhere."""
    return list(dict.fromkeys([Path(os.path.abspath(folder)), resolved(folder)]))
