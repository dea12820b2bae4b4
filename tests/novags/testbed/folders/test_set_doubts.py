"""A COLMAP model whose cameras few points hold together is doubted when its folder is opened, not after the fit."""

import io
import shutil
from pathlib import Path

import numpy as np
import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.folders.set import open_source
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.pictures.png import write_png
from simscenes.sets.writers.camera_files import write_cameras
from tests.miniatures import HEIGHT, RIG, VIEWS, WIDTH, lit_picture


def model(folder: Path, points: SparsePoints | None) -> Path:
    """Photographs with a COLMAP model of these points."""
    names = [f"{i:02d}" for i in range(VIEWS)]
    write_cameras(folder, names, RIG, points=points)
    (folder / "transforms.json").unlink()
    shutil.rmtree(folder / "images", ignore_errors=True)
    for i, name in enumerate(names):
        write_png(folder / "images" / f"{name}.png", lit_picture(i))
    return folder


def scattered(count: int, seen: float) -> SparsePoints:
    """Points near the middle of the scene, each seen by this share of the views."""
    rng = np.random.default_rng(0)
    xyz = rng.uniform(-0.2, 0.2, (count, 3))
    visible = rng.random((VIEWS, count)) < seen
    return SparsePoints.seen(RIG, xyz, np.full((count, 3), 128, np.uint8), visible, exact=True)


@pytest.mark.parametrize(
    ("points", "doubted"),
    [
        (scattered(300, 0.9), False), (scattered(60, 0.9), True), (scattered(300, 0.05), True), (None, False),
        (SparsePoints.untracked(np.eye(3) / 10, np.full((3, 3), 0.5)), False),
    ],
    ids=["many", "few in all", "few in a photograph", "none", "without tracks"],
)  # fmt: skip
def test_few_points_are_said_where_cameras_came_from_them(
    points: SparsePoints | None, doubted: bool, tmp_path: Path
) -> None:
    stream = io.StringIO()
    assert min(WIDTH, HEIGHT) > 11
    source = open_source(model(tmp_path / "set", points), Console(stream=stream))
    assert source.views.model() is not None
    assert ("few points hold the cameras together" in stream.getvalue()) == doubted
