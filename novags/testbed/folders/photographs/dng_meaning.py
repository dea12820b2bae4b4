"""What a DNG file says of its raw codes. All that changes light and is not understood is refused by name.

LibRaw reads the pixels. It applies the linearization table, and passes over most other tags without a word: steps of
development (opcodes), black levels by place, several raw pictures in one file.

Source: Adobe DNG 1.7.1, chapters 3 to 7.
"""

import math
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from novags.testbed.folders.photographs.dng_tags import Tags, directories
from simscenes.sets.pictures.image_file import MAX_PIXELS

KIND, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, SAMPLES, FORM = 254, 256, 257, 258, 259, 262, 277, 339
VERSION, CFA_DIM, CFA_LAYOUT, BLACK_DIM, BLACK, DELTA_H, DELTA_V = 50706, 33421, 50711, 50713, 50714, 50715, 50716
WHITE, SCALE, CROP_ORIGIN, CROP_SIZE, ACTIVE = 50717, 50718, 50719, 50720, 50829
OPCODES = {51008: "OpcodeList1", 51009: "OpcodeList2", 51022: "OpcodeList3"}
INTERLEAVED = {50975: "RowInterleaveFactor", 52547: "ColumnInterleaveFactor"}
MOSAIC, LINEAR_RAW = 32803, 34892
MAIN, ENHANCED = 0, 16  # of NewSubfileType: a whole picture; one that a program computed from the raw codes
READ = {1, 7, 8, 34892}  # compressions: none, lossless JPEG, deflate, lossy JPEG
COMPRESSIONS = {52546: "JPEG XL", 34713: "Nikon's", 32767: "Sony's", 9: "JBIG", 5: "LZW", 32773: "PackBits",
                50002: "JPEG XL"}  # fmt: skip
LOSSY, MAP_POLYNOMIAL = 34892, 8  # of a lossy file LibRaw applies this one opcode
STEPS = {1: "WarpRectilinear, which undoes distortion", 2: "WarpFisheye, which undoes distortion",
         3: "FixVignetteRadial, which undoes vignetting", 4: "FixBadPixelsConstant", 5: "FixBadPixelsList",
         6: "TrimBounds, which cuts the picture", 7: "MapTable, a curve", 8: "MapPolynomial, a curve",
         9: "GainMap, which undoes vignetting", 10: "DeltaPerRow", 11: "DeltaPerColumn", 12: "ScalePerRow",
         13: "ScalePerColumn", 14: "WarpRectilinear2, which undoes distortion"}  # fmt: skip
BAD_PIXELS = 4, 5  # they change single pixels, which stay as the sensor read them out
OPTIONAL = 1  # of an opcode's flags: a reader may pass over it
EVEN = 0.25  # DN by which the black level may differ from row to row, of codes that are whole numbers


@dataclass(frozen=True)
class DngFacts:
    """What LibRaw gets wrong, or keeps to itself.

    Attributes:
        active: Top, left, bottom and right of the pixels that see light; None: the whole frame.
        black: Levels of that area, [rows, columns, samples], of as many rows and columns as repeat; None: not stated.
        crop: Top and left in that area, height and width, of the picture that converters make; None: not stated.
        skipped: Steps of development that the file asks for, that may be passed over, and that are.
    """

    active: tuple[int, int, int, int] | None = None
    black: np.ndarray | None = None
    crop: tuple[int, int, int, int] | None = None
    skipped: tuple[str, ...] = ()


def read_dng(path: Path) -> DngFacts | None:
    """The facts of a DNG; None of other files.

    Raises:
        ValueError: If its codes mean something that is not understood.
        OSError: If it cannot be read.
    """
    every = directories(path)
    if not any(VERSION in tags.values for tags in every):
        return None
    raws = [
        t for t in every if t.first(PHOTOMETRIC, 0) in (MOSAIC, LINEAR_RAW) and t.first(KIND, 0) in (MAIN, ENHANCED)
    ]
    if not raws:
        return DngFacts()
    for problem in (_several(raws), _stored(raws[0]), _meaning(raws[0])):
        if problem:
            raise ValueError(f"{path} {problem}")
    tags = raws[0]
    height, width = tags.first(HEIGHT, 0), tags.first(WIDTH, 0)
    area = tags.wholes(ACTIVE)
    inside = len(area) == 4 and 0 <= area[0] < area[2] <= height and 0 <= area[1] < area[3] <= width
    if area and not inside:
        raise ValueError(f"{path} must have its active area inside of {width} x {height} px, got rows {area[0:3:2]} "
                         f"and columns {area[1:4:2]}: it is damaged, or written by a program that is; convert it "
                         "again")  # fmt: skip
    active = (area[0], area[1], area[2], area[3]) if inside else None
    shape = (active[2] - active[0], active[3] - active[1]) if active else (height, width)
    return DngFacts(active, _black(tags, shape, path), _crop(tags), _steps(tags, path))


def _crop(tags: Tags) -> tuple[int, int, int, int] | None:
    origin, size = tags.numbers(CROP_ORIGIN), tags.numbers(CROP_SIZE)
    if len(origin) != 2 or len(size) != 2 or not all(0 <= v < 2**31 and v.is_integer() for v in (*origin, *size)):
        return None
    return int(origin[1]), int(origin[0]), int(size[1]), int(size[0])


def _several(raws: list[Tags]) -> str:
    if len(raws) < 2:
        return ""
    kinds = " and ".join(
        "one that a program enhanced" if t.first(KIND, 0) == ENHANCED else "a camera's" for t in raws[:4]
    )
    return (f"holds {len(raws)} raw pictures ({kinds}), of which only one is read: save each as a file of its own, "
            "without enhancements")  # fmt: skip


def _stored(tags: Tags) -> str:
    """Why LibRaw does not get the numbers out."""
    packed = tags.first(COMPRESSION, 1)
    if packed not in READ:
        name = COMPRESSIONS.get(packed, "a kind that is not known")
        return (f"is compressed by {name} (Compression {packed}), which LibRaw does not read: convert it to an "
                "uncompressed DNG, or to one with lossless JPEG (compatibility with DNG 1.4 in Adobe's "
                "converter)")  # fmt: skip
    if any(form not in (1, 4) for form in tags.numbers(FORM)):
        return (f"holds numbers that are not codes (SampleFormat {tags.first(FORM, 1)}), which is not read: convert it "
                "to a DNG of 16-bit codes")  # fmt: skip
    for tag, name in INTERLEAVED.items():
        if tags.first(tag, 1) > 1:
            return (f"stores its rows or columns in another order ({name} {tags.first(tag, 1)}), which LibRaw does not "
                    "undo: convert it without")  # fmt: skip
    return ""


def _meaning(tags: Tags) -> str:
    """Why the codes are not the light on a grid of square pixels behind a 2 x 2 pattern."""
    if tags.first(PHOTOMETRIC, 0) == MOSAIC:
        dim = tags.numbers(CFA_DIM)
        if dim and dim != [2, 2]:
            return (f"has a colour filter array of {dim[0]:g} x {dim[-1]:g} (CFARepeatPatternDim), which is not read, "
                    "only Bayer patterns of 2 x 2 are: it may be of a Quad Bayer or X-Trans sensor; demosaic it to "
                    "LinearRaw or 16-bit RGB first")  # fmt: skip
        if tags.first(CFA_LAYOUT, 1) != 1:
            return (f"has filters that are not on a rectangular grid (CFALayout {tags.first(CFA_LAYOUT, 1)}), which "
                    "are not read: demosaic it first")  # fmt: skip
    if len(scale := tags.numbers(SCALE)) == 2 and abs(scale[0] - scale[1]) > 1e-3 * max(scale):
        return (f"has pixels that are not square (DefaultScale {scale[0]:g}, {scale[1]:g}), which are not read: "
                "convert it to square ones")  # fmt: skip
    if len(set(levels := tags.numbers(WHITE))) > 1:
        return (f"states a white level for each channel ({', '.join(f'{v:g}' for v in levels[:4])}), of which LibRaw "
                "keeps one: convert it to one level")  # fmt: skip
    return ""


def _steps(tags: Tags, path: Path) -> tuple[str, ...]:
    """Steps of development that the file asks for, by name, and that readers may pass over by the file's own word.

    Raises:
        ValueError: If there is one that they must not pass over.
    """
    skipped = []
    for tag, name in OPCODES.items():
        for number, optional in _opcodes(tags.values.get(tag)):
            done = number == MAP_POLYNOMIAL and name == "OpcodeList2" and tags.first(COMPRESSION, 1) == LOSSY
            if done or number in BAD_PIXELS:
                continue
            step = STEPS.get(number, f"step {number}, which is not known")
            if not optional:
                raise ValueError(f"{path} asks for {step} ({name}), which is not done, and says that readers must not "
                                 "pass over it: convert it with that step done, to LinearRaw or 16-bit RGB, or take "
                                 "raw files without it")  # fmt: skip
            skipped.append(f"{step} ({name})")
    return tuple(dict.fromkeys(skipped))


def _opcodes(stored: np.ndarray | None) -> list[tuple[int, bool]]:
    """The number of each step of a list, and whether it is optional. Lists are big-endian in every file."""
    content = b"" if stored is None else stored.astype(np.uint8).tobytes()
    if len(content) < 4:
        return []
    found, at = [], 4
    for _ in range(struct.unpack_from(">I", content)[0]):
        if at + 16 > len(content):
            break
        number, _, flags, size = struct.unpack_from(">4I", content, at)
        found.append((number, bool(flags & OPTIONAL)))
        at += 16 + size
    return found


def _black(tags: Tags, shape: tuple[int, int], path: Path) -> np.ndarray | None:
    """Levels by place, [rows, columns, samples]: as many as repeat, or all, where rows or columns have their own."""
    levels, across, down = (tags.numbers(tag) for tag in (BLACK, DELTA_H, DELTA_V))
    if not levels and not across and not down:
        return None
    samples = tags.first(SAMPLES, 1)
    rows, columns = (*tags.wholes(BLACK_DIM), 1, 1)[:2]
    if len(levels or [0]) not in (1, rows * columns * samples) or not (
        0 < rows <= shape[0] and 0 < columns <= shape[1]
    ):
        raise ValueError(f"{path} must state {rows} x {columns} x {samples} black levels, got {len(levels)}: convert "
                         "it again")  # fmt: skip
    if not np.isfinite([*levels, *across, *down]).all() or samples > 4 or math.prod(shape) > MAX_PIXELS:
        raise ValueError(f"{path} must state finite black levels of at most {MAX_PIXELS} pixels: convert it again")
    found = np.resize(np.array(levels or [0.0], np.float32), (rows, columns, samples))
    for what, deltas, side in (("column", across, shape[1]), ("row", down, shape[0])):
        if deltas and len(deltas) != side:
            raise ValueError(f"{path} must state a black level for each {what} of {side}, got {len(deltas)}: convert "
                             "it again")  # fmt: skip
    if not (np.ptp(across or [0]) > EVEN or np.ptp(down or [0]) > EVEN):
        return found + np.mean(across or [0]) + np.mean(down or [0])
    whole = np.tile(found, (-(-shape[0] // rows), -(-shape[1] // columns), 1))[: shape[0], : shape[1]]
    return whole + np.array(across or [0.0])[None, :, None] + np.array(down or [0.0])[:, None, None]
