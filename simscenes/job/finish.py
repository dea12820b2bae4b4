"""The last step of a job: 8-bit images with one exposure for the set, sparse points, cameras."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.camera import camera_color
from simscenes.job.sparse import surface_points
from simscenes.rigs import Rig
from simscenes.sets.camera_files import write_cameras
from simscenes.sets.exr import read_exr
from simscenes.sets.multiview import encode_srgb


def finish_set(out: Path, names: list[str], rig: Rig, seed: int, camera: str | None) -> dict[str, Any]:
    """Write what depends on all views together; what set.json says about it."""
    (out / "images").mkdir(exist_ok=True)
    radiance, depths = [], []
    for name in names:
        channels, _ = read_exr(out / "gt" / f"{name}.exr")
        radiance.append(np.stack([channels[c] for c in "RGB"], -1))
        depths.append(channels["Z"])
    about: dict[str, Any] = {}
    if camera is not None:
        found = camera_color(camera)
        radiance = [r @ np.linalg.inv(found.matrix).T.astype(np.float32) for r in radiance]  # for looking at only
        about = {"camera_matrix": found.matrix.tolist(), "camera_matrix_error": found.matrix_error}
    scale = exposure_scale(radiance)
    images = [encode_srgb(r * np.float32(scale)) for r in radiance]
    for name, image in zip(names, images, strict=True):
        write_png(out / "images" / f"{name}.png", image)
    write_cameras(out, names, rig, points=surface_points(rig, depths, lambda i: images[i], seed=seed))
    return {"exposure_scale": scale, **about}


def write_png(path: Path, image: NDArray[np.uint8]) -> None:
    """Write an 8-bit RGB image [h,w,3] atomically."""
    import cv2

    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp.png")
    try:
        if not cv2.imwrite(str(temporary), np.ascontiguousarray(image[..., ::-1])):
            raise OSError(f"cannot write {path}")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def exposure_scale(radiance: list[NDArray[np.float32]]) -> float:
    """One exposure for the set: 97 % of all pixels stay below white, so a lamp in view does not darken the room."""
    white = float(np.quantile(np.concatenate([r.max(-1).ravel() for r in radiance]), 0.97))
    return 1.0 / white if white > 0 else 1.0
