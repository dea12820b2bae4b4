"""How picture files become the pictures of a capture: cut to their camera, undistorted, scaled down."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from novags.testbed.folders.photographs.linear import part_of, shrunk_by, within_margins
from novags.testbed.folders.photographs.raw_colors import RawColors
from novags.testbed.folders.photographs.raw_files import is_raw, place_of, read_digital_numbers, read_radiance, size
from novags.testbed.importing.raw_camera import RawCamera
from novags.testbed.importing.stored import Codes16, Depth, read_stored, refuse_transparent
from sensor_model.isp import to_srgb8
from sensor_model.params import Sensor
from simscenes.rigs import Rig
from simscenes.sets.multiview import MultiviewSet

SMALL = 24  # px, longest side of what is compared: noise of single pixels averages out


@dataclass(frozen=True, kw_only=True)
class Darkroom:
    """The steps that the dark pictures and their lit or clean twins go through alike.

    Attributes:
        views: The dark set: its cameras and lenses.
        rig: The cameras of the capture, scaled with the pictures.
        codes: The meaning of 16-bit codes.
        lit_codes: The same of well-lit twins.
        camera: Of raw files; None without any.
        lit_colors: Of all well-lit raw files; None without any.
    """

    views: MultiviewSet
    rig: Rig
    codes: Codes16
    lit_codes: Codes16
    camera: RawCamera | None
    lit_colors: RawColors | None

    @property
    def resampled(self) -> str | None:
        """Why pixels differ from the files, so that raw frames and noise of single pixels mean nothing."""
        if self.views.lenses is not None:
            return "the distortion of the lens was undone"
        return "the pictures were scaled down" if self._scaled else None

    @property
    def _scaled(self) -> bool:
        return (self.rig.width, self.rig.height) != (self.views.rig.width, self.views.rig.height)

    def check(self, file: Path, *, lit: bool = False) -> tuple[Depth, bool]:
        """The content of the file, and whether it has to be brought to the size of its view (well-lit pictures alone).

        Raises:
            ValueError: If it cannot be read, has another size than its camera or transparent pixels, or, not being
                `lit`, codes far above white, or of a raw file another camera than the first one.
        """
        if not is_raw(file):
            stored = read_stored(file)
            refuse_transparent(file)
            (self._level if lit else self._cut)(stored, file)
            if not lit:
                self.codes.refuse_above(stored, file)
            return "8bit" if stored.dtype == np.uint8 else "16bit", lit and self._pixel_off(stored)
        if lit or self.camera is None:
            width, height = size(file)
            self._cut(np.empty((height, width, 0)), file)
        else:
            self._cut(self.camera.codes(file), file)
        return "raw", False

    def linear(self, file: Path, i: int) -> np.ndarray:
        """Linear light of view `i` from one of its files, float32 [h,w,3], 0 = black, 1 = white.

        Raises:
            ValueError: If the file cannot be read or has another size than its camera.
        """
        if is_raw(file):
            assert self.camera is not None
            return self._fit(self._undistort(self._cut(self.camera.develop(self.camera.codes(file)), file), i))
        return self._decoded(self._cut(read_stored(file), file), self.codes.of(file), i)

    def srgb8(self, file: Path, i: int) -> np.ndarray:
        """The 8-bit sRGB picture of view `i`, uint8 [h,w,3]: as stored, if there is one and nothing is scaled.

        Raises:
            ValueError: As `linear`.
        """
        if is_raw(file):
            return np.asarray(to_srgb8(self.linear(file, i)))
        return self._shown(self._cut(read_stored(file), file), self.codes.of(file), i)

    def lit8(self, file: Path, i: int) -> np.ndarray:
        """A well-lit picture of view `i`, uint8 [h,w,3]; a raw file as LibRaw develops it, in the lit ones' balance.

        Raises:
            ValueError: As `linear`.
        """
        if not is_raw(file):
            return self._shown(self._level(read_stored(file), file), self.lit_codes.of(file), i)
        light = self._cut(read_radiance(file, self.lit_colors), file)
        return np.asarray(to_srgb8(self._fit(self._undistort(light, i))))

    def small(self, file: Path) -> np.ndarray:
        """A picture as stored, of the part that its view shows, gray and shrunk, [h,w]: codes, of any curve.

        Raises:
            ValueError: If the file cannot be read or has another size than its camera.
        """
        import cv2

        if is_raw(file):
            codes = self._cut(read_digital_numbers(file), file)
            codes = codes if codes.ndim == 3 else _cells(codes)
        else:
            codes = self._level(read_stored(file), file)
        scale = min(1.0, SMALL / max(self.views.rig.width, self.views.rig.height))
        size = max(1, round(self.views.rig.width * scale)), max(1, round(self.views.rig.height * scale))
        return cv2.resize(codes.astype(np.float32).mean(2), size, interpolation=cv2.INTER_AREA)

    def frame(self, file: Path) -> tuple[np.ndarray, Sensor]:
        """The codes of a raw file that belong to the picture, uint16, and the camera that such a frame is of."""
        assert self.camera is not None
        whole = self.camera.codes(file)
        part = self._cut(whole, file)
        top, left = place_of(file, whole.shape[:2], *part.shape[:2])
        return np.ascontiguousarray(part), self.camera.cut_sensor(top, left)

    def _decoded(self, stored: np.ndarray, codes: Codes16, i: int) -> np.ndarray:
        # Codes are undistorted before they are decoded, as for every other set of photographs.
        return self._fit(codes.linear(self._undistort(stored, i)))

    def _shown(self, stored: np.ndarray, codes: Codes16, i: int) -> np.ndarray:
        if stored.dtype == np.uint8 and not self._scaled:
            return self._undistort(stored, i)
        return np.asarray(to_srgb8(self._decoded(stored, codes, i)))

    def _pixel_off(self, image: np.ndarray) -> bool:
        rig = self.views.rig
        return max(abs(image.shape[1] - rig.width), abs(image.shape[0] - rig.height)) == 1

    def _level(self, image: np.ndarray, file: Path) -> np.ndarray:
        """A well-lit picture at the size of its view; one pixel more or less is resampled.

        The lit pictures of LLNeRF are 1155 px wide and the dark ones 1156, because they were scaled down in two ways;
        its authors advise to resample them bilinearly (github.com/onpix/LLNeRF, issue 14).
        """
        if not self._pixel_off(image):
            return self._cut(image, file)
        import cv2

        return cv2.resize(image, (self.views.rig.width, self.views.rig.height), interpolation=cv2.INTER_LINEAR)

    def _cut(self, image: np.ndarray, file: Path) -> np.ndarray:
        rig = self.views.rig
        height, width = image.shape[:2]
        if (width, height) == (rig.width, rig.height):
            return image
        if is_raw(file) and within_margins(file, (width, height), (rig.width, rig.height)):
            return part_of(image, file, rig.height, rig.width)
        raise ValueError(
            f"{file} must be {rig.width} x {rig.height} px like the pictures that {self.views.path} has cameras of, "
            f"got {width} x {height}{_shrunk((width, height), (rig.width, rig.height))}"
        )

    def _undistort(self, image: np.ndarray, i: int) -> np.ndarray:
        lenses = self.views.lenses
        return image if lenses is None else lenses[i].undistort(image, self.views.rig.Ks[i])

    def _fit(self, image: np.ndarray) -> np.ndarray:
        if not self._scaled:
            return image
        import cv2

        return cv2.resize(image, (self.rig.width, self.rig.height), interpolation=cv2.INTER_AREA)


def _cells(codes: np.ndarray) -> np.ndarray:
    """The four places of each cell of a mosaic, [h/2,w/2,4]."""
    height, width = (side // 2 * 2 for side in codes.shape)
    return np.stack([codes[y:height:2, x:width:2] for y in (0, 1) for x in (0, 1)], -1)


def _shrunk(found: tuple[int, int], wanted: tuple[int, int]) -> str:
    """The likely cause, where both have one shape."""
    if (times := shrunk_by(found, wanted)) == 1:
        return ""
    return (f": the pictures with cameras are probably shrunk by {times:.3g}; give cameras for {found[0]} x {found[1]} "
            "px, with pictures of that size")  # fmt: skip
