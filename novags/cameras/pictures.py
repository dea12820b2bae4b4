"""Pictures that a camera source looks at: of which shape, and as files for programs that read files."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor


def check_views(
    pictures: NDArray[Any], colors_from: Tensor, n_points: int, Ks: NDArray[Any] | None = None, *, fewest: int = 2
) -> None:
    """Raise a ValueError unless these go together.

    Args:
        pictures: [C, h, w, 3] uint8.
        colors_from: [C, h, w, 3].
        n_points: At least 2: colours are averaged over neighbours.
        Ks: [C, 3, 3], of sources that know them.
        fewest: Views that the source needs.
    """
    if pictures.ndim != 4 or pictures.shape[-1] != 3 or pictures.dtype != np.uint8 or len(pictures) < fewest:
        raise ValueError(f"pictures must be uint8 [C >= {fewest}, h, w, 3], got {pictures.dtype} {pictures.shape}")
    if tuple(colors_from.shape) != pictures.shape:
        raise ValueError(f"colors_from must be {pictures.shape} like the pictures, got {tuple(colors_from.shape)}")
    if Ks is not None and Ks.shape != (len(pictures), 3, 3):
        raise ValueError(f"Ks must be [C, 3, 3] for {len(pictures)} pictures, got {Ks.shape}")
    if n_points < 2:
        raise ValueError(f"n_points must be >= 2, got {n_points}")


def write_pictures(folder: Path, pictures: NDArray[np.uint8]) -> list[str]:
    """Write them as 8-bit PNG and return the names of the files, whose order and stems are the places 0, 1, ...

    Raises:
        ValueError: If the folder cannot be written to.
    """
    import cv2

    names = [f"{i:06d}.png" for i in range(len(pictures))]
    for name, picture in zip(names, pictures, strict=True):
        if not cv2.imwrite(str(folder / name), picture[..., ::-1]):
            raise ValueError(f"cannot write a temporary picture into {folder}: free some space there")
    return names


def place_of(name: str) -> int:
    """Which of the pictures a file of `write_pictures` is, from its name or path."""
    return int(Path(name).stem)
