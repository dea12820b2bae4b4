"""The files of a set, and further layouts of a set or a capture, each in a folder of its name inside it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from novags.testbed.console.terminal import Console, warnings_as_notes
from sensor_model.files.reading import brief
from simscenes.job.identity import SPENT
from simscenes.rigs import Rig
from simscenes.sets.geometry.depth_range import Depths
from simscenes.sets.multiview import MultiviewSet, load_set
from simscenes.sets.writers.camera_files import CAMERA_FILES
from simscenes.sets.writers.layouts import EXPORTS
from simscenes.sets.writers.neighbours import DEPTHS

if TYPE_CHECKING:
    from novags.testbed.folders.set import Source

RECORD = "set.json"
LAYOUTS = tuple(EXPORTS)
SET_FILES = (RECORD, "gt", "images", DEPTHS, SPENT, *CAMERA_FILES, *LAYOUTS)  # of a set folder made here, of any kind


def check_layouts(layouts: Sequence[str]) -> None:
    """Raise ValueError for a layout that does not exist."""
    if unknown := [name for name in layouts if name not in EXPORTS]:
        raise ValueError(f"export must be among {', '.join(EXPORTS)}; got {brief(', '.join(unknown))}")


def check_cameras_of(layouts: Sequence[str], rig: Rig) -> None:
    """Raise ValueError for a layout that cannot hold these cameras, before the work that would be exported."""
    for layout in layouts:
        EXPORTS[layout].check(rig)


def check_source_of(layouts: Sequence[str], source: "Source") -> None:
    """Raise ValueError for a layout that cannot be written of a capture of this set, before it is photographed."""
    check_cameras_of(layouts, source.rig)
    if any(EXPORTS[layout].needs_depth for layout in layouts):
        Depths.of_points(replace(source.views, rig=source.rig), source.points(), truth_of(source))


def truth_of(source: "Source") -> MultiviewSet | None:
    """The rendered set, which knows depth; None of photographs."""
    return source.views if source.views.kind == "rendered" else None


def write_layouts(folder: Path, layouts: Sequence[str], console: Console, *, truth: MultiviewSet | None = None) -> None:
    """Write further layouts of a finished set or capture.

    Args:
        folder: Of the set or capture.
        layouts: Which.
        console: Where notes go.
        truth: The rendered set that a capture was made of: it knows depth.

    Raises:
        ValueError: If a layout cannot hold these cameras.
    """
    for layout in layouts:
        with warnings_as_notes(console):
            EXPORTS[layout].write(load_set(folder), folder / layout, truth=truth)
