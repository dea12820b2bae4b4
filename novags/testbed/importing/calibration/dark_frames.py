"""A folder of dark frames: what a camera shows without light, in place of noise from numbers.

FOLDER/*                      frames of one exposure
FOLDER/isoN/*                 or of several ISOs, as of `frames`: isoN/dark/NAME/* is found too
"""

from dataclasses import dataclass
from math import log2
from pathlib import Path

import numpy as np

from novags.testbed.console.terminal import Console
from novags.testbed.importing.calibration.codes import first_copy
from novags.testbed.importing.calibration.frames import CalibrationFrame, agreed, cut, iso_folders, listed, read_frame
from novags.testbed.importing.exposures import OF_FRAMES, check_iso, say_time
from novags.testbed.ledger.contents import folder_digest
from sensor_model.files.camera_file import CameraFile
from sensor_model.files.door import enter
from sensor_model.files.reading import reading, some
from sensor_model.frame.measured import DarkFrames
from sensor_model.params import CFAS, Sensor, require


@dataclass(frozen=True)
class DarkFolder:
    """The dark frames that a camera takes, not read yet."""

    place: Path
    files: tuple[Path, ...]
    iso: float | None  # None: the folder does not say
    gain: float | None  # at which they were taken, DN/e-, if it is not the camera's

    def digest(self) -> str:
        """Hash of the frames, and of the gain that is taken for theirs."""
        return folder_digest(self.place, (), beside={file.name: file for file in self.files}) + (
            "" if self.gain is None else f" at {self.gain!r} DN/e-"
        )

    def read(self, sensor: Sensor, size: tuple[int, int], time: float, console: Console) -> DarkFrames:
        """The middle of the frames, as large as pictures of this size.

        Raises:
            ValueError: If they are too few, too small, not alike, or not of this camera.
        """
        found = [_middle(path, sensor, size) for path in self.files]
        taken = agreed("exposure time", None, [frame.time for frame in found], self.place, np.nan)
        say_time(f"dark frames: {self.place} was", taken, time, console)
        with reading(self.place, "give --dark-frames of this camera"):
            codes = np.concatenate([frame.dn for frame in found])
            if (same := first_copy(codes)) is not None:
                raise ValueError(f"frames {same[0] + 1} and {same[1] + 1} are the same, and noise never is: remove "
                                 "the copies")  # fmt: skip
            return DarkFrames(codes=codes, sensor=sensor, gain=self.gain)


def _middle(path: Path, sensor: Sensor, size: tuple[int, int]) -> CalibrationFrame:
    """The middle of a file, which must be as its camera says."""
    frame = read_frame(path)
    height, width = frame.dn.shape[1:]
    if height < size[0] or width < size[1]:
        raise ValueError(f"{path} must hold {size[1]} x {size[0]} px or more, as the pictures do, got {width} x "
                         f"{height}: give whole frames, or take smaller pictures (--max-size)")  # fmt: skip
    if frame.bits not in (None, sensor.bits):
        raise ValueError(f"{path} must hold codes of {sensor.bits} bits, as the camera does, got {frame.bits}: "
                         "it is of another mode or camera")  # fmt: skip
    if frame.cfa in CFAS and sensor.cfa not in (None, frame.cfa):
        raise ValueError(f"{path} must have the filters of the camera, {sensor.cfa}, got {frame.cfa}")
    return cut(frame, size)


def find_dark_frames(folder: Path, camera: CameraFile) -> DarkFolder:
    """The frames of the camera's ISO, or of the nearest one at which its pixels have the same gain.

    Raises:
        ValueError: If there are none, or a file states another ISO.
    """
    if not folder.is_dir():
        raise ValueError(f"no such folder of dark frames: {folder}")
    enter(folder)
    isos = iso_folders(folder)
    if not isos:
        check_iso(files := listed(folder), OF_FRAMES, camera.iso, "the camera")
        return DarkFolder(folder, tuple(files), None, None)
    there = ", ".join(f"{iso:g}" for iso in isos)
    wanted = camera.iso
    if wanted is None:
        raise ValueError(f"{folder} holds dark frames of several ISOs ({there}), and the camera is of none: name the "
                         "folder of one, or a camera as FILE.toml@ISO")  # fmt: skip
    first, last = camera.fit.isos if camera.fit else (wanted, wanted)
    near = [iso for iso in isos if first <= iso <= last]
    if not near:
        raise ValueError(f"{folder} must hold dark frames of ISO {wanted:g}, or of one from {first:g} to {last:g}, "
                         f"where the gain of the pixels is the same, got {there}")  # fmt: skip
    iso = min(near, key=lambda one: abs(log2(one / wanted)))
    place = isos[iso] / "dark" if (isos[iso] / "dark").is_dir() else isos[iso]
    stacks = sorted(path for path in place.iterdir() if path.is_dir() and path.name[0] != ".")
    if len(stacks) > 1:
        raise ValueError(f"{place} holds several exposures ({some([s.name for s in stacks])}): name the folder of one")
    place = stacks[0] if stacks else place
    gain = None if iso == wanted or camera.fit is None else camera.fit.gain(iso)
    require(gain is None or gain > 0, "the gain of the line in the camera's file", "> 0 DN/e-", gain)
    check_iso(files := listed(place), OF_FRAMES, iso, "the name of the folder")
    return DarkFolder(place, tuple(files), iso, gain)
