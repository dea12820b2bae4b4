"""TIFF files: tags that change the meaning of codes. There are lists of tags that are read and of harmless ones.

Private tags (32768 and above) belong to one program each. Those that are known to change codes are refused. The others
are places on the earth, editors' layers and notes.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

from simscenes.sets.pictures.tiff import BITS, PHOTOMETRIC, SAMPLE_FORMAT, tiff_tags

# TIFF 6.0: what decoders read, then names, dates, resolutions and places on the page.
READ = {254, 256, 257, 258, 259, 262, 266, 273, 274, 277, 278, 279, 284, 292, 293, 317, 320, 322, 323, 324, 325, 330,
        338, 339, 347, 512, 513, 514, 515, 517, 518, 519, 520, 521, 529, 530, 531, 532}  # fmt: skip
HARMLESS = {255, 263, 264, 265, 269, 270, 271, 272, 280, 281, 282, 283, 285, 286, 287, 288, 289, 296, 297, 305, 306,
            315, 316, 318, 319, 321, 326, 327, 328, 333, 337, 340, 341, 343, 344, 345, 346, 351, 700}  # fmt: skip
WINDOWS = {1, 2, 11, 18246, 18247, 18249, *range(0x5000, 0x5200)}  # versions, ratings and thumbnails
REFUSED = {
    290: "GrayResponseUnit, a curve of gray", 291: "GrayResponseCurve, a curve of gray",
    301: "TransferFunction, a curve between codes and light", 332: "InkSet, inks of a printer",
    334: "NumberOfInks, inks of a printer", 336: "DotRange, inks of a printer",
    32996: "DataType, another kind of numbers", 32997: "ImageDepth, several pictures in one",
    33421: "CFARepeatPatternDim, a camera's colour filters", 33422: "CFAPattern, a camera's colour filters",
    37439: "StoNits, a unit of light", 50712: "LinearizationTable, a curve between codes and light",
    50714: "BlackLevel, a code of black", 50717: "WhiteLevel, a code of white",
    51008: "OpcodeList1, steps of development",
    51009: "OpcodeList2, steps of development", 51022: "OpcodeList3, steps of development",
}  # fmt: skip
PRIVATE = 32768
PHOTOMETRICS = {0, 1, 2, 3, 6}  # gray, colours, a palette, and the form of JPEG
NAMES = {4: "a mask", 5: "the inks of a printer", 8: "CIE Lab", 9: "ICC Lab", 10: "ITU Lab", 32803: "a camera's mosaic",
         32844: "logarithms of light", 32845: "logarithms of light", 34892: "a camera's raw colours", 51177: "depth",
         52527: "masks"}  # fmt: skip
UNSIGNED, SIGNED, UNDEFINED = 1, 2, 4
DEPTHS = {1, 2, 4, 8, 16}
DESCRIPTION, SAMPLES = 270, 277
DIGITS = 10  # of a number
SHAPE = re.compile(r'\{"shape": ?\[([0-9]+(?:, ?[0-9]+)*)\]')
DNG = "if it is a camera's raw file, name it .dng"


def unfit_kind(file: Path) -> str:
    """Why the pixels of a TIFF file are not codes of light, and what to do; "" if they are.

    Raises:
        OSError: If it cannot be read.
    """
    tags = tiff_tags(file)
    kind, bits, form = (tags[tag].values if tag in tags else () for tag in (PHOTOMETRIC, BITS, SAMPLE_FORMAT))
    if kind and kind[0] not in PHOTOMETRICS:
        what = NAMES.get(kind[0], "a kind that is not known")
        return (f"is a TIFF of {what} (PhotometricInterpretation {kind[0]}), which is not read: save it as RGB or "
                f"gray, or, {DNG}")  # fmt: skip
    if len(set(bits)) > 1 or not set(bits) <= DEPTHS:
        return f"is a TIFF of {', '.join(map(str, bits))} bits a sample, which is not read: save it with 8 or 16 bits"
    if bad := [value for value in form if value not in (UNSIGNED, UNDEFINED)]:
        what = "numbers with a sign" if bad[0] == SIGNED else "numbers of another kind"
        return (f"is a TIFF of {what} (SampleFormat {bad[0]}), which is not read: save it as 16-bit TIFF or PNG of "
                "codes from 0 on")  # fmt: skip
    return ""


def unfit_tiff(image: Any, pages: int) -> str:
    """Why the codes of a TIFF file mean something else than they seem to, and what to do; "" if they do not.

    Args:
        image: The file, as PIL opens it.
        pages: How many are read.
    """
    if image.format != "TIFF":
        return ""
    for tag in sorted(set(image.tag_v2) - READ - HARMLESS - WINDOWS):
        if tag in REFUSED or tag < PRIVATE:
            what = REFUSED.get(tag, "which is not known")
            return f"has the TIFF tag {tag} ({what}), which is not read: save it as a plain TIFF or PNG, or, {DNG}"
    samples = image.tag_v2.get(SAMPLES, 1)
    each = image.size[0] * image.size[1] * (samples if isinstance(samples, int) else 1)
    count = _stacked(str(image.tag_v2.get(DESCRIPTION, "")), each)
    return "" if count <= pages else (f"is a stack of {count} pictures, of which only {pages} can be read: save each "
                                      "as a file of its own")  # fmt: skip


def _stacked(description: str, each: int) -> int:
    """How many pictures a file holds by its description: some may lie behind the first one without directories.

    ImageJ writes large stacks so, and tifffile where it is asked for one directory.
    """
    if description.startswith("ImageJ="):
        stated = [line[7:].strip() for line in description.splitlines() if line.startswith("images=")]
        return int(stated[0]) if stated and stated[0].isdecimal() and len(stated[0]) < DIGITS else 1
    if shape := SHAPE.match(description[:1000]):
        return math.prod(int(side[:DIGITS]) for side in shape[1].split(",")) // max(each, 1)
    return 1
