"""The layout of the NeRF-synthetic scenes: transforms_train.json, transforms_test.json, transforms_val.json.

One field of view for all pictures, which may be transparent, and a split of its own.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from simscenes.sets.readers.finding import find_files
from simscenes.sets.readers.photographs import Photographs, frames_at, transforms_frames

PARTS = ("transforms_train.json", "transforms_test.json", "transforms_val.json")


def is_nerf_synthetic(folder: Path) -> bool:
    """Whether a folder has this layout."""
    return (folder / PARTS[0]).is_file()


def read_nerf_synthetic(folder: Path) -> Photographs:
    """Read the training views, and as held-out views the test views; the validation views only if there are no others.

    Raises:
        ValueError: If a camera file is not valid, no listed image exists, or sizes differ.
    """
    train = folder / PARTS[0]
    test = next((source for part in PARTS[1:] if (source := folder / part).is_file()), None)
    found, poses = transforms_frames(train)
    frames = [replace(frame, use="train") for frame in found]
    if test is not None:
        found, more = transforms_frames(test)
        frames, poses = frames + [replace(frame, use="test") for frame in found], poses + more
    files = find_files(folder, [frame.file_path for frame in frames])
    return frames_at(files, frames, poses, folder, train)
