"""Posed photographs whose files hold linear light: camera raw files or OpenEXR images, listed in a transforms.json.

Readers of 8-bit photographs are in `simscenes.sets.multiview`; this one takes the same camera file and gives the same
kind of set, one file in memory at a time.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from novags.testbed.folders import raw_files
from sensor_model import to_srgb8
from sensor_model.files.reading import reading
from simscenes.rigs import Rig, opengl_to_opencv
from simscenes.sets.exr import read_exr
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.photographs import (
    find_file,
    held_out,
    listed,
    listed_for_testing,
    transforms_frames,
    transforms_lens,
)

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
        ValueError: If the camera file is not valid, linear and other files are mixed, all are missing, or their sizes
            differ. Listed files that are
            missing are skipped and counted in one warning, as `load_set` does.
    """
    source = folder / "transforms.json"
    frames = transforms_frames(source) if source.is_file() else []
    linear = [Path(frame.file_path).suffix.lower() in SUFFIXES for frame in frames]
    if not any(linear):
        return None
    if not all(linear):
        raise ValueError(f"{source} must list either linear files ({', '.join(SUFFIXES)}) or others, not both")
    found = listed([(find_file(folder, f.file_path), opengl_to_opencv(f.pose), f.camera) for f in frames], source)
    entries = list(found.values())
    files = tuple(entry.file for entry in entries)
    sizes = {_size(file) for file in files}
    if len(sizes) > 1:
        raise ValueError(f"the images of {source} must share one size, got {sorted(sizes)}")
    width, height = sizes.pop()
    if raw_files.is_raw(files[0]):
        width, height = _without_margins((width, height), frames[0].camera)
    with reading(source):
        lenses = tuple(transforms_lens(entry.camera, width, height, source) for entry in entries)
        rig = Rig(
            viewmats=np.stack([entry.viewmat for entry in entries]),
            Ks=np.stack([lens.pinhole(width, height) for lens in lenses]),
            width=width,
            height=height,
        )
    return LinearPhotographs(
        path=folder,
        names=tuple(found),
        rig=rig,
        kind="photographs",
        meta={"exposure_scale": _exposure_scale(files)},
        files=files,
        held_out=held_out(files, listed_for_testing(source), source),
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
    stated = int(camera.get("w", size[0])), int(camera.get("h", size[1]))
    margins = all(0.95 * whole <= part <= whole for whole, part in zip(size, stated, strict=True))
    return stated if margins else size


def _middle(light: np.ndarray, height: int, width: int) -> np.ndarray:
    y, x = (light.shape[0] - height) // 2, (light.shape[1] - width) // 2
    return light[y : y + height, x : x + width]


def _exposure_scale(files: tuple[Path, ...]) -> float:
    """One factor for the whole set that makes a bright part of its first view white."""
    if raw_files.is_raw(files[0]):
        return 1.0
    white = float(np.quantile(read_linear(files[0]), WHITE_QUANTILE))
    return 1.0 / white if np.isfinite(white) and white > 0 else 1.0
