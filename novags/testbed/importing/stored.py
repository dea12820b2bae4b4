"""Picture files as a camera or a converter left them: 8-bit sRGB, 16-bit linear or sRGB, camera raw."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from novags.testbed.folders.photographs.raw_files import BELOW, OVER, SOME, is_raw
from novags.testbed.folders.photographs.raw_files import SUFFIXES as RAW
from sensor_model.files.door import read_bytes
from sensor_model.isp import srgb_to_linear
from simscenes.sets.pictures.image_file import DEEP_COLOR, alpha_of, has_alpha, header, read_image, stated_curve
from simscenes.sets.pictures.mosaic import refuse_mosaic

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", *RAW)

Depth = Literal["8bit", "16bit", "raw"]
Curve = Literal["auto", "linear", "srgb"]  # auto: as the file says, else linear


@dataclass(frozen=True, kw_only=True)
class Codes16:
    """The meaning of the codes of 16-bit files."""

    black: float = 0.0  # code of no light
    white: float = 65535.0  # code of white
    curve: Curve = "auto"  # of the codes between the two

    def __post_init__(self) -> None:
        if not 0 <= self.black < self.white <= 65535:
            raise ValueError(
                f"the levels of 16-bit files must be 0 <= black < white <= 65535, got {self.black:g} and {self.white:g}"
            )
        if self.curve not in get_args(Curve):
            raise ValueError(
                f"the curve of 16-bit files must be one of {', '.join(get_args(Curve))}, got {self.curve!r}"
            )

    def of(self, file: Path) -> "Codes16":
        """The same with the curve of a file, where `curve` leaves it to the file.

        Raises:
            ValueError: If it is not an image.
        """
        return self if self.curve != "auto" else replace(self, curve=stated_curve(file) or "linear")

    def refuse_above(self, codes: np.ndarray, file: Path) -> None:
        """Raise ValueError if 16-bit codes are of a larger scale than the levels: they would be cut off at white."""
        if codes.dtype == np.uint16 and (over := float((codes > OVER * self.white).mean())) > SOME:
            raise ValueError(f"{file} must have codes up to --white {self.white:g}, got {over:.0%} above {OVER:g} "
                             f"times that, up to {codes.max()}: its codes are probably of another scale; give the "
                             "level that they have, or bring all files to one scale")  # fmt: skip

    def for_twins(self, files: Sequence[Path]) -> "Codes16":
        """The same for well-lit 16-bit files: with its levels if they are all on them, as of one camera, else with
        those of full range, as of a converter.

        Raises:
            ValueError: As `read_stored`.
        """
        full = replace(self, black=Codes16.black, white=Codes16.white)
        if self == full:
            return self
        lowest = self.black - BELOW * (self.white - self.black)
        for file in files:
            codes = read_stored(file)
            if (codes < lowest).mean() > SOME or (codes > OVER * self.white).mean() > SOME:
                return full
        return self

    def linear(self, codes: np.ndarray) -> np.ndarray:
        """Linear light float32, 0 = black, 1 = white, of 8-bit sRGB codes or of 16-bit codes; not clipped at black."""
        if codes.dtype == np.uint8:
            return np.asarray(srgb_to_linear(codes / np.float32(255)))
        light = (codes.astype(np.float64) - self.black) / (self.white - self.black)
        return np.asarray(srgb_to_linear(light) if self.curve == "srgb" else light).astype(np.float32)


def read_stored(file: Path) -> np.ndarray:
    """The codes of a picture that is not camera raw, RGB, uint8 or uint16 [h,w,3], as stored (no rotation).

    Raises:
        ValueError: If it cannot be read, is not 8 or 16 bits deep, or is a mosaic.
    """
    pixels = read_image(file, DEEP_COLOR)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{file} must hold 8- or 16-bit codes, got {pixels.dtype}: convert it to 16-bit PNG or TIFF")
    refuse_mosaic(pixels, file)
    return np.ascontiguousarray(pixels[..., ::-1])


def is_lossy(file: Path) -> bool:
    """Whether a picture was compressed with loss, so that neighbouring pixels and channels share noise."""
    suffix = file.suffix.lower()
    if suffix == ".webp":
        return b"VP8 " in chunks_of(file)
    if suffix in (".tif", ".tiff"):
        try:
            with header(file) as image:
                return "jpeg" in str(image.info.get("compression", ""))
        except ValueError:  # 16 bits, say, which PIL does not know: JPEG in TIFFs has 8
            return False
    return suffix in (".jpg", ".jpeg")


def chunks_of(file: Path) -> set[bytes]:
    """Names of the chunks of a WebP file; of its frames' chunks, where it is a film."""
    content, at, found = read_bytes(file), 12, set[bytes]()
    while at + 8 <= len(content):
        name, length = content[at : at + 4], int.from_bytes(content[at + 4 : at + 8], "little")
        found.add(name)
        at += 8 + 16 if name == b"ANMF" else 8 + length + length % 2
    return found


def refuse_transparent(file: Path) -> None:
    """Raise ValueError if pixels of a picture are transparent: the light there is unknown.

    White, which is taken to be behind pictures in good light, would be a lamp in a dark one, and the file may store any
    colour there. Of 16-bit alpha the upper 8 bits count.
    """
    if not has_alpha(file):
        return
    alpha = alpha_of(file)
    if count := int((alpha < 255).sum()):
        raise ValueError(f"{file} must be opaque, got {count} of {alpha.size} pixels with alpha below 255: what light "
                         "is there is not known; put it before the background that it was taken with, and save it "
                         "without alpha")  # fmt: skip


def depth_of(file: Path) -> Depth:
    """The content of the file.

    Raises:
        ValueError: As `read_stored`.
    """
    if is_raw(file):
        return "raw"
    return "8bit" if read_stored(file).dtype == np.uint8 else "16bit"
