"""The last step of a job: 8-bit images with one exposure for the set, sparse points, cameras.

One view is in memory at a time. Light and depth of each go to disk uncompressed at once (16 bytes a pixel, until the
set is finished), so that no EXR file is decoded again; the exposure needs only the brightest pixels.
"""

from __future__ import annotations

import io
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.atomic import atomic, remove
from sensor_model.files.door import opened
from sensor_model.isp import to_srgb8
from simscenes.camera import camera_color
from simscenes.job.exposure import BELOW_WHITE, RunningQuantile, exposure_scale
from simscenes.job.sparse import surface_points
from simscenes.rigs import Rig
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.pictures.png import write_png
from simscenes.sets.writers.camera_files import write_cameras
from simscenes.sets.writers.layouts import EXPORTS
from simscenes.sets.writers.neighbours import DEPTHS, DepthLoss, write_depth

SCRATCH = ".views"


class ViewStore:
    """Light and depth of the views of a job.

    Args:
        folder: An empty folder for them.
        rig: The cameras.
        camera: As in `Optics`. The light behind its filters becomes linear sRGB again, for display only.
    """

    def __init__(self, folder: Path, rig: Rig, camera: str | None) -> None:
        self.folder = folder
        self.rig, self.color = rig, None if camera is None else camera_color(camera)

    def put(self, i: int, channels: dict[str, NDArray[Any]]) -> None:
        """Keep the needed channels of view `i`: R, G, B and Z, float32 [h,w]. The last ones count."""
        light = np.stack([channels[c] for c in "RGB"], -1)
        if self.color is not None:
            light = light @ np.linalg.inv(self.color.matrix).T.astype(np.float32)
        _save(self.folder / f"{i}.light.npy", light)
        _save(self.folder / f"{i}.depth.npy", channels["Z"])

    def light(self, i: int) -> NDArray[np.float32]:
        """Linear sRGB of view `i`, [h,w,3]."""
        return _loaded(self.folder / f"{i}.light.npy")

    def depth(self, i: int) -> NDArray[np.float32]:
        """z-depth of view `i`, [h,w]."""
        return _loaded(self.folder / f"{i}.depth.npy")

    def exposure_scale(self) -> float:
        """One exposure for the set, once all its views are in."""
        white = RunningQuantile(BELOW_WHITE, len(self.rig) * self.rig.height * self.rig.width)
        for i in range(len(self.rig)):
            white.add(self.light(i).max(-1))
        return exposure_scale(white.value())


def _loaded(path: Path) -> NDArray[np.float32]:
    with opened(path) as file:
        return np.asarray(np.load(file, allow_pickle=False))


def _save(path: Path, values: NDArray[Any]) -> None:
    """As np.save, which does not say that the disk is full."""
    content = io.BytesIO()
    np.save(content, values)
    with atomic(path) as temporary:
        temporary.write_bytes(content.getbuffer())


@contextmanager
def view_store(out: Path, rig: Rig, camera: str | None) -> Iterator[ViewStore]:
    """A store in the set folder `out`, removed afterwards, with anything that a killed process left there."""
    folder = out / SCRATCH
    remove(folder)
    folder.mkdir(parents=True)
    try:
        yield ViewStore(folder, rig, camera)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _remove_stale(out: Path, names: list[str]) -> None:
    """Remove files that another set in this folder has left: pictures of more views, and its other layouts."""
    for folder in (DEPTHS, *EXPORTS):
        remove(out / folder)
    for picture in (out / "images").glob("*.png"):
        if picture.stem not in names:
            remove(picture)


def finish_set(out: Path, names: list[str], rig: Rig, seed: int, views: ViewStore, scene: str) -> dict[str, Any]:
    """Write the files that depend on all views together, and their depth; returns the entries of set.json about
    them.
    """
    scale = views.exposure_scale()

    def image(i: int) -> NDArray[np.uint8]:
        return to_srgb8(views.light(i) * np.float32(scale))

    _remove_stale(out, names)
    lost = DepthLoss()

    def put_depth(name: str, z: NDArray[np.float32]) -> None:
        lost.add(z)
        write_depth(out / DEPTHS / f"{name}.png", z)

    for i, name in enumerate(names):
        put_depth(name, views.depth(i))
        write_png(out / "images" / f"{name}.png", image(i))
    if said := lost.said():
        warnings.warn(said, stacklevel=2)
    xyz, rgb, visible = surface_points(rig, views.depth, image, seed=seed)
    points = SparsePoints.seen(rig, xyz, rgb, visible, exact=True)
    write_cameras(out, names, rig, points=points, depth_dir=DEPTHS, scene=scene)
    if views.color is None:
        return {"exposure_scale": scale}
    matrix = {"camera_matrix": views.color.matrix.tolist(), "camera_matrix_error": views.color.matrix_error}
    return {"exposure_scale": scale, **matrix}
