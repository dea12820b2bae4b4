"""Pictures of views that any program made: a folder of files that are named like the views."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from novags.testbed.metrics.picture import Image
from sensor_model.isp import linear_to_srgb, srgb_to_linear
from simscenes.sets.pictures.exr import read_exr
from simscenes.sets.pictures.exr_meaning import OPAQUE, refuse_clear, refuse_foreign, refuse_pixels
from simscenes.sets.pictures.image_file import (
    COLOR,
    alpha_of,
    before_white,
    has_alpha,
    read_deep,
    read_image,
    stated_curve,
)
from simscenes.sets.pictures.meaning import Curve, is_deep

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".exr")
NAMED = 10  # views that an error names
Kind = Literal["8-bit", "16-bit", "EXR"]


@dataclass(frozen=True)
class ForeignPicture:
    """The picture in a file.

    Attributes:
        values: Linear light or sRGB-encoded values, as was asked for, float32 [h,w,3]; codes over the largest code.
        kind: Of the file.
        depth: Expected z-depth [h,w], world units, of an EXR file with a channel Z; else None.
        alpha: Opacity [h,w], 0..1: its channel alpha or A, else 1 everywhere. None without depth.
        clear: Whether pixels are transparent, so that `values` show some of the white behind them.
    """

    values: Image
    kind: Kind
    depth: np.ndarray | None = None
    alpha: np.ndarray | None = None
    clear: bool = False


@dataclass(frozen=True)
class Renders:
    """The pictures of some views in a folder.

    Attributes:
        folder: The folder.
        files: The file of each view, by the name of the view.
        ignored: Pictures in the folder that are of none of these views.
    """

    folder: Path
    files: dict[str, Path]
    ignored: tuple[str, ...]


def find_renders(folder: Path, names: Sequence[str]) -> Renders:
    """The pictures of these views: NAME with any suffix of `SUFFIXES`.

    Args:
        folder: Where they lie; folders in it are not looked into.
        names: Of the views.

    Raises:
        ValueError: If there is no such folder, a view has no picture (all such are named), or more than one.
    """
    if not folder.is_dir():
        raise ValueError(f"the folder of pictures {folder} does not exist")
    found: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in SUFFIXES and path.is_file() and not path.name.startswith("."):
            found.setdefault(path.stem, []).append(path)
    if missing := [name for name in names if name not in found]:
        there = f"it holds {_listed(found)}" if found else f"it holds no pictures{_below(folder)}"
        raise ValueError(
            f"{folder} lacks {len(missing)} of the {len(names)} test views: {_listed(missing)}; {there}: name each "
            f"picture like its view ({missing[0]}.png)"
        )
    if twice := [name for name in names if len(found[name]) > 1]:
        both = " and ".join(path.name for path in found[twice[0]])
        raise ValueError(f"{folder} has more than one picture of view {twice[0]} ({both}): remove one of them")
    ignored = tuple(path.name for name, paths in found.items() if name not in names for path in paths)
    return Renders(folder, {name: found[name][0] for name in names}, ignored)


def _below(folder: Path) -> str:
    """The folders in a folder that hold pictures, for a message: ns-render makes rgb/, others test/ or renders/."""
    holders = [path.name for path in sorted(folder.iterdir()) if path.is_dir() and not path.name.startswith(".")
               and any(file.suffix.lower() in SUFFIXES for file in path.iterdir())]  # fmt: skip
    return f" itself, pictures are in {_listed(holders)}: give such a folder" if holders else ""


def read_picture(file: Path, width: int, height: int, *, linear: bool = False) -> ForeignPicture:
    """Read one picture of a view of `width` x `height` px as linear light, or else as sRGB-encoded values.

    Codes of 8 bits are sRGB-encoded. Codes of 16 bits are what is asked for, unless their file says otherwise, and so
    are the numbers of EXR files. Transparent pixels stand before white, as the test bed's own sets have them; an EXR
    file has its colours multiplied by the channel A, and none of them transparent in linear light, where no number is
    known to be white.

    Raises:
        ValueError: If it cannot be read, has another size, holds other than 8- or 16-bit codes, is an EXR file without
            R, G and B or not opaque in linear light, or a value is not finite.
    """
    picture = _read_exr(file, linear) if file.suffix.lower() == ".exr" else _read_codes(file, linear)
    found = picture.values.shape[:2]
    if found != (height, width):
        raise ValueError(f"{file} is {found[1]} x {found[0]} px, and its view {width} x {height}: render it in the "
                         "size of the set")  # fmt: skip
    for what, values in (("a value", picture.values), ("its alpha", picture.alpha)):
        if values is not None and not np.isfinite(values).all():
            raise ValueError(f"{file}: {what} is not finite ({int((~np.isfinite(values)).sum())} numbers): write them "
                             "again")  # fmt: skip
    return picture


def _read_codes(file: Path, linear: bool) -> ForeignPicture:
    clear = has_alpha(file) and bool((alpha_of(file) < 255).any())
    deep = is_deep(file)
    if deep:
        values = read_deep(file)
    elif has_alpha(file):
        values = before_white(file)[0]
    else:
        bgr = read_image(file, COLOR)
        values = np.ascontiguousarray(bgr[..., ::-1]).astype(np.float32) / np.float32(255)
    asked: Curve = "linear" if linear else "srgb"
    if (stated_curve(file) or asked if deep else "srgb") != asked:
        values = np.asarray((srgb_to_linear if linear else linear_to_srgb)(values), np.float32)
    return ForeignPicture(values, "16-bit" if deep else "8-bit", clear=clear)


def _read_exr(file: Path, linear: bool) -> ForeignPicture:
    refuse_foreign(file)
    channels, _ = read_exr(file)
    if missing := [name for name in "RGB" if name not in channels]:
        raise ValueError(f"{file} lacks the channels {', '.join(missing)}, it has {_listed(sorted(channels))}: write "
                         "R, G and B")  # fmt: skip
    refuse_pixels(channels, file)
    values = np.stack([channels[name] for name in "RGB"], axis=-1).astype(np.float32)
    seen = np.clip(channels.get("A", np.ones_like(values[..., 0])).astype(np.float32), 0.0, 1.0)
    if clear := not (seen >= OPAQUE).all():
        if linear:
            refuse_clear(channels, file)
        values += 1 - seen[..., None]
    if "Z" not in channels:
        return ForeignPicture(values, "EXR", clear=clear)
    alpha = np.clip(channels.get("alpha", seen).astype(np.float32), 0.0, 1.0)
    return ForeignPicture(values, "EXR", channels["Z"].astype(np.float32), alpha, clear)


def _listed(names: Iterable[str]) -> str:
    every = list(names)
    more = len(every) - NAMED
    return ", ".join(every[:NAMED]) + (f" and {more} more" if more > 0 else "")
