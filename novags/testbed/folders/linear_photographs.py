"""Posed photographs whose files hold linear light: camera raw files or OpenEXR images, listed in a transforms.json.

Readers of 8-bit photographs are in `simscenes.sets.multiview`; this one takes the same camera file and gives the same
kind of set, one file in memory at a time.
"""

import json
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from novags.testbed.folders import raw_files
from sensor_model import to_srgb8
from simscenes.rigs import Rig, opengl_to_opencv
from simscenes.sets.exr import read_exr
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.photographs import transforms_lens

SUFFIXES = (".exr", *raw_files.SUFFIXES)
WHITE_QUANTILE = 0.99  # of an EXR image's light, whose unit is unknown, becomes white in its 8-bit picture


@dataclass(frozen=True, kw_only=True)
class LinearPhotographs(MultiviewSet):
    """Posed images with linear pixels. Of a raw file 1.0 is the white level; an EXR file has any unit."""

    def radiance(self, i: int) -> np.ndarray:
        """Linear RGB of view `i`, float32 [h,w,3], undistorted."""
        light = _middle(read_linear(self.files[i]), self.rig.height, self.rig.width)
        return light if self.lenses is None else self.lenses[i].undistort(light, self.rig.Ks[i])

    def image(self, i: int) -> np.ndarray:
        """The picture of view `i` at the exposure of the whole set, 8-bit sRGB [h,w,3]."""
        return to_srgb8(self.radiance(i) * np.float32(self.meta["exposure_scale"]))


def load_linear_set(folder: Path) -> LinearPhotographs | None:
    """The set, or None if the folder has no transforms.json that lists linear files.

    Raises:
        ValueError: If linear and other files are mixed, all are missing, or their sizes differ. Listed files that are
            missing are skipped and counted in one warning, as `load_set` does.
    """
    source = folder / "transforms.json"
    named = _listed(source)
    linear = [Path(path).suffix.lower() in SUFFIXES for _, path, _ in named]
    if not any(linear):
        return None
    if not all(linear):
        raise ValueError(f"{source} must list either linear files ({', '.join(SUFFIXES)}) or others, not both")
    listed = [entry for entry in named if (folder / entry[1]).is_file()]
    if not listed:
        raise ValueError(f"none of the {len(named)} images listed in {source} exists; put them where it says")
    if len(listed) < len(named):
        missing = f"{len(named) - len(listed)} of {len(named)} views listed in {source} have no image file"
        warnings.warn(f"{missing} and are skipped", stacklevel=2)
    files = [folder / path for _, path, _ in listed]
    order = sorted(range(len(files)), key=lambda i: str(files[i]))
    files = [files[i] for i in order]
    sizes = {_size(file) for file in files}
    if len(sizes) > 1:
        raise ValueError(f"the images of {source} must share one size, got {sorted(sizes)}")
    width, height = _without_margins(sizes.pop(), listed[0][0]) if raw_files.is_raw(files[0]) else sizes.pop()
    lenses = tuple(transforms_lens(listed[i][0], width, height, source) for i in order)
    rig = Rig(
        viewmats=opengl_to_opencv(np.stack([listed[i][2] for i in order])),
        Ks=np.stack([lens.pinhole(width, height) for lens in lenses]),
        width=width,
        height=height,
    )
    return LinearPhotographs(
        path=folder,
        names=_names(files),
        rig=rig,
        kind="photographs",
        meta={"exposure_scale": _exposure_scale(files)},
        files=tuple(files),
        lenses=lenses if any(any(lens.distortion) for lens in lenses) else None,
    )


def read_linear(file: Path) -> np.ndarray:
    """Linear RGB of a raw or EXR file, float32 [h,w,3].

    Raises:
        ValueError: If the file cannot be read, or is an EXR without the channels R, G, B.
    """
    if raw_files.is_raw(file):
        return raw_files.read_radiance(file)
    channels, _ = read_exr(file)
    if not {"R", "G", "B"} <= channels.keys():
        raise ValueError(f"{file} must have the channels R, G, B, got {', '.join(sorted(channels))}")
    return np.stack([channels[name] for name in "RGB"], axis=-1).astype(np.float32)


def _listed(source: Path) -> list[tuple[dict[str, Any], str, np.ndarray]]:
    """Camera, file and pose of every frame; empty if the file is missing or not for this reader."""
    try:
        content = json.loads(source.read_text(encoding="utf-8"))
        frames = content["frames"]
        return [({**content, **f}, f["file_path"], np.reshape(f["transform_matrix"], (4, 4))) for f in frames]
    except (OSError, ValueError, KeyError, TypeError):
        return []  # load_set reports what is wrong with it


def _size(file: Path) -> tuple[int, int]:
    if raw_files.is_raw(file):
        return raw_files.size(file)
    import OpenEXR

    try:
        with OpenEXR.File(str(file), header_only=True) as image:
            low, high = image.header()["dataWindow"]
    except Exception as error:  # OpenEXR raises several types
        raise ValueError(f"{file} is not a readable EXR file ({error})") from error
    return int(high[0] - low[0] + 1), int(high[1] - low[1] + 1)


def _without_margins(size: tuple[int, int], camera: dict[str, Any]) -> tuple[int, int]:
    """Raw files show some pixels around the camera's own pictures, from which poses are usually estimated."""
    listed = int(camera.get("w", size[0])), int(camera.get("h", size[1]))
    margins = all(0.95 * whole <= part <= whole for whole, part in zip(size, listed, strict=True))
    return listed if margins else size


def _middle(light: np.ndarray, height: int, width: int) -> np.ndarray:
    y, x = (light.shape[0] - height) // 2, (light.shape[1] - width) // 2
    return light[y : y + height, x : x + width]


def _names(files: list[Path]) -> tuple[str, ...]:
    stems = [file.stem for file in files]
    if len(set(stems)) < len(stems):
        raise ValueError(f"file names must differ in more than their extension or folder, got {sorted(stems)}")
    return tuple(stems)


def _exposure_scale(files: list[Path]) -> float:
    """One factor for the whole set that makes a bright part of its first view white."""
    if raw_files.is_raw(files[0]):
        return 1.0
    white = float(np.quantile(read_linear(files[0]), WHITE_QUANTILE))
    return 1.0 / white if np.isfinite(white) and white > 0 else 1.0
