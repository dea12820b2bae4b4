"""Posed photographs whose files hold linear light: camera raw files or OpenEXR images beside their cameras.

Readers of 8-bit photographs are in `simscenes.sets.multiview`; this one takes the same camera file and gives the same
kind of set, one file in memory at a time.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from novags.testbed.folders.photographs import raw_files
from novags.testbed.folders.photographs.raw_colors import RawColors
from sensor_model.isp import to_srgb8
from simscenes.rigs import opengl_to_opencv
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.pictures.exr import read_exr
from simscenes.sets.pictures.exr_meaning import refuse_clear, refuse_foreign, refuse_pixels
from simscenes.sets.readers.colmap import colmap_lens, colmap_views, find_colmap
from simscenes.sets.readers.finding import spelt
from simscenes.sets.readers.photographs import (
    DistortedPinhole,
    find_file,
    held_out,
    listed,
    names_for_testing,
    rig_of,
    transforms_frames,
    transforms_lens,
)

SUFFIXES = (".exr", *raw_files.SUFFIXES)
# From this factor on between two pictures of one shape, the smaller one was shrunk. A cut takes some dozen px from each
# side, which changes the shape. Rounding to whole pixels changes the ratio of the sides a little.
LARGER, SAME_SHAPE = 1.01, 0.001
WHITE_QUANTILE = 0.99  # of an EXR image's light, whose unit is unknown, becomes white in its 8-bit picture


@dataclass(frozen=True, kw_only=True)
class LinearPhotographs(MultiviewSet):
    """Posed images with linear pixels. Of a raw file 1.0 is the white level; an EXR file has any unit."""

    colors: RawColors | None = None  # of all raw files; None: of each its own

    def radiance(self, i: int) -> np.ndarray:
        """Linear RGB of view `i`, float32 [h,w,3], undistorted."""
        light = part_of(read_linear(self.files[i], self.colors), self.files[i], self.rig.height, self.rig.width)
        return light if self.lenses is None else self.lenses[i].undistort(light, self.rig.Ks[i])

    def image(self, i: int) -> np.ndarray:
        """The picture of view `i` at the exposure of the whole set, 8-bit sRGB [h,w,3]."""
        return to_srgb8(self.radiance(i) * np.float32(self.meta["exposure_scale"]))


def load_linear_set(folder: Path) -> LinearPhotographs | None:
    """The set, or None if neither transforms.json nor a COLMAP model lists linear files, or pictures that are gone and
    have linear files of the same stem in images/, raw/ or the folder itself.

    Raises:
        ValueError: If the camera file is not valid, linear and other files are mixed, all are missing, or their sizes
            differ. Listed files that are missing are skipped, counted and named in one warning, as `load_set` does.
    """
    model = _model(folder)
    if model is None:
        return None
    there = listed(model.files, model.source, model.names)
    files = tuple(file for i in there.values() if (file := model.files[i]) is not None)
    sizes = {_size(file) for file in files}
    if len(sizes) > 1:
        raise ValueError(f"the images of {model.source} must share one size, got {sorted(sizes)}")
    size = sizes.pop()
    if raw_files.is_raw(files[0]):
        size = _without_margins(files[0], size, model.size(model.cameras[next(iter(there.values()))]))
    rig, lenses = rig_of(there.values(), model.viewmats, model.cameras, model.source, model.lens, size)
    return LinearPhotographs(
        path=folder,
        names=tuple(there),
        rig=rig,
        kind="photographs",
        meta={"exposure_scale": _exposure_scale(files)},
        files=files,
        held_out=held_out(files, model.tested, model.source),
        lenses=lenses if any(any(lens.distortion) for lens in lenses) else None,
        colors=raw_files.first_colors(files),
    )


@dataclass(frozen=True)
class _Model:
    """The cameras of a folder and their linear files, from whichever camera file it has."""

    source: Path
    files: list[Path | None]  # None: not there
    viewmats: list[np.ndarray]  # world-to-camera [4,4]
    cameras: list[Any]
    size: Callable[[Any], tuple[int | None, int | None]]  # that a camera states, px
    lens: Callable[[Any, int, int], DistortedPinhole]
    names: Sequence[str]  # name of the files in messages
    tested: set[Path] = field(default_factory=set)  # files that it holds out


def _model(folder: Path) -> _Model | None:
    """The cameras of linear files; None where the folder is for `load_set`."""
    if (source := folder / "transforms.json").is_file():
        return _of_transforms(folder, source)
    model = find_colmap(folder)
    return _of_colmap(folder, model) if model is not None and _has_linear(folder) else None


def _of_transforms(folder: Path, source: Path) -> _Model | None:
    frames, poses = transforms_frames(source)
    files = _linear_files(folder, folder, [frame.file_path for frame in frames], source)
    if files is None:
        return None
    named = {Path(name) for name in names_for_testing(source)}
    tested = {f for f, frame in zip(files, frames, strict=True) if f is not None and Path(frame.file_path) in named}
    return _Model(
        source, files, [opengl_to_opencv(pose) for pose in poses], [frame.camera for frame in frames],
        lambda c: (c.get("w"), c.get("h")), partial(transforms_lens, source=source),
        spelt(folder, [frame.file_path for frame in frames], files), tested,
    )  # fmt: skip


def _of_colmap(folder: Path, model: Path) -> _Model | None:
    names, viewmats, cameras = colmap_views(model)
    files = _linear_files(folder, folder / "images", names, model)
    if files is None:
        return None
    return _Model(
        model, files, viewmats, cameras, lambda c: (c.width, c.height), partial(colmap_lens, source=model),
        spelt(folder / "images", names, files),
    )  # fmt: skip


def _has_linear(folder: Path) -> bool:
    """Whether it is worth while to read the model, which `load_set` reads again: a large one takes seconds."""
    files = (file for part in ("images", "raw") for file in (folder / part).rglob("*"))
    return any(file.suffix.lower() in SUFFIXES for file in (*folder.iterdir(), *files))


def _linear_files(folder: Path, images: Path, names: list[str], source: Path) -> list[Path | None] | None:
    """The linear file for each listed name; None if the folder holds no linear files."""
    linear = [Path(name).suffix.lower() in SUFFIXES for name in names]
    found = [find_file(images, name) for name in names]
    if any(linear):
        if not all(linear):
            raise ValueError(f"{source} must list either linear files ({', '.join(SUFFIXES)}) or others, not both")
        return found
    if any(found):
        return None
    beside = [find_linear(folder, name) for name in names]
    return beside if any(beside) else None


def find_linear(folder: Path, name: str, places: tuple[str, ...] = ("images", "raw", "."),
                suffixes: tuple[str, ...] = SUFFIXES) -> Path | None:  # fmt: skip
    """The linear file that belongs to a picture that a camera file lists: of the same stem."""
    below = Path(name).parts[1:] if Path(name).parts[:1] == ("images",) else Path(name).parts
    stem = Path(*below).with_suffix("") if below else Path(name)
    tried = (folder / place / f"{stem}{form}" for place in places for s in suffixes for form in (s, s.upper()))
    return next((path for path in tried if path.is_file()), None)


def read_linear(file: Path, colors: RawColors | None = None) -> np.ndarray:
    """Linear RGB of a raw (see `read_radiance`) or EXR file, float32 [h,w,3].

    Raises:
        ValueError: If the file cannot be read, or is an EXR that is not one whole opaque picture with R, G and B in
            linear sRGB (see `exr_meaning`).
    """
    if raw_files.is_raw(file):
        return raw_files.read_radiance(file, colors)
    refuse_foreign(file)
    channels, _ = read_exr(file)
    if not {"R", "G", "B"} <= channels.keys():
        raise ValueError(f"{file} must have the channels R, G, B, got {', '.join(sorted(channels))}")
    refuse_pixels(channels, file)
    refuse_clear(channels, file)
    return np.stack([channels[name] for name in "RGB"], axis=-1).astype(np.float32)


def _size(file: Path) -> tuple[int, int]:
    if raw_files.is_raw(file):
        return raw_files.size(file)
    low, high = refuse_foreign(file)["dataWindow"]
    return int(high[0] - low[0] + 1), int(high[1] - low[1] + 1)


def _without_margins(file: Path, size: tuple[int, int], stated: tuple[float | None, float | None]) -> tuple[int, int]:
    """Raw files show some pixels around the camera's own pictures, from which poses are usually estimated."""
    width, height = (whole if part is None else int(part) for whole, part in zip(size, stated, strict=True))
    if within_margins(file, size, (width, height)):
        return width, height
    if (times := shrunk_by(size, (width, height))) > 1:
        warnings.warn(f"raw files of {file.parent} are {size[0]} x {size[1]} px, {times:.3g} times the {width} x "
                      f"{height} px of their cameras and of the same shape: the pictures with cameras count as shrunk "
                      "by that, not as cut out of the middle", stacklevel=4)  # fmt: skip
    return size


def within_margins(file: Path, whole: tuple[int, int], part: tuple[int, int]) -> bool:
    """Whether a picture of size `part` is cut out of a raw frame of size `whole`, and not shrunk from it."""
    inside = all(0.95 * outer <= inner <= outer for outer, inner in zip(whole, part, strict=True))
    return inside and (shrunk_by(whole, part) == 1 or raw_files.crop_of(file, whole[::-1], *part[::-1]) is not None)


def shrunk_by(whole: tuple[int, int], part: tuple[int, int]) -> float:
    """The factor by which a picture of size `whole` was shrunk to size `part`; 1 if it was cut, or not changed."""
    x, y = (outer / max(inner, 1) for outer, inner in zip(whole, part, strict=True))
    return x if x > LARGER and abs(x / y - 1) < SAME_SHAPE else 1.0


def part_of(light: np.ndarray, file: Path, height: int, width: int) -> np.ndarray:
    """The part of the image [h,w,...] in a file that is the picture of this size."""
    y, x = raw_files.place_of(file, light.shape[:2], height, width)
    return light[y : y + height, x : x + width]


def _exposure_scale(files: tuple[Path, ...]) -> float:
    """One factor for the whole set that makes a bright part of its first view white."""
    if raw_files.is_raw(files[0]):
        return 1.0
    white = float(np.quantile(read_linear(files[0]), WHITE_QUANTILE))
    return 1.0 / white if np.isfinite(white) and white > 0 else 1.0
