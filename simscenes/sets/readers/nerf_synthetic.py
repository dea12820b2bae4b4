"""The layout of the NeRF-synthetic scenes: transforms_train.json, transforms_test.json, transforms_val.json.

One field of view for all pictures, which may be transparent, and a split of its own.
"""

from __future__ import annotations

from pathlib import Path

from simscenes.rigs import opengl_to_opencv
from simscenes.sets.readers.photographs import Photographs, collect, find_file, transforms_frames, transforms_lens

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
    entries, tested = [], set()
    for source in (train, *([] if test is None else [test])):
        for frame in transforms_frames(source):
            file = find_file(folder, frame.file_path)
            entries.append((file, opengl_to_opencv(frame.pose), frame.camera))
            if source is test and file is not None:
                tested.add(file)
    found = collect(entries, train, lambda c, w, h: transforms_lens(c, w, h, train))
    return found.holding_out(tested, train)
