"""Photographs without poses: which files they are, the camera's entries in their headers, and their pixels.

Poses refer to pixels as stored. A mark of orientation (EXIF) is therefore ignored: the camera's sensor is the same
however it was held, and a pose includes the roll. Pictures stored upright among lying ones, or the other way round, are
turned by 90 degrees; pictures of another size count as another camera, are scaled and cropped.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.sets.pictures.image_file import header, image_size, read_rgb
from simscenes.sets.pictures.mask import is_mask

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg")
# Of EXIF: camera's maker and model, the part with the exposure, and in it focal length in mm and its 35 mm equivalent.
MAKE, MODEL, EXPOSURE, FOCAL, FOCAL_35 = 0x010F, 0x0110, 0x8769, 0x920A, 0xA405
DIAGONAL_35 = 43.267  # mm, of 36 x 24
MASK = re.compile(r"(.+)[._-](?:mask|masks|alpha|matte|seg)")
COMPRESSED, MASK_BYTES = (".png", ".jpg", ".jpeg", ".webp"), 0.2  # of a pixel; photographs take more, masks less
FOCALS = (1.0, 5000.0)  # mm; a header's value outside this range is not a focal length


@dataclass(frozen=True)
class Bare:
    """A photograph without a pose.

    Attributes:
        file: The image file.
        turned: Whether it is turned by 90 degrees, so that all pictures lie alike.
        size: Width and height after turning and scaling, px; at least the size of the whole set.
        camera: Photographs with the same number share a lens and a size.
        focal: As the header states it, in px of `size`; None where it does not.
    """

    file: Path
    turned: bool
    size: tuple[int, int]
    camera: int
    focal: float | None

    def pixels(self) -> NDArray[np.uint8]:
        """As 8-bit sRGB [h, w, 3] of `size`.

        Raises:
            ValueError: If the file cannot be read.
        """
        import cv2

        found = read_rgb(self.file)
        if self.turned:
            found = np.ascontiguousarray(np.rot90(found))
        if found.shape[1::-1] == self.size:
            return found
        way = cv2.INTER_AREA if found.shape[1] > self.size[0] else cv2.INTER_CUBIC
        return np.asarray(cv2.resize(found, self.size, interpolation=way), np.uint8)


def picture_files(folder: Path) -> list[Path]:
    """The photographs of a folder, sorted: directly in it, else in images/, else in any folder below."""
    for found in (folder.glob("*"), (folder / "images").glob("*"), folder.rglob("*")):
        hidden = (file for file in found if not any(p.startswith(".") for p in file.relative_to(folder).parts))
        files = sorted(file for file in hidden if file.suffix.lower() in SUFFIXES and file.is_file())
        if files:
            return files
    return []


def without_masks(files: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Photographs, and masks among them: files named after another one, in a folder of masks, or that look so.

    Args:
        files: Of one folder or the folders below; if all would be masks, none is.
    """
    named = set(named_as_masks(files))
    masks = [file for file in files if file in named or looks_like_mask(file)]
    if len(masks) == len(files):
        return list(files), []
    return [file for file in files if file not in masks], masks


def named_as_masks(files: Sequence[Path]) -> list[Path]:
    """The files among these whose names say that they are masks of another one, or that lie in a folder of masks."""
    names = {file.name.lower() for file in files}
    stems = {file.stem.lower() for file in files}

    def is_mask(file: Path) -> bool:
        stem = file.stem.lower()
        # COLMAP's masks: photo.jpg.png of photo.jpg; others: photo_mask.png, photo.mask.png.
        if stem in names or file.parent.name.lower() in ("mask", "masks"):
            return True
        return (match := MASK.fullmatch(stem)) is not None and match[1] in stems

    return [file for file in files if is_mask(file)]


def looks_like_mask(file: Path) -> bool:
    """Whether a file of a picture shows a mask: its pixels are looked at where so few bytes can be one.

    Raises:
        ValueError: If the file cannot be read.
    """
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        return False
    width, height = image_size(file)
    if suffix in COMPRESSED and file.stat().st_size > MASK_BYTES * width * height + 1000:
        return False
    return is_mask(read_rgb(file))


def survey(files: Sequence[Path], max_size: int | None) -> tuple[list[Bare], tuple[int, int]]:
    """How to bring each photograph to one common size, and that size (width, height).

    Args:
        files: At least one.
        max_size: Longest side of the pictures, px; None: the longest side of the most common size.

    Raises:
        ValueError: If a file is not a readable image.
    """
    stored = [image_size(file) for file in files]
    lying = Counter(stored)
    width, height = max(lying, key=lambda size: (lying[size], size[0] * size[1], size))
    scale = 1.0 if max_size is None else min(1.0, max_size / max(width, height))
    common = max(1, round(width * scale)), max(1, round(height * scale))
    cameras: dict[tuple[Any, ...], int] = {}
    found = []
    for file, (w, h) in zip(files, stored, strict=True):
        turned = (w > h) != (width > height) and w != h and width != height
        size = _covering((h, w) if turned else (w, h), (width, height), common)
        lens, focal_35 = _lens(file)
        focal = None if focal_35 is None else focal_35 / DIAGONAL_35 * math.hypot(*size)
        camera = cameras.setdefault((w, h, turned, *lens), len(cameras))
        found.append(Bare(file, turned, size, camera, focal))
    return found, common


def _covering(size: tuple[int, int], most: tuple[int, int], common: tuple[int, int]) -> tuple[int, int]:
    """The smallest size of the same shape that covers the common one."""
    if size == most:
        return common
    scale = max(common[0] / size[0], common[1] / size[1])
    return max(common[0], round(size[0] * scale)), max(common[1], round(size[1] * scale))


def _lens(file: Path) -> tuple[tuple[Any, ...], float | None]:
    """Entries of the header that tell lenses apart, and the 35 mm equivalent of the focal length."""
    lens: tuple[Any, ...] = ()
    focal: float | None = None
    with header(file) as image, suppress(Exception):  # metadata of any kind of damage is as good as none
        exif = image.getexif()
        exposure = exif.get_ifd(EXPOSURE)
        lens = tuple(str(part)[:80] for part in (exif.get(MAKE), exif.get(MODEL), exposure.get(FOCAL)))
        stated = float(exposure[FOCAL_35])
        focal = stated if FOCALS[0] <= stated <= FOCALS[1] else None
    return lens, focal
