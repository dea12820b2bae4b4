"""Image files of any kind: their size from the header, and their pixels, with a limit on decoding."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.door import PICTURE, opened, read_bytes
from sensor_model.files.reading import brief
from sensor_model.isp import srgb_to_linear, to_srgb8
from simscenes.sets.pictures.meaning import Curve, curve_of, is_deep, unfit
from simscenes.sets.pictures.mosaic import refuse_mosaic
from simscenes.sets.pictures.tiff import (
    AS_STORED,
    EXTRA_SAMPLES,
    ORIENTATION,
    PREMULTIPLIED,
    like_pages,
    misread,
    retagged,
    tiff_tags,
    unread,
)
from simscenes.sets.pictures.tiff_meaning import unfit_kind
from simscenes.sets.pictures.whole import whole_content

# 23,170 x 23,170: above any camera's (phones have 200 million), and 1.6 GB as 8-bit RGB. A larger declared size is
# refused before a byte is decoded, since a few kilobytes can declare a picture that fills any memory.
MAX_PIXELS = 2**29
# Flags of OpenCV by number: it is loaded with the first picture, and what the command line knows itself does not wait.
STORED, COLOR, DEEP_COLOR = -1, 1, 3  # IMREAD_UNCHANGED, IMREAD_COLOR, IMREAD_COLOR | IMREAD_ANYDEPTH
# PIL knows some forty more, tries them on a file of any name, and reserves as much memory as some of their headers say.
FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "PPM", "JPEG2000")
_PIL = Lock()  # its limit is one number for the whole process
_OPENCV = Lock()  # and so is how much OpenCV writes: the last of `_decoding` threads puts `_level` back
_decoding = _level = 0


def image_size(file: Path) -> tuple[int, int]:
    """Width and height of an image file, from its header alone.

    Raises:
        ValueError: If it is not an image, larger than `MAX_PIXELS`, or says that its codes mean something else than
            those of a photograph (see `meaning`).
    """
    with header(file) as image:
        width, height = image.size
        problem = "" if width * height > MAX_PIXELS else unfit(file, image)
    if width * height > MAX_PIXELS:
        raise ValueError(f"{file} declares {width} x {height} pixels, at most {MAX_PIXELS} can be read: scale it down")
    if problem:
        raise ValueError(f"{file} {problem}")
    return width, height


@contextmanager
def header(file: Path, *, pages: bool = False) -> Iterator[Any]:
    """An image file as PIL opens it, of any declared size, with sides and pixels as stored.

    Args:
        file: The file.
        pages: Whether a TIFF file may have several pages, which the caller reads.

    Raises:
        ValueError: If it is not an image.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        stored = opened(file, most=PICTURE)
    except OSError as error:
        raise ValueError(f"{file} is not a readable image ({error.strerror or error}); replace or remove it") from error
    with stored:
        if problem := unread(file, pages=pages) or unfit_kind(file):
            raise ValueError(f"{file} {problem}")
        with _PIL, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of odd metadata; whether the pixels can be read shows when they are
            limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None  # PIL's own: 179 million
            try:
                content = retagged(file, {ORIENTATION: AS_STORED})
                with Image.open(stored if content is None else io.BytesIO(content), formats=FORMATS) as image:
                    image.info.pop("xmp", None)  # PIL turns TIFFs by a mark in it, too
                    yield image
            except MemoryError:
                raise
            except UnidentifiedImageError as error:
                raise ValueError(
                    f"{file} is not a readable image (its kind is not known); replace or remove it"
                ) from error
            except Exception as error:  # each format has errors of its own, SyntaxError and struct.error among them
                raise ValueError(f"{file} is not a readable image ({brief(error)}); replace or remove it") from error
            finally:
                Image.MAX_IMAGE_PIXELS = limit


def read_image(file: Path, flags: int) -> NDArray[Any]:
    """Pixels as `cv2.imread` returns them with `flags`, [h,w] or [h,w,c], as stored: a mark of orientation is ignored.

    Args:
        file: The image.
        flags: `STORED`, `COLOR` or `DEEP_COLOR`.

    Raises:
        ValueError: If it is missing, not a readable image, or larger than `MAX_PIXELS`.
    """
    import cv2

    if not file.is_file():
        raise ValueError(f"{file} is missing or not a readable image")
    image_size(file)
    content = whole_content(file)
    if problem := misread(file, deep=bool(flags & cv2.IMREAD_ANYDEPTH)):  # which is a part of IMREAD_UNCHANGED, too
        raise ValueError(f"{file} {problem}")
    try:
        with _quiet_opencv():
            pixels = _decoded(file, content, flags | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise ValueError(f"{file} cannot be decoded ({' '.join(str(error).split())}); replace or remove it") from error
    if pixels is None:
        again = ("; or save it again with 8 or 16 bits, without tiles, and with LZW, deflate or no compression"
                 if file.suffix.lower() in (".tif", ".tiff") else "")  # fmt: skip
        raise ValueError(f"{file} is not a readable image (it cannot be decoded); replace or remove it{again}")
    return np.asarray(pixels)


def read_frames(file: Path) -> NDArray[Any]:
    """All pages of a TIFF file as stored, or the one picture of another file: [n,h,w] or [n,h,w,c].

    Raises:
        ValueError: As `read_image`, or if pages differ in size, depth or kind, or are too many.
    """
    import cv2

    if (count := like_pages(file)) < 2:
        return read_image(file, STORED)[None]
    with header(file, pages=True) as image:
        width, height = image.size
        problem = unfit(file, image, pages=count) or misread(file, deep=True)
    if problem:
        raise ValueError(f"{file} {problem}")
    if width * height * count > MAX_PIXELS:
        raise ValueError(f"{file} declares {count} pages of {width} x {height} pixels, at most {MAX_PIXELS} in all can "
                         "be read: save fewer in a file")  # fmt: skip
    with _quiet_opencv():
        flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
        _, pages = cv2.imdecodemulti(np.frombuffer(read_bytes(file), np.uint8), flags)
    if len(pages) != count or len({page.shape for page in pages}) != 1:
        raise ValueError(f"{file} has {count} pages, of which {len(pages)} can be decoded; replace or remove it")
    return np.stack(pages)


@contextmanager
def _quiet_opencv() -> Iterator[None]:
    """Keep OpenCV from writing lines of its own, of files that are then refused by name."""
    import cv2

    global _decoding, _level
    # Version 5 has it in a module, 4 had it at the top; 0 is silent in both.
    logging: Any = getattr(cv2.utils, "logging", cv2)
    with _OPENCV:
        if not _decoding:
            _level = logging.setLogLevel(0)
        _decoding += 1
    try:
        yield
    finally:
        with _OPENCV:
            _decoding -= 1
            if not _decoding:
                logging.setLogLevel(_level)


def _decoded(file: Path, content: bytes, flags: int) -> Any:
    import cv2

    # OpenCV turns TIFFs with any flags, and multiplies 8-bit colours by alpha where the file has not done so.
    changed = retagged(file, {ORIENTATION: AS_STORED, EXTRA_SAMPLES: PREMULTIPLIED})
    return cv2.imdecode(np.frombuffer(content if changed is None else changed, np.uint8), flags)


WITH_ALPHA = (".png", ".tif", ".tiff", ".webp")  # formats of 8-bit photographs that can be transparent
BACKGROUND = 255  # sRGB code behind transparent pixels: white, as in the papers that use the NeRF-synthetic scenes


def has_alpha(file: Path) -> bool:
    """Whether pixels of the image can be transparent, from its header alone.

    Raises:
        ValueError: If it is not an image.
    """
    with header(file) as image:
        return image.mode in ("RGBA", "LA", "PA", "RGBa", "La") or "transparency" in image.info


def read_rgb(file: Path) -> NDArray[np.uint8]:
    """Pixels as stored, 8-bit sRGB [h,w,3]; transparent ones before a white background, mixed as codes are.

    A mark of orientation is ignored, since poses refer to the pixels as stored. Light of a deep picture is encoded.

    Raises:
        ValueError: If it is missing, not a readable image, or larger than `MAX_PIXELS`, or a mosaic.
    """
    if file.is_file() and is_deep(file):
        return np.asarray(to_srgb8(read_light(file)), np.uint8)
    if file.is_file() and has_alpha(file):
        return np.asarray(np.round(255 * before_white(file)[0]), np.uint8)
    pixels = read_image(file, COLOR)
    refuse_mosaic(pixels, file)
    return np.ascontiguousarray(pixels[..., ::-1])


def read_light(file: Path) -> NDArray[np.float32]:
    """Linear light [h,w,3] of a picture of more than 8 bits, 1 = the largest code; before white where transparent.

    Its codes are light, unless the file says that they are sRGB-encoded.

    Raises:
        ValueError: As `read_deep`.
    """
    shares = read_deep(file)
    return np.asarray(srgb_to_linear(shares), np.float32) if stated_curve(file) == "srgb" else shares


def read_deep(file: Path) -> NDArray[np.float32]:
    """Codes [h,w,3] of a picture of more than 8 bits, 1 = the largest code; before white where transparent.

    Raises:
        ValueError: As `read_rgb`, or if it has not 16 bits.
    """
    if has_alpha(file):
        return before_white(file)[0]
    pixels = read_image(file, DEEP_COLOR)
    if pixels.dtype != np.uint16:
        raise ValueError(f"{file} must hold 8- or 16-bit codes, got {pixels.dtype}: convert it to 16-bit PNG or TIFF")
    refuse_mosaic(pixels, file)
    return np.ascontiguousarray(pixels[..., ::-1]).astype(np.float32) / np.float32(65535)


def stated_curve(file: Path) -> Curve | None:
    """The curve that a picture states for its codes; None where it states none.

    Raises:
        ValueError: If it is not an image.
    """
    with header(file) as image:
        return curve_of(file, image)


def orientation_of(file: Path) -> int | None:
    """The mark of orientation (EXIF) of a picture, 1 where it has none; None of raw files that are no TIFF inside.

    Raises:
        OSError: If it cannot be read.
    """
    try:
        if (tag := tiff_tags(file).get(ORIENTATION)) is not None:
            mark: Any = tag.values[0]
        else:
            with header(file) as image:
                mark = image.getexif().get(ORIENTATION)
    except ValueError:
        return None
    return mark if mark in range(1, 9) else AS_STORED


def before_white(file: Path) -> tuple[NDArray[np.float32], int]:
    """A picture that `has_alpha` before a white background, mixed as codes are: [h,w,3] in 0..1, and its bits, 8 or 16.

    Raises:
        ValueError: If it is not a readable image, or larger than `MAX_PIXELS`.
    """
    found = read_image(file, STORED)
    if found.ndim == 3 and found.shape[2] == 4:
        bits, codes = 8 * found.dtype.itemsize, found[..., [2, 1, 0, 3]].astype(np.float32)
    else:  # OpenCV drops the alpha of some kinds, gray ones above all
        bits, codes = 8, _codes_with_alpha(file)
    shares = codes / np.float32(2**bits - 1)
    alpha = shares[..., 3:]
    own = shares[..., :3] if _premultiplied(file) else shares[..., :3] * alpha
    return np.minimum(own + np.float32(BACKGROUND / 255) * (1 - alpha), 1, dtype=np.float32), bits


def alpha_of(file: Path) -> NDArray[np.uint8]:
    """Alpha [h,w] of a picture that `has_alpha`, 0..255; of 16-bit alpha the upper 8 bits.

    Raises:
        ValueError: If it is not an image.
    """
    with header(file) as image:
        return np.asarray(image.convert("LA" if image.mode == "La" else "RGBA").getchannel("A"))


def _premultiplied(file: Path) -> bool:
    extra = tiff_tags(file).get(EXTRA_SAMPLES)
    return extra is not None and extra.values[0] == PREMULTIPLIED


def _codes_with_alpha(file: Path) -> NDArray[np.float32]:
    """Codes [h,w,4] as stored, of a picture that PIL holds in 8 bits, red first, alpha last."""
    with header(file) as image:
        if (mode := image.mode) == "La":  # gray multiplied by alpha, which PIL cannot convert directly
            return np.asarray(image, dtype=np.float32)[..., [0, 0, 0, 1]]
        if not mode.startswith(("I", "F")):  # of more bits, which PIL would cut off
            return np.asarray(image.convert("RGBA"), dtype=np.float32)
    raise ValueError(f"{file} must be 8-bit or have a channel of alpha, got {mode} with transparent pixels: save it as "
                     "RGBA")  # fmt: skip
