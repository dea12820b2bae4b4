"""The colours that a raw file states: the balance of white, and the matrix of the camera.

A camera with automatic white balance states another one in each file. One surface has one colour in all views only if
one file's colours count for all.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sensor_model.files.dng import XYZ_TO_SRGB

IDENTITY = 1e-3  # files keep matrices as float32 and short fractions; the eye sees nothing of it
ALIKE = 1e-4  # of a white balance: files keep it as float32


@dataclass(frozen=True)
class RawColors:
    """What makes linear sRGB of a camera's channels."""

    response: tuple[float, float, float]  # of the camera's channels to the camera's white, green = 1
    color_matrix: np.ndarray | None  # [3,3], white-balanced camera RGB -> linear sRGB; None: they are the same

    def alike(self, other: "RawColors") -> bool:
        """Whether both make the same of the same codes."""
        ours, theirs = (np.eye(3) if c.color_matrix is None else c.color_matrix for c in (self, other))
        return np.allclose(self.response, other.response, rtol=ALIKE) and np.allclose(ours, theirs, atol=IDENTITY)


def colors_of(raw: Any, path: Path) -> RawColors:
    """The colours of a file that LibRaw has opened.

    Raises:
        ValueError: If no camera has them.
    """
    return RawColors(_response(raw, path), _color_matrix(raw, path))


def _response(raw: Any, path: Path) -> tuple[float, float, float]:
    """The inverse of the factors that balance white: the exposure's, else daylight's, else equal ones."""
    for found in (raw.camera_whitebalance, raw.daylight_whitebalance):
        red, green, blue = (float(f"{v:.6g}") for v in found[:3])  # LibRaw keeps them in float32
        if min(red, green, blue) > 0:
            if not all(1e-2 <= other / green <= 1e2 for other in (red, blue)):
                raise ValueError(f"{path} states the white balance {red:g}, {green:g}, {blue:g}: no light needs that")
            return green / red, 1.0, green / blue
    return 1.0, 1.0, 1.0


def _color_matrix(raw: Any, path: Path) -> np.ndarray | None:
    """The matrix in the file, which a DNG states, else the matrix of the camera's model, which LibRaw knows of most
    others.
    """
    matrix = np.array(raw.color_matrix, np.float64)[:3, :3]
    if not matrix.any():
        matrix = _of_model(np.array(raw.rgb_xyz_matrix, np.float64)[:3])
    if not matrix.any() or np.abs(matrix - np.eye(3)).max() < IDENTITY:
        return None
    if not (np.isfinite(matrix).all() and np.abs(matrix).max() < 100 and abs(np.linalg.det(matrix)) > 1e-3):
        raise ValueError(f"{path} states a colour matrix that no camera has: {matrix.round(3).tolist()}")
    return matrix


def _of_model(xyz_to_camera: np.ndarray) -> np.ndarray:
    """White-balanced camera RGB -> linear sRGB, [3,3], of a model by LibRaw; zeros if it states nothing."""
    filters = xyz_to_camera @ np.linalg.inv(XYZ_TO_SRGB)
    white = filters.sum(1, keepdims=True)  # the level that the balance makes 1
    if not (white > 0).all() or np.linalg.matrix_rank(filters) < 3:
        return np.zeros((3, 3))
    return np.linalg.inv(filters / white)
