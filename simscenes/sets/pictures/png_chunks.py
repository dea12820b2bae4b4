"""PNG files: statements of their chunks about the codes. There are lists of known chunks and of harmless ones.

Source: PNG specification, third edition, sections 5.4 (names of chunks) and 11.3. The first letter of a name is small
where a decoder may skip the chunk, the second one where the chunk is one program's own.
"""

from __future__ import annotations

import struct
from pathlib import Path

from sensor_model.files.door import PICTURE, opened

START = b"\x89PNG\r\n\x1a\n"
UNDERSTOOD = {b"IHDR", b"PLTE", b"IDAT", b"IEND", b"tRNS", b"gAMA", b"sRGB", b"iCCP", b"cICP", b"acTL"}
# Of printing, texts, dates, previews and thumbnails, and of how bright a screen shows them: the light is the same.
HARMLESS = {b"bKGD", b"cHRM", b"cLLI", b"cLLi", b"dSIG", b"eXIf", b"fcTL", b"fdAT", b"gIFg", b"gIFt", b"gIFx", b"hIST",
            b"iDOT", b"iTXt", b"mDCV", b"mDCv", b"oFFs", b"pHYs", b"sBIT", b"sCAL", b"sPLT", b"tEXt", b"tIME",
            b"zTXt"}  # fmt: skip
WHAT = {b"CgBI": "Apple's own form for telephones, of colours multiplied by alpha", b"sTER": "two pictures side by "
                                                                                             "side",
        b"pCAL": "codes that stand for other quantities"}  # fmt: skip
MOST_CHUNKS, MOST_BYTES = 1000, 64  # before the pixels; of a chunk that is looked at
# Transfer curves by their number in ITU-T H.273: those shown like sRGB, and the one that is proportional to light.
SRGB_PRIMARIES, UNSTATED = 1, 2
SHOWN, PROPORTIONAL = {1, 2, 4, 6, 13, 14, 15}, {8}
TRANSFERS = {5: "an exponent of 2.8", 16: "PQ", 18: "HLG"}
SRGB_GAMMA, LINEAR_GAMMA = (0.42, 0.52), (0.98, 1.02)  # of gAMA: 1/2.2, 1/1.961 of video; 1


def chunks_of_png(file: Path) -> dict[bytes, bytes]:
    """The chunks before the pixels, the first bytes of each; none of other files.

    Raises:
        OSError: If it cannot be read.
    """
    found: dict[bytes, bytes] = {}
    with opened(file, most=PICTURE) as source:
        if source.read(len(START)) != START:
            return found
        while len(found) < MOST_CHUNKS and len(head := source.read(8)) == 8 and head[4:] != b"IDAT":
            length, name = struct.unpack(">I4s", head)
            found.setdefault(name, source.read(min(length, MOST_BYTES)))
            source.seek(length - min(length, MOST_BYTES) + 4, 1)
    return found


def unfit_png(chunks: dict[bytes, bytes]) -> str:
    """Why the pixels mean something else than they seem to, and what to do; "" if they do not."""
    frames = int.from_bytes(chunks.get(b"acTL", b"")[:4], "big")
    if frames > 1:
        return (
            f"is an animated PNG of {frames} pictures, of which only the first is read: save each as a file of its own"
        )
    for name in chunks.keys() - UNDERSTOOD - HARMLESS:
        if name[0] & 0x20 and name[1] & 0x20 and name not in WHAT:
            continue
        what = f" ({WHAT[name]})" if name in WHAT else ", which can change what its codes mean"
        return f"has the chunk {name.decode('latin1')!r}{what}, which is not read: save it as a plain PNG"
    coded = chunks.get(b"cICP", b"")
    if len(coded) >= 4 and not coded[3]:
        return "states codes of video, from 16 to 235 (cICP, narrow range), which are not read: save it with full range"
    if len(coded) >= 4 and coded[2]:
        return (f"states brightness and differences of colours (cICP, matrix {coded[2]}), which are not read: save it "
                "as RGB")  # fmt: skip
    return ""


def primaries_of_png(chunks: dict[bytes, bytes]) -> int | None:
    """The number of its primaries in ITU-T H.273, which counts before any profile; None where it states none."""
    coded = chunks.get(b"cICP", b"")
    return coded[0] if len(coded) >= 4 and coded[0] != UNSTATED else None


def curve_of_png(chunks: dict[bytes, bytes]) -> tuple[str, str] | None:
    """The curve of the codes ("srgb", "linear"; "" another one) and who says so; None where only a profile may.

    A chunk counts before the next one of cICP, iCCP, sRGB and gAMA.
    """
    if len(coded := chunks.get(b"cICP", b"")) >= 4:
        number = coded[1]
        kind = "linear" if number in PROPORTIONAL else "srgb" if number in SHOWN else ""
        return kind, f"cICP, transfer {number}" + (f", {TRANSFERS[number]}" if number in TRANSFERS else "")
    if b"iCCP" in chunks:
        return None
    if b"sRGB" in chunks:
        return "srgb", "sRGB"
    if len(stated := chunks.get(b"gAMA", b"")) >= 4:
        gamma = int.from_bytes(stated[:4], "big") / 100_000
        inside = [
            kind for kind, (low, high) in (("srgb", SRGB_GAMMA), ("linear", LINEAR_GAMMA)) if low <= gamma <= high
        ]
        return "".join(inside), f"gAMA {gamma:g}"
    return None
