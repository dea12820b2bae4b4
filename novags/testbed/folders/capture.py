"""A capture on disk: one dark exposure per view, in every form its readers want, beside the truth about it.

capture.json          sensor, exposure, plan, seeds, the set it was made of; written last
raw/NNNN.dng          the sensor's digital numbers
images16/NNNN.png     linear RGB, 16-bit            images/NNNN.png    sRGB, 8-bit
truth/NNNN.exr        digital numbers: analytic mean and variance, noise-free (clean), saturation
transforms.json ...   the cameras, as in a multiview set
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from novags.testbed.cache import folder_digest, read_json
from novags.testbed.console import Console
from novags.testbed.folders.png import read_codes, read_png, write_png
from novags.testbed.folders.set import Source, open_source
from sensor_model import (
    Exposure,
    RawFrame,
    Sensor,
    develop,
    develop_linear,
    from_linear16,
    linear_to_srgb,
    sensor_from_dict,
    write_dng,
)
from sensor_model.isp import Demosaic
from simscenes.sets.camera_files import CAMERA_FILES
from simscenes.sets.exr import read_exr, write_exr
from simscenes.sets.multiview import MultiviewSet, load_set

RECORD = "capture.json"
OWNS = (RECORD, "raw", "images16", "images", "truth", *CAMERA_FILES)
DarkSource = Literal["8bit", "16bit"]


def has_view(folder: Path, name: str) -> bool:
    """Whether the view is complete: its 8-bit image is written last, and every file appears whole or not at all."""
    return (folder / "images" / f"{name}.png").exists()


def write_view(
    folder: Path,
    name: str,
    frame: RawFrame,
    sensor: Sensor,
    exposure: Exposure,
    demosaic: Demosaic,
    color_matrix: np.ndarray | None,
    jpeg_quality: int | None = None,
) -> None:
    """Write everything about one exposure. `color_matrix`: as for `develop`."""
    for part in ("raw", "truth"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    write_dng(folder / "raw" / f"{name}.dng", frame.dn, sensor, exposure, color_matrix=color_matrix)
    truth = {
        **_planes("mean", frame.mean_dn),
        **_planes("variance", frame.variance_dn),
        **_planes("clean", frame.clean_dn),
        **_planes("saturated", frame.saturated.astype(np.uint32)),
    }
    write_exr(folder / "truth" / f"{name}.exr", truth)
    developed = develop(frame, sensor, demosaic=demosaic, color_matrix=color_matrix, jpeg_quality=jpeg_quality)
    write_png(folder / "images16" / f"{name}.png", developed.linear16)
    write_png(folder / "images" / f"{name}.png", developed.srgb8)


def _planes(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Channels of a mosaic ([h,w]: `name`) or of a three-chip frame ([h,w,3]: `name.R`, `name.G`, `name.B`)."""
    if values.ndim == 2:
        return {name: values}
    return {f"{name}.{colour}": values[..., c] for c, colour in enumerate("RGB")}


def encode(linear: np.ndarray) -> np.ndarray:
    """Linear -> sRGB code, clipped to 0..1 like every developed picture (demosaicing overshoots, noise undershoots)."""
    return linear_to_srgb(np.clip(linear, 0.0, 1.0)).astype(np.float32)


@dataclass(frozen=True)
class Capture:
    """A complete capture folder, read view by view."""

    path: Path
    record: dict[str, Any]
    cameras: MultiviewSet
    sensor: Sensor

    @property
    def names(self) -> tuple[str, ...]:
        """File stems in sorted order."""
        return self.cameras.names

    def dark(self, i: int, source: DarkSource = "8bit") -> np.ndarray:
        """The dark exposure, sRGB-encoded float32 [h,w,3] in 0..1: of the 8-bit image, or of the 16-bit linear one."""
        if source == "8bit":
            return read_png(self.path / "images" / f"{self.names[i]}.png")
        codes = read_codes(self.path / "images16" / f"{self.names[i]}.png")
        return encode(from_linear16(codes))

    def clean(self, i: int) -> np.ndarray:
        """The same exposure without noise, fixed pattern or rounding, developed alike; sRGB-encoded float32 [h,w,3]."""
        channels, _ = read_exr(self.path / "truth" / f"{self.names[i]}.exr")
        if "clean" in channels:
            dn = channels["clean"]
        else:
            dn = np.stack([channels[f"clean.{colour}"] for colour in "RGB"], axis=-1)
        matrix = self.record["color_matrix"]
        return encode(develop_linear(dn, self.sensor, demosaic=self.record["demosaic"], color_matrix=matrix))

    def digest(self) -> str:
        """Hash of all that the capture stage wrote."""
        return folder_digest(self.path, OWNS)

    def source(self, console: Console) -> Source:
        """The set this capture was made of.

        Raises:
            ValueError: If the set is no longer where it was, or no longer what it was.
        """
        made_of = self.record["set"]
        path = (self.path / made_of["path"]).resolve()
        if not path.is_dir():
            raise ValueError(
                f"{self.path} was made of the set {made_of['path']} (relative to it), which is not there: put it back "
                "or capture again"
            )
        source = open_source(path, console, made_of["max_size"])
        if source.digest() != self.record["stage"]["inputs"]["set"]:
            raise ValueError(f"{path} has changed since {self.path} was made of it: put it back or capture again")
        return source


def open_capture(path: Path) -> Capture:
    """Open a capture folder.

    Raises:
        ValueError: If the folder is missing, no capture, or an unfinished one.
    """
    if not path.is_dir():
        raise ValueError(f"no such capture folder: {path}")
    if not (path / RECORD).exists():
        raise ValueError(f"{path} holds no {RECORD}: it is no capture, or an unfinished one (run novags capture again)")
    record = read_json(path / RECORD)
    missing = [key for key in ("sensor", "set", "demosaic", "color_matrix", "stage") if key not in record]
    if missing:
        raise ValueError(f"{path / RECORD} lacks {', '.join(missing)}: capture again")
    return Capture(path=path, record=record, cameras=load_set(path), sensor=sensor_from_dict(record["sensor"]))
