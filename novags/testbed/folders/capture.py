"""A capture on disk: one dark exposure per view, in every form its readers need, with the ground truth.

capture.json          sensor, exposure, how views differ, plan, seeds, the set it was made from; written last
raw/NNNN.dng          the sensor's digital numbers
images16/NNNN.png     linear RGB, 16-bit            images/NNNN.png    sRGB, 8-bit
truth/NNNN.exr        digital numbers: analytic mean and variance, noise-free (clean), saturation; behind a colour
                      filter array also what three chips would give without noise (clean_rgb.R, .G, .B)
transforms.json ...   the cameras, as in a multiview set

A capture that was imported (`folders.imported`) has only the files that its photographs provide.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from novags.methods.inputs import LacksInput, Pictures
from novags.methods.memo import Memo
from novags.methods.noise import Noise, camera_noise
from novags.methods.noise_estimate import PIXELS, SMALLEST
from novags.methods.problem import RawPictures, encode
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture_record import CaptureRecord, Imported, read_capture_record
from novags.testbed.folders.exchanged import REMEDIES, refuse_exchanged
from novags.testbed.folders.imported import MISSING, SCAN, cameras_of, read_clean, views_of
from novags.testbed.folders.photographs.raw_files import read_digital_numbers
from novags.testbed.folders.place import place_of
from novags.testbed.folders.set import PHOTOGRAPHS, Source, open_source
from novags.testbed.ledger.contents import folder_digest, refuse_damage
from sensor_model.files.dng import write_dng
from sensor_model.files.door import enter, resolved
from sensor_model.files.records import Reads, read_once
from sensor_model.frame import own
from sensor_model.isp import Demosaic, develop, develop_linear, from_linear16, srgb_to_linear, white_balance
from sensor_model.params import Cfa, Sensor
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.pictures.exr import read_exr, write_exr
from simscenes.sets.pictures.png import read_codes, read_png, write_png
from simscenes.sets.writers.camera_files import CAMERA_FILES

if TYPE_CHECKING:
    from sensor_model.capture import RawFrame

RECORD = "capture.json"
OWNS = (RECORD, "raw", "images16", "images", "truth", "lit", "depth", SCAN, *CAMERA_FILES)


def has_view(folder: Path, name: str, last: str = "images") -> bool:
    """Whether the view is complete: its 8-bit image is written last, and every file appears whole or not at all."""
    return (folder / last / f"{name}.png").exists()


def write_view(
    folder: Path, name: str, frame: "RawFrame", sensor: Sensor, demosaic: Demosaic, color_matrix: np.ndarray | None,
    jpeg_quality: int | None = None, *, clean_rgb: np.ndarray | None = None, seen_by: Sensor | None = None,
) -> None:  # fmt: skip
    """Write everything about one exposure.

    Args:
        folder: Of the capture.
        name: Of the view.
        frame: The exposure.
        sensor: The camera.
        demosaic: As for `develop`, like the next two.
        color_matrix: From the camera's colours to linear sRGB.
        jpeg_quality: Of the 8-bit picture.
        clean_rgb: Of a frame behind a colour filter array: the signal of all three channels of each pixel without
            noise, [h,w,3], DN.
        seen_by: The camera as white balance takes it; None: as it is.
    """
    for part in ("raw", "truth"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    write_dng(folder / "raw" / f"{name}.dng", frame.dn, sensor, frame.exposure, color_matrix=color_matrix)
    truth = {
        **_planes("mean", frame.mean_dn),
        **_planes("variance", frame.variance_dn),
        **_planes("clean", frame.clean_dn),
        **({} if clean_rgb is None else _planes("clean_rgb", clean_rgb)),
        **_planes("saturated", frame.saturated.astype(np.uint32)),
    }
    write_exr(folder / "truth" / f"{name}.exr", truth)
    taken = seen_by or sensor
    developed = develop(frame, taken, demosaic=demosaic, color_matrix=color_matrix, jpeg_quality=jpeg_quality)
    write_png(folder / "images16" / f"{name}.png", developed.linear16)
    write_png(folder / "images" / f"{name}.png", developed.srgb8)


def _planes(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Channels of a mosaic ([h,w]: `name`) or of a three-chip frame ([h,w,3]: `name.R`, `name.G`, `name.B`)."""
    if values.ndim == 2:
        return {name: values}
    return {f"{name}.{colour}": values[..., c] for c, colour in enumerate("RGB")}


@dataclass(frozen=True)
class Capture:
    """A complete capture folder, read view by view."""

    path: Path
    record: CaptureRecord
    cameras: MultiviewSet
    content: str  # hash of all that the capture stage wrote, from when this was opened
    reads: Reads = field(default_factory=dict, repr=False, compare=False)  # its JSON files, as opened
    memo: Memo = field(default_factory=Memo, repr=False, compare=False)  # values read and computed from it so far
    held: tuple[int, ...] = ()  # training views that nothing is trained on here: among the held-out ones

    @property
    def names(self) -> tuple[str, ...]:
        """File stems in sorted order."""
        return self.cameras.names

    @property
    def sensor(self) -> Sensor | None:
        """The camera; None: of imported photographs, not known."""
        return self.record.sensor

    @property
    def modules(self) -> tuple[str, ...]:
        """Results made from it depend on these modules, of its camera's effects from outside."""
        return own.modules(self.sensor)

    @property
    def imported(self) -> Imported | None:
        """Facts about photographs from elsewhere; None: for simulated exposures."""
        return self.record.imported

    def digest(self) -> str:
        """Present hash of all that the capture stage wrote."""
        return folder_digest(self.path, OWNS)

    def holds(self, part: str) -> bool:
        """Whether it has "images16", "raw", "truth" (the noise-free exposure) or, in the folder itself, "lit"."""
        return part in self.imported.parts if self.imported else part != "lit"

    def _need(self, part: str) -> None:
        if not self.holds(part):
            raise LacksInput(f"{self.path}: {MISSING[part]}")

    def is_dark(self, i: int) -> bool:
        """Whether there is a dark picture of view `i`: a data set may show held-out views in good light only."""
        return i not in self.cameras.lit_alone

    def srgb8(self, i: int) -> np.ndarray:
        """The 8-bit picture, sRGB-encoded float32 [h,w,3] in 0..1; evened (`Uneven.even`)."""
        even = self.record.uneven.even_srgb
        return self.memo.once(("srgb8", i), lambda: even(self._read(read_png, "images", i, ".png"), i))

    def linear16(self, i: int) -> np.ndarray:
        """The 16-bit picture, linear float32 [h,w,3], 0 = black, 1 = white; noise around black stays below 0; evened.

        Raises:
            LacksInput: If the capture has no 16-bit pictures.
        """
        self._need("images16")
        even = self.record.uneven.even
        return self.memo.once(("linear16", i), lambda: even(self._read(_light, "images16", i, ".png"), i))

    def raw(self, i: int) -> np.ndarray:
        """Digital numbers of the sensor as taken, uint16 [h,w], or [h,w,3] of three chips.

        Raises:
            LacksInput: If the capture has no raw frames.
        """
        self._need("raw")
        return self._read(read_digital_numbers, "raw", i, ".dng")

    def even_raw(self, i: int) -> np.ndarray:
        """`raw` in the exposure that is common to all views."""
        return self.record.uneven.even_raw(self.raw(i), i, *self.levels[1:])

    def dark(self, i: int, pictures: Pictures) -> np.ndarray:
        """The dark exposure, sRGB-encoded float32 [h,w,3] in 0..1: the 8-bit picture, or the linear one encoded."""
        return self.srgb8(i) if pictures == "8bit" else encode(self.linear16(i))

    def linear(self, i: int) -> np.ndarray:
        """The dark exposure in linear light, float32 [h,w,3]: the 16-bit picture, else the 8-bit one decoded."""
        return self.linear16(i) if self.holds("images16") else np.asarray(srgb_to_linear(self.srgb8(i)))

    def clean(self, i: int, *, demosaiced: bool = False) -> np.ndarray:
        """The same exposure without noise, fixed pattern or rounding, developed alike; sRGB-encoded float32 [h,w,3].

        `demosaiced`: as for `clean_linear`.
        """
        return encode(self.clean_linear(i, demosaiced=demosaiced))

    def clean_linear(self, i: int, *, demosaiced: bool = False) -> np.ndarray:
        """The noise-free exposure in linear light, float32 [h,w,3], in the unit of `linear16`.

        Of a camera with a colour filter array: the signal of all three channels of each pixel. Of imported
        photographs: the clean long exposure, brought to the light of the dark ones by one factor.

        Args:
            i: The view.
            demosaiced: Of a camera with a colour filter array: the noise-free mosaic, interpolated as the pictures are,
                with the errors of interpolation. Ignored for other cameras and photographs.

        Raises:
            LacksInput: If it is not known.
            ValueError: If its file is missing, damaged or of an earlier version.
        """
        self._need("truth")
        demosaiced = demosaiced and self.demosaiced
        return self.memo.once(("clean linear", i, demosaiced), lambda: self._developed_clean(i, demosaiced))

    @property
    def demosaiced(self) -> bool:
        """Whether its pictures are interpolated from mosaics whose three noise-free channels are known."""
        return self.sensor is not None and self.sensor.cfa is not None and not self.imported

    def _developed_clean(self, i: int, demosaiced: bool) -> np.ndarray:
        if self.imported:
            return self._read(read_clean, "truth", i, ".exr")
        assert self.sensor is not None
        matrix = self.record.color_matrix
        if demosaiced:
            dn = self.truth(i, "clean")
            return develop_linear(dn, self.sensor, demosaic=self.record.demosaic, color_matrix=matrix)
        kind = "clean" if self.sensor.cfa is None else "clean_rgb"
        dn = self._read(lambda path: _channels_of(path, kind), "truth", i, ".exr")
        return develop_linear(dn, replace(self.sensor, cfa=None), color_matrix=matrix)

    def truth(self, i: int, kind: str) -> np.ndarray:
        """Known values of each pixel of a simulated exposure, float32 [h,w], or [h,w,3] of three chips.

        Args:
            i: The view.
            kind: "mean" over all exposures like it, DN; their temporal "variance", DN²; "clean": without noise, DN, of
                a mosaic the channel that each pixel measures.

        Raises:
            LacksInput: If the capture was imported.
        """
        if self.imported:
            raise LacksInput(f"{self.path}: the {kind} of its raw frames is known of simulated exposures only")
        return self._read(lambda path: _truth_dn(path, kind), "truth", i, ".exr")

    def _read(self, read: Callable[[Path], np.ndarray], kind: str, i: int, suffix: str) -> np.ndarray:
        """A file of view `i`, as large as its camera says."""
        if not self.is_dark(i):
            raise LacksInput(f"{self.path}: view {self.names[i]} is known in good light only: it has no dark picture")
        path = self.path / kind / f"{self.names[i]}{suffix}"
        refuse_damage(self.path, self.record.stage, REMEDIES[RECORD], [f"{kind}/{path.name}"])
        found, rig = read(path), self.cameras.rig
        if found.shape[:2] != (rig.height, rig.width):
            height, width = found.shape[:2]
            raise ValueError(f"{path} must be {rig.width} x {rig.height} px, got {width} x {height}: capture again")
        return found

    @property
    def channels_share(self) -> tuple[str, ...]:
        """Why the noise of a pixel's three channels is not independent; empty where it is."""
        levels = self.imported and self.imported.levels
        cfa = self.sensor.cfa if self.sensor else levels[0] if levels else "unknown"
        reasons = {
            "demosaicing": cfa is not None,
            "a colour matrix": self.record.color_matrix is not None,
            "JPEG": self.record.jpeg,
        }
        return tuple(reason for reason, holds in reasons.items() if holds)

    @property
    def pixels_share(self) -> tuple[str, ...]:
        """Why the noise of neighbouring pixels is not independent, where the channels' noise may be."""
        return () if self.record.resampled is None else ("resampling",)

    @property
    def levels(self) -> tuple[Cfa | None, float, float]:
        """Colour filter array of the raw frames (None: three chips), DN without light, DN of saturation."""
        if self.imported:
            assert self.imported.levels is not None
            return self.imported.levels
        assert self.sensor is not None
        return self.sensor.cfa, float(self.sensor.black_level), self.sensor.white_dn

    @property
    def color(self) -> tuple[tuple[float, float, float] | None, tuple[tuple[float, ...], ...] | None]:
        """From raw frames to linear pictures: white balance (None if unknown) and colour matrix (None: identity)."""
        if self.sensor is None:
            return None, None
        red, green, blue = white_balance(self.sensor).tolist()
        matrix = self.record.color_matrix
        return (red, green, blue), None if matrix is None else tuple(tuple(map(float, row)) for row in matrix)

    @property
    def noise(self) -> Noise | None:
        """The noise of the camera in the common exposure, or an estimate from the training pictures (`Noise.origin`).

        They do where the camera is not known, or pixels were averaged after the exposure; None if they are too small.
        """
        if self.sensor is None or self.pixels_share:
            return self.memo.once("noise from pictures", self._noise_from_pictures)
        used, matrix = self.record, self.record.color_matrix
        return camera_noise(self.sensor, used.exposure, demosaic=used.demosaic, color_matrix=matrix, frames=used.burst)

    def noise_at(self, i: int) -> Noise | None:
        """The noise of the evened pictures of view `i`."""
        return self.noise and self.noise.at(self.record.uneven.times(i))

    def _noise_from_pictures(self) -> Noise | None:
        rig, indices = self.cameras.rig, self.cameras.train_indices
        if min(rig.width, rig.height) < SMALLEST:
            return None
        count = max(1, min(len(indices), PIXELS // (rig.width * rig.height)))
        chosen = [indices[k] for k in np.linspace(0, len(indices) - 1, count).round().astype(int)]

        def stack(read: Callable[[int], np.ndarray]) -> Tensor:
            return torch.from_numpy(np.stack([read(i) for i in chosen]).astype(np.float32))

        raw = None
        if self.holds("raw"):
            cfa, black, white = self.levels
            raw = RawPictures(dn=stack(self.raw), cfa=cfa, black=black, white=white)
        linear16 = stack(self.linear16) if self.holds("images16") else None
        mixed = "a colour matrix" in self.channels_share
        found: Noise | None = PHOTOGRAPHS["noise"](stack(self.srgb8), linear16, raw, mixed=mixed)
        return found

    def source(self, console: Console) -> Source:
        """The set this capture was made from; of imported photographs, the set that they themselves and their lit twins
        form.

        Raises:
            ValueError: If the set has moved or changed.
        """
        if (made_of := self.record.simulated) is None:
            return views_of(self.cameras, self.record, console, self.reads)
        if self.set_path is None:
            raise ValueError(f"{self.path} was made from the set {made_of.set_path} (relative to it), which is not "
                             "there: put it back or capture again")  # fmt: skip
        source = open_source(self.set_path, console, made_of.max_size)
        if source.content != made_of.set_content:
            raise ValueError(f"{self.set_path} has changed since {self.path} was made from it: put it back or capture "
                             "again")  # fmt: skip
        return source

    @property
    def set_path(self) -> Path | None:
        """Where the set lies that it was made from; None of imported photographs, and where it is gone."""
        if (made_of := self.record.simulated) is None:
            return None
        path = place_of(self.path, made_of.set_path)
        return path if path.is_dir() else None


def _light(path: Path) -> np.ndarray:
    return from_linear16(read_codes(path))


def _truth_dn(path: Path, kind: str) -> np.ndarray:
    channels, _ = read_exr(path)
    return channels[kind] if kind in channels else _channels_of(path, kind, channels)


def _channels_of(path: Path, kind: str, channels: dict[str, np.ndarray] | None = None) -> np.ndarray:
    """Three channels [h,w,3] of a truth file, of all the channels in it."""
    found = read_exr(path)[0] if channels is None else channels
    if missing := [name for colour in "RGB" if (name := f"{kind}.{colour}") not in found]:
        raise ValueError(f"{path} lacks the channels {', '.join(missing)}: capture again")
    return np.stack([found[f"{kind}.{colour}"] for colour in "RGB"], axis=-1)


_OPENED: dict[Path, Capture] = {}  # the last one: stages of one experiment open the same capture again and again


def open_capture(path: Path) -> Capture:
    """Open a capture folder; an unchanged one that is already open is shared, with everything read from it.

    Raises:
        ValueError: If the folder is missing, is not a capture, is unfinished, or is damaged.
    """
    _enter(path)
    place = resolved(path)
    with read_once({}) as reads:
        record = read_capture_record(path / RECORD)
        known = _OPENED.get(place)
        # Digests leave out a record's entries on costs and inputs: it has to be the same to the byte.
        if known is not None and known.reads.items() >= reads.items() and known.digest() == known.content:
            return known
        content = folder_digest(path, OWNS)
        refuse_exchanged(path)
        capture = Capture(path=path, record=record, cameras=cameras_of(path, record), content=content, reads=reads)
    _OPENED.clear()
    _OPENED[place] = capture
    return capture


def _enter(path: Path) -> None:
    """Take a folder as given that holds a finished capture."""
    if not path.is_dir():
        raise ValueError(f"no such capture folder: {path}")
    enter(path)
    if not (path / RECORD).exists():
        raise ValueError(f"{path} holds no {RECORD}: it is not a capture, or an unfinished one (run novags capture "
                         "again)")  # fmt: skip
