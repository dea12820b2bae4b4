"""Files of a capture folder of kind "imported" besides its pictures: photographs of somebody else's camera.

lit/NNNN.png          the same views in good light, 8-bit sRGB, if they were given
truth/NNNN.exr        clean.R, clean.G, clean.B: clean long exposures in linear light, brought to the light of the
                      dark pictures (0 = black, 1 = white), if they were given
depth/NNNN.exr        Z: measured z-depth at the pixel centres, in the unit of the cameras; 0: not known
scan.ply              measured points of the scene in the frame of the cameras, in metres, some centimetres apart
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture_record import CaptureRecord
from novags.testbed.folders.set import Source
from sensor_model.files.records import Reads
from simscenes.sets.multiview import MultiviewSet, load_set
from simscenes.sets.pictures.exr import read_exr, write_exr

SCAN = "scan.ply"
CHANNELS = tuple(f"clean.{colour}" for colour in "RGB")


def write_clean(folder: Path, name: str, light: np.ndarray) -> None:
    """Write the noise-free exposure of a view, linear float32 [h,w,3]."""
    (folder / "truth").mkdir(exist_ok=True)
    planes = {channel: np.ascontiguousarray(light[..., c]) for c, channel in enumerate(CHANNELS)}
    write_exr(folder / "truth" / f"{name}.exr", planes)


def read_clean(path: Path) -> np.ndarray:
    """The file of `write_clean`.

    Raises:
        ValueError: If the file cannot be read or is something else.
    """
    channels, _ = read_exr(path)
    if missing := [name for name in CHANNELS if name not in channels]:
        raise ValueError(f"{path} lacks the channels {', '.join(missing)}: import again")
    return np.stack([channels[name] for name in CHANNELS], axis=-1).astype(np.float32)


def write_depth(folder: Path, name: str, depth: np.ndarray) -> None:
    """Write the measured depth of a view, float32 [h,w]."""
    (folder / "depth").mkdir(exist_ok=True)
    write_exr(folder / "depth" / f"{name}.exr", {"Z": np.ascontiguousarray(depth, np.float32)})


def read_depth(path: Path) -> np.ndarray:
    """The file of `write_depth`.

    Raises:
        ValueError: If the file cannot be read or is something else.
    """
    channels, _ = read_exr(path)
    if "Z" not in channels:
        raise ValueError(f"{path} lacks the channel Z: import again")
    return channels["Z"].astype(np.float32)


def cameras_of(folder: Path, record: CaptureRecord) -> MultiviewSet:
    """The cameras of a capture, imported or not, with the views that have no dark picture."""
    cameras, alone = load_set(folder), () if record.imported is None else record.imported.lit_alone
    return replace(cameras, lit_alone=tuple(i for i, name in enumerate(cameras.names) if name in alone))


def views_of(cameras: MultiviewSet, record: CaptureRecord, console: Console, reads: Reads) -> Source:
    """The set that the photographs of a capture form: their lit twins where there are any, with measured depth."""
    told, folder, names = record.imported, cameras.path, list(enumerate(cameras.names))
    assert told is not None
    lit = frozenset(i for i, name in names if "lit" in told.parts and name not in told.unlit)
    files = tuple(folder / ("lit" if i in lit else "images") / f"{name}.png" for i, name in names)
    scanned = {i: folder / "depth" / f"{name}.exr" for i, name in names
               if "depth" in told.parts and name not in told.unscanned}  # fmt: skip
    views = replace(cameras, files=files, meta={"scene": record.scene}, kind="photographs")
    scan = folder / SCAN if "scan" in told.parts else None
    return Source(views=views, rig=cameras.rig, console=console, reads=reads, lit_views=lit, scanned=scanned, scan=scan)


MISSING = {  # of `capture_record.PARTS`: why a score or a method has nothing to go by, and a remedy
    "truth": "no noise-free exposure is known of these photographs: novags import takes --clean FOLDER (long exposures "
    "of the same views)",
    "lit": "nothing shows these views in good light: novags import takes --lit FOLDER (pictures of the same views)",
    "images16": "there are no 16-bit linear pictures: novags import takes 16-bit or raw files",
    "raw": "there are no raw frames: novags import takes raw files of undistorted pictures in their own size",
}
