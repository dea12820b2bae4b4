"""Focal lengths as a transforms.json states them: in px, or as the angle that the picture spans."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

# Entries that state a focal length along x and along y, in the order in which they count: px, rad, degrees. The last
# is what instant-ngp's own script writes of several cameras, and its reader leaves alone.
FOCAL_X = ("fl_x", "camera_angle_x", "x_fov", "fovx")
FOCAL_Y = ("fl_y", "camera_angle_y", "y_fov", "fovy")
FOCAL = (*FOCAL_X, *FOCAL_Y)
MOST_APART = 1.1  # ratio of two statements of one focal length; a changed margin makes less, another lens more


def focal_length(camera: dict[str, Any], keys: Sequence[str], side: float) -> float | None:
    """Focal length along one axis, px: stated itself, or as the angle (rad, then degrees) that `side` px span."""
    px, rad, *degrees = keys
    if px in camera:
        return float(camera[px])
    angles = [float(camera[rad])] if rad in camera else [np.radians(camera[key]) for key in degrees if key in camera]
    with np.errstate(over="ignore", divide="ignore"):  # ranges are checked where the lens is made
        return float(side / 2 / np.tan(angles[0] / 2)) if angles else None


def first_focal(cameras: Sequence[dict[str, Any]]) -> float | None:
    """A focal length of the first camera, px, for messages; None if that takes the size of its picture."""
    camera = cameras[0] if cameras else {}
    return focal_length(camera, FOCAL_X, camera["w"]) if "w" in camera else camera.get("fl_x")


def contradictions(cameras: Sequence[dict[str, Any]], source: Path) -> list[str]:
    """A note where a camera states two focal lengths along one axis: which one counts."""
    for camera in cameras:
        for keys, size in ((FOCAL_X, "w"), (FOCAL_Y, "h")):
            if size not in camera or camera[size] <= 0:
                continue
            stated = {key: px for key in keys if key in camera
                      and (px := focal_length({key: camera[key]}, keys, camera[size])) is not None}  # fmt: skip
            if len(stated) > 1 and max(stated.values()) > MOST_APART * min(stated.values()):
                told = ", ".join(f"{key} gives {px:.4g} px" for key, px in stated.items())
                return [f"{source} states two focal lengths: {told}; {next(iter(stated))} counts"]
    return []
