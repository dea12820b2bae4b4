"""A COLMAP model whose cameras few points hold together is doubted when its folder is opened, not after the fit."""

import contextlib
import io
import shutil
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.set import for_photographs, open_source, source_of
from novags.testbed.stages.capturing import look_and_meter
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.configs.posing import PosesConfig
from sensor_model import PRESETS, Exposure, write_dng
from simscenes import orbit_rig
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.multiview import load_set
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.lens import DistortedPinhole
from simscenes.sets.writers.camera_files import write_cameras
from tests.miniatures import HEIGHT, RIG, VIEWS, WIDTH, lit_picture

CAMERA = PRESETS["imx900-hcg"]
NAMES_OF_RAW = ("0", "1", "2")


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


def test_cameras_of_raw_files_are_doubted_as_those_of_pictures_are(tmp_path: Path) -> None:
    stream = io.StringIO()
    write_cameras(tmp_path, NAMES_OF_RAW, orbit_rig(3, 64, 48, 50.0, radius=3.0))
    content = (tmp_path / "transforms.json").read_text()
    for name in NAMES_OF_RAW:
        codes = np.random.default_rng(0).integers(200, 900, (48, 64)).astype(np.uint16)
        write_dng(tmp_path / "raw" / f"{name}.dng", codes, CAMERA, Exposure(time=0.01))
        content = content.replace(f"images/{name}.png", f"raw/{name}.dng")
    (tmp_path / "transforms.json").write_text(content)
    (tmp_path / "nb-info.json").unlink(missing_ok=True)
    open_source(tmp_path, Console(stream=stream))
    assert "only 3 photographs have a camera" in stream.getvalue()
    assert "3.dng" not in stream.getvalue()
    assert "2 of 3 photographs are copies of another one (1.dng and 0.dng, 2.dng and 0.dng)" in stream.getvalue()


@pytest.mark.parametrize("command", ["capture", "import", "poses"])
def test_other_primaries_are_said_of_whichever_picture_states_them(command: str, tmp_path: Path) -> None:
    """Poses leave pictures that state nothing, so that nobody could say it later."""
    stream, folder = io.StringIO(), model(tmp_path / "set", None)
    last = sorted((folder / "images").iterdir())[-1]
    content, p3 = last.read_bytes(), b"cICP" + bytes([12, 13, 0, 1])
    cut = content.index(b"IDAT") - 4
    last.write_bytes(content[:cut] + struct.pack(">I", 4) + p3 + struct.pack(">I", zlib.crc32(p3)) + content[cut:])
    console = Console(stream=stream)
    with contextlib.suppress(ValueError):  # such small pictures find no place
        if command == "capture":
            stages.capture(folder, tmp_path / "out", CaptureConfig(sensor="ideal", electrons=100.0), console)
        elif command == "import":
            stages.import_photographs(folder, tmp_path / "out", ImportConfig(), console)
        else:
            stages.poses(tmp_path / "out", PosesConfig(photographs=folder / "images"), console)
    assert "state colours of other primaries than those of sRGB (Display P3, say)" in stream.getvalue()


@pytest.mark.parametrize(("share", "said"), [(1.0, False), (0.02, True)])
def test_photographs_that_are_dark_already_are_said_before_they_are_made_dark(
    share: float, said: bool, tmp_path: Path
) -> None:
    stream, folder = io.StringIO(), model(tmp_path / "set", None)
    for i in range(VIEWS):
        light = (lit_picture(i).astype(np.float32) * share + 200 * share).clip(0, 255).astype(np.uint8)
        write_png(folder / "images" / f"{i:02d}.png", light)
    look_and_meter(open_source(folder, Console(quiet=True)), CaptureConfig(), Console(stream=stream))
    assert (f"{folder}: pictures are dark already" in stream.getvalue()) is said


@pytest.mark.parametrize(("floor", "black", "said"), [(0, 0.0, False), (512, 0.0, True), (512, 512.0, False)])
def test_a_black_level_that_nobody_states_is_said(floor: int, black: float, said: bool, tmp_path: Path) -> None:
    """Rationale: 16-bit files with a camera's pedestal count as light from code 0 on, and look foggy."""
    stream, folder = io.StringIO(), model(tmp_path / "set", None)
    rng = np.random.default_rng(0)
    for i in range(VIEWS):
        light = rng.poisson(rng.gamma(1.0, 20.0, (HEIGHT, WIDTH, 3)))
        write_png(folder / "images" / f"{i:02d}.png", (floor + 8 * light).astype(np.uint16))
    config = ImportConfig(black=black, white=8000.0)
    stages.import_photographs(folder, tmp_path / "out", config, Console(stream=stream))
    assert ("probably the camera's black level is in them" in stream.getvalue()) is said


def test_masks_among_posed_pictures_are_said_by_name(tmp_path: Path) -> None:
    stream, folder = io.StringIO(), model(tmp_path / "set", None)
    mask = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    mask[: HEIGHT // 3] = 255
    for name in ("00", "02"):
        write_png(folder / "images" / f"{name}.png", mask)
    stages.import_photographs(folder, tmp_path / "out", ImportConfig(), Console(stream=stream))
    assert (
        f"2 of {VIEWS} pictures look like masks, black and white or of a few flat colours: 00, 02;" in stream.getvalue()
    )
    assert str(folder) in stream.getvalue()


def test_pictures_developed_from_raw_files_are_held_against_their_cameras(tmp_path: Path) -> None:
    """A painted ground seen from above, as raw mosaics; then the files of two neighbours change places, all along."""
    count, (width, height) = 8, (240, 180)
    rig = orbit_rig(count, width, height, 45.0, radius=3.0, elevation_deg=55.0, sweep_deg=90.0)
    rng, paint = np.random.default_rng(0), np.zeros((800, 800))
    for cells in (16, 40, 90):
        paint += cv2.resize(rng.random((cells, cells)), (800, 800), interpolation=cv2.INTER_CUBIC)
    ground = (60 + 800 * (paint - paint.min()) / np.ptp(paint)).astype(np.float32)
    place = np.array([[5 / 800, 0, -2.5], [0, 5 / 800, -2.5], [0, 0, 1]])  # of a texel on the ground, z = 0
    names = [f"{i}" for i in range(count)]
    for folder, order in (("right", range(count)), ("shifted", np.roll(range(count), 2))):
        write_cameras(tmp_path / folder, names, rig)
        (tmp_path / folder / "nb-info.json").unlink()
        record = tmp_path / folder / "transforms.json"
        record.write_text(record.read_text().replace("images/", "raw/").replace(".png", ".dng"))
        for name, i in zip(names, order, strict=True):
            view = rig.Ks[i] @ np.asarray(rig.viewmats[i])[:3, [0, 1, 3]] @ place
            codes = cv2.warpPerspective(ground, view, (width, height), flags=cv2.INTER_AREA).astype(np.uint16) + 200
            write_dng(tmp_path / folder / "raw" / f"{name}.dng", codes, CAMERA, Exposure(time=0.01))
        stream = io.StringIO()
        stages.import_photographs(tmp_path / folder, tmp_path / f"{folder}-out", ImportConfig(), Console(stream=stream))
        assert ("do not show what their cameras say" in stream.getvalue()) == (folder == "shifted"), stream.getvalue()


def test_the_lens_of_every_view_is_looked_at(tmp_path: Path) -> None:
    """The last two of nine lenses are squeezed; pictures without distortion hide that from the cameras of the set."""
    stream = io.StringIO()
    views = load_set(model(tmp_path / "set", None))
    squeezed = RIG.Ks[0] * [[2.0], [1.0], [1.0]]
    of = [RIG.Ks[0]] * (VIEWS - 2) + [squeezed] * 2
    lenses = [DistortedPinhole(K=K, distortion=(0.0,) * 5) for K in of]
    source_of(replace(views, lenses=tuple(lenses)), Console(stream=stream))
    assert f"2 of {VIEWS} cameras have another focal length along x than along y" in stream.getvalue()


def test_results_of_photographs_depend_on_their_readers_and_on_what_looks_at_them() -> None:
    assert {"novags.cameras.matching", "simscenes.sets.readers.llff"} <= set(for_photographs())
