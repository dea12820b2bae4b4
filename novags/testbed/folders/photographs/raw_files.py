"""Camera raw files (DNG, NEF, CR2, ARW ...) through LibRaw: the mosaic as read out, or developed linear RGB."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from novags.testbed.folders.photographs.dng_meaning import EVEN, read_dng
from novags.testbed.folders.photographs.raw_colors import RawColors, colors_of
from sensor_model.files.dng import SMALLEST
from sensor_model.files.door import PICTURE, admitted
from sensor_model.files.reading import brief
from sensor_model.isp import interpolate
from sensor_model.params import CFAS, Cfa
from simscenes.sets.pictures.mosaic import is_mosaic, is_shifted

SUFFIXES = (".dng", ".nef", ".nrw", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw")
CLIPPED = 0.5  # of the white level: pixels of many cameras are full at 0.8 to 1 of it
LOST = 0.01  # of the rows: where more of them repeat their first two codes, a part of the picture is missing
# Codes may be above the white level, where a camera saturates unevenly; many that are half as large again are of
# another scale. Codes of no light scatter around the black level, by less than this share of the range.
OVER, SOME, BELOW = 1.5, 0.02, 0.02
DARK, SQUARE = 0.05, 8  # share of the squares of so many px that must not be below black: their means have little noise
UNEVEN = 0.005  # of the range: what odd and even columns of a camera may differ by
SEEN = 2048  # px in the middle that show whether filters are those that are stated


def is_raw(path: Path) -> bool:
    """Whether the file's name says that it is a camera raw file."""
    return path.suffix.lower() in SUFFIXES


@dataclass(frozen=True)
class Mosaic:
    """One frame as the sensor read it out."""

    dn: np.ndarray  # uint16 [h,w]
    cfa: Cfa | None  # None: monochrome
    time: float | None  # s; None: not in the file
    bits: int  # that hold the white level


def read_mosaic(path: Path) -> Mosaic:
    """The codes of a raw file, without any processing.

    Raises:
        ValueError: If the file cannot be read, or is neither monochrome nor a Bayer mosaic.
    """
    with _opened(path) as raw:
        dn = raw.raw_image_visible
        if dn is None or dn.ndim != 2:
            raise ValueError(f"{path} holds no mosaic of the sensor's own pixels: give unprocessed raw files")
        dn = np.array(_part(raw.raw_image, raw, path))
        return Mosaic(dn, _pattern(raw, path), _time(raw), int(raw.white_level).bit_length())


@dataclass(frozen=True)
class RawFormat(RawColors):
    """Facts about codes and colours in a raw file."""

    shape: tuple[int, ...]  # [h,w] of a mosaic, [h,w,3] of three chips
    cfa: Cfa | None  # None: every pixel has all three channels
    black: tuple[float, ...]  # DN, of each place in the 2 x 2 cell, row by row; of three chips, of each channel
    #   Where levels repeat over more pixels or differ by rows: the means of these places, and `levels` has each.
    white: float  # DN
    time: float | None  # s
    levels: np.ndarray | None = None  # DN, black of each pixel of a mosaic, [h,w]; None: `black` says all


def read_format(path: Path) -> RawFormat:
    """Levels, colour filters, white balance and colour matrix of a raw file.

    Raises:
        ValueError: If the file cannot be read, is monochrome, is neither a Bayer mosaic nor three full channels, or
            states levels or colours that no camera has.
    """
    with _opened(path) as raw:
        codes = _part(raw.raw_image, raw, path)
        if raw.num_colors == 1:
            raise ValueError(f"{path} is monochrome; only colour raw files can be imported: convert it to 16-bit PNG")
        mosaic, white = codes.ndim == 2, float(raw.white_level)
        black, levels = _black(raw, path, codes.shape)
        if not 0 <= max(black) < white <= 65535:
            raise ValueError(f"{path} states black levels {black} and the white level {white:g}: they must be rising")
        return RawFormat(
            shape=codes.shape if mosaic else (*codes.shape[:2], 3),
            cfa=_pattern(raw, path) if mosaic else None,
            black=black,
            white=white,
            time=_time(raw),
            levels=levels,
            **vars(colors_of(raw, path)),
        )


def _black(raw: Any, path: Path, shape: tuple[int, ...]) -> tuple[tuple[float, ...], np.ndarray | None]:
    """Levels of the four places of a cell, or of three channels; and of each pixel where the cell does not say all.

    LibRaw keeps the least level of patterns larger than 2 x 2, and one place's for another's where it drops a row.
    """
    facts, mosaic = read_dng(path), len(shape) == 2
    if facts is None or facts.black is None:
        blacks = raw.black_level_per_channel
        places = np.ravel(_part(raw.raw_colors, raw, path)[:2, :2]) if mosaic else range(3)
        return tuple(float(blacks[k]) for k in places), None
    rows, columns, samples = facts.black.shape
    if not mosaic:
        if np.ptp(facts.black, (0, 1)).max() > EVEN:
            raise ValueError(f"{path} states black levels of three channels that differ by place ({rows} x {columns}), "
                             "which are not read: convert it with the black level subtracted")  # fmt: skip
        means = np.resize(facts.black.mean((0, 1)), 3)
        return tuple(float(v) for v in means), None
    side = shape[:2] if max(rows, columns) > 2 else (2, 2)
    whole = facts.black[..., 0][np.ix_(np.arange(side[0]) % rows, np.arange(side[1]) % columns)]
    cell = [whole[y::2, x::2] for y in (0, 1) for x in (0, 1)]
    uneven = any(np.ptp(place) > EVEN for place in cell)
    return tuple(float(place.mean()) for place in cell), whole if uneven else None


def skipped_steps(path: Path) -> tuple[str, ...]:
    """Steps of development that a raw file asks for and that are passed over, as the file allows.

    Raises:
        ValueError: If it asks for one that must not be passed over.
    """
    facts = read_dng(path)
    return () if facts is None else facts.skipped


def read_exposure(path: Path) -> tuple[float | None, float | None, float | None]:
    """Exposure time in seconds, ISO speed and f-number, each None where the file does not say it; from its header.

    Raises:
        ValueError: If the file cannot be read.
    """
    with _opened(path, pixels=False) as raw:
        return _time(raw), _stated(raw, "iso_speed"), _stated(raw, "aperture")


def _time(raw: Any) -> float | None:
    return _stated(raw, "shutter_speed")


def _stated(raw: Any, name: str) -> float | None:
    value = getattr(raw.other, name) if hasattr(raw, "other") else 0.0
    return float(f"{value:.6g}") if value > 0 else None  # LibRaw keeps it in float32


def read_digital_numbers(path: Path) -> np.ndarray:
    """The codes of a raw file, uint16: [h,w] of a mosaic or a monochrome sensor, [h,w,3] of three chips.

    Raises:
        ValueError: If the file cannot be read.
    """
    with _opened(path) as raw:
        dn = np.array(_part(raw.raw_image, raw, path))
        return dn if dn.ndim == 2 else np.ascontiguousarray(dn[..., :3])


def _pattern(raw: Any, path: Path) -> Cfa | None:
    if raw.num_colors == 1:
        return None
    letters = _letters(raw, path)
    found = [cfa for cfa in CFAS if cfa == letters]
    if not found:
        raise ValueError(
            f"{path} has the colour filter array {letters!r}; supported are monochrome and {', '.join(CFAS)}"
        )
    return found[0]


def _letters(raw: Any, path: Path) -> str:
    pattern = raw.raw_pattern if len(raw.raw_pattern) > 2 else _part(raw.raw_colors, raw, path)[:2, :2]
    return "".join(chr(raw.color_desc[i]) for i in np.ravel(pattern))


def read_colors(path: Path) -> RawColors:
    """White balance and colour matrix, from the header alone.

    Raises:
        ValueError: If the file cannot be read, or states colours that no camera has.
    """
    with _opened(path, pixels=False) as raw:
        return colors_of(raw, path)


def first_colors(files: Sequence[Path]) -> RawColors | None:
    """The colours of the first raw file, which count for all; None without raw files."""
    return next((read_colors(file) for file in files if is_raw(file)), None)


def read_radiance(path: Path, colors: RawColors | None = None) -> np.ndarray:
    """Linear sRGB float32 [h,w,3], 1 = white level: black level, white balance, AHD demosaicing, colour matrix.

    The colours come from `colors_of`, so that LibRaw does not make each picture grey where a file states no balance.
    Pixels stay as stored (no rotation), because poses refer to the stored pixels. Where LibRaw would drop a row, or
    mistake the levels, the demosaicing is Menon's (see `develop_linear`).

    Args:
        path: The raw file.
        colors: Those of the first file of a set; None: the file's own.

    Raises:
        ValueError: If the file cannot be read.
    """
    import rawpy

    colors = colors or read_colors(path)
    matrix = colors.color_matrix
    light = _developed(path, colors.response)
    if light is None:
        with _opened(path) as raw:
            red, green, blue = (1 / share for share in colors.response)
            own = raw.num_colors == 4  # channels, whose matrix LibRaw alone has
            matrix = None if own else matrix
            codes = raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                adjust_maximum_thr=0.0,
                user_wb=[red, green, blue, green],
                output_color=rawpy.ColorSpace.sRGB if own else rawpy.ColorSpace.raw,
                output_bps=16,
                user_flip=0,
            )
        light = codes.astype(np.float32) / np.float32(65535)
    if matrix is not None:
        light = np.minimum(light, 1.0) @ matrix.T
    return np.clip(light, 0, 1).astype(np.float32)


def _developed(path: Path, response: tuple[float, float, float]) -> np.ndarray | None:
    """The balanced channels of a mosaic that LibRaw does not develop rightly; None of all others."""
    facts = read_dng(path)
    odd = facts is not None and facts.active is not None and (facts.active[0] % 2 or facts.active[1] % 2)
    if facts is None or not (odd or (facts.black is not None and np.ptp(facts.black) > EVEN)):
        return None
    stated = read_format(path)
    if stated.cfa is None:
        return None
    levels = np.resize(stated.black, (2, 2)) if stated.levels is None else stated.levels
    h, w = stated.shape
    whole = np.tile(levels, (-(-h // levels.shape[0]), -(-w // levels.shape[1])))[:h, :w]
    light = (
        (read_digital_numbers(path) - whole)
        / (stated.white - whole)
        / np.take(
            response,
            np.resize(["RGB".index(c) for c in stated.cfa], (2, 2))[np.ix_(np.arange(h) % 2, np.arange(w) % 2)],
        )
    )
    return interpolate(light, stated.cfa, "menon")


def size(path: Path) -> tuple[int, int]:
    """Width and height of the result of `read_radiance`, from the header alone.

    Raises:
        ValueError: If the file cannot be read.
    """
    with _opened(path, pixels=False) as raw:
        area = _active(path)
        return (raw.sizes.width, raw.sizes.height) if area is None else (area[3] - area[1], area[2] - area[0])


def place_of(path: Path, shape: tuple[int, int], height: int, width: int) -> tuple[int, int]:
    """Top and left of a picture of this size in the pixels of a raw file: as its crop says, else the middle."""
    return crop_of(path, shape, height, width) or ((shape[0] - height) // 2, (shape[1] - width) // 2)


def crop_of(path: Path, shape: tuple[int, int], height: int, width: int) -> tuple[int, int] | None:
    """Top and left of a picture of this size where a raw file says that it is cut out of its pixels."""
    facts = read_dng(path) if path.suffix.lower() == ".dng" else None
    crop = None if facts is None else facts.crop
    if crop is None or crop[2:] != (height, width) or crop[0] + height > shape[0] or crop[1] + width > shape[1]:
        return None
    return crop[:2]


def _active(path: Path) -> tuple[int, int, int, int] | None:
    facts = read_dng(path)
    return None if facts is None else facts.active


def _part(whole: np.ndarray, raw: Any, path: Path) -> np.ndarray:
    """The pixels of a frame that see light. LibRaw drops a row or a column of them where the margin is odd."""
    top, left, bottom, right = _active(path) or (0, 0, 0, 0)
    if not bottom:
        top, left = raw.sizes.top_margin, raw.sizes.left_margin
        bottom, right = top + raw.sizes.height, left + raw.sizes.width
    return whole[top:bottom, left:right]


def _check_whole(raw: Any, path: Path) -> None:
    """Refuse the pixels of a file whose end is missing or full of zeros: LibRaw says nothing in many formats.

    Every code has noise, so that a row repeats its first two (of a mosaic, one for each filter) only where all of it is
    clipped, or as black as noise below a code leaves it. The last rows are missing: others may be the blank sky of a
    simulated camera without noise.

    Raises:
        ValueError: If too many of the last rows hold such codes that are neither black nor clipped.
    """
    codes = raw.raw_image_visible
    if codes is None or codes.shape[1] < 4:
        return
    codes = codes if codes.ndim == 2 else codes[..., :3]  # LibRaw adds an empty fourth channel
    repeats = (codes[:, 2:] == codes[:, :-2]).reshape(len(codes), -1).all(1)
    pairs = codes[:, :2].reshape(len(codes), -1).astype(np.int64)
    blacks = raw.black_level_per_channel
    natural = (pairs >= CLIPPED * raw.white_level) | ((pairs >= min(blacks) - 1) & (pairs <= max(blacks) + 1))
    there = np.flatnonzero(~repeats | natural.all(1))
    lost = len(codes) - 1 - (there[-1] if len(there) else -1)
    if lost > LOST * len(codes):
        raise ValueError(f"{path} holds no picture in the last {lost} of {len(codes)} rows, which repeat their first "
                         "codes: it is cut short or damaged, copy it again")  # fmt: skip
    _check_codes(codes, raw, path)


def _check_codes(codes: np.ndarray, raw: Any, path: Path) -> None:
    """Raise ValueError if codes do not fit what the file says: levels of another scale, filters of another pattern."""
    stated = None if (facts := read_dng(path)) is None else facts.black
    whole = codes if codes.ndim == 2 else codes[..., :3]
    codes = whole[::3, ::3]  # of every filter; all would take a second
    white = float(raw.white_level)
    black = float(min(raw.black_level_per_channel) if stated is None else stated.min())
    over = float((codes > OVER * white).mean())
    if over > SOME:
        raise ValueError(f"{path} states the white level {white:g}, and {over:.0%} of its codes are above {OVER:g} "
                         f"times that, up to {codes.max()}: they are probably shifted to the top of 16 bits, or the "
                         "level is of another camera; convert it again with the level that its codes have")  # fmt: skip
    if (dark := min(_darkest(whole[y::2, x::2]) for y in (0, 1) for x in (0, 1))) < black - BELOW * (white - black):
        raise ValueError(f"{path} states the black level {black:g}, and {DARK:.0%} of the picture have at most "
                         f"{dark:g}: black is probably subtracted already, or stated in other units than the codes; "
                         "convert it again with the level that its codes have")  # fmt: skip
    if raw.num_colors == 1 or codes.ndim != 2:
        return
    light = _without_black(raw, path)
    if len(cfa := _letters(raw, path)) == 4 and is_shifted(light, cfa, UNEVEN * (white - black)):
        raise ValueError(f"{path} states the filters {cfa}, and its two places of green differ over the whole picture, "
                         "while red and blue are the same: they lie a row or a column beside, as where a program "
                         "cropped or turned the picture; convert it again from the camera's own file")  # fmt: skip
    if is_mosaic(*(light[y::2, x::2] for y in (0, 1) for x in (0, 1))):
        raise ValueError(f"{path} states a colour filter array of 2 x 2, and pixels behind the same filter differ with "
                         "a period of 4 pixels over the whole picture: it is probably of a Quad Bayer sensor, whose "
                         "filters are 4 x 4; let the camera write binned raw files, or demosaic it to LinearRaw or "
                         "16-bit RGB first")  # fmt: skip


def _darkest(codes: np.ndarray) -> float:
    """The code of the darkest squares of a picture."""
    import cv2

    size = max(1, codes.shape[1] // SQUARE), max(1, codes.shape[0] // SQUARE)
    return float(np.quantile(cv2.resize(np.ascontiguousarray(codes), size, interpolation=cv2.INTER_AREA), DARK))


def _without_black(raw: Any, path: Path) -> np.ndarray:
    """The middle of a mosaic, from an even row and column on, above its black levels [h,w]."""
    whole = _part(raw.raw_image, raw, path)
    y, x = (np.arange(max(0, side - SEEN) // 4 * 2, min(side, (side + SEEN) // 2)) for side in whole.shape)
    facts = read_dng(path)
    if facts is None or facts.black is None:
        black = np.array(raw.black_level_per_channel, np.float64)[_part(raw.raw_colors, raw, path)[np.ix_(y, x)]]
    else:
        rows, columns, _ = facts.black.shape
        black = facts.black[..., 0][np.ix_(y % rows, x % columns)]
    return np.asarray(whole[np.ix_(y, x)] - black, np.float64)


@contextmanager
def _opened(path: Path, *, pixels: bool = True) -> Iterator[Any]:
    import rawpy

    name = admitted(path, most=PICTURE)
    try:
        read_dng(path)  # refuses what LibRaw would read as something else
        with rawpy.RawPy() as raw:
            raw.open_file(name)
            if pixels:
                raw.unpack()
                _check_whole(raw, path)
            yield raw
    except (rawpy.LibRawError, OSError) as error:
        raise ValueError(
            f"{path} is not a readable raw file ({brief(error)}); replace or remove it. LibRaw also refuses images "
            f"under {SMALLEST} px wide or high"
        ) from error
