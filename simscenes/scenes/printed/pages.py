"""Print: pages of text in a serif type, and their words."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simscenes.scenes.parts import textures as t
from simscenes.scenes.parts.remembered import remembered

FONT = Path(__file__).with_name("DejaVuSerif-Bold.ttf")  # LICENSE_DEJAVU beside it allows to pass it on
MARGIN = 0.08  # of the sheet's width

# Edward Lear (1871) and Lewis Carroll (1872); in the public domain.
VERSES = (
    (
        "The Owl and the Pussy-cat", "went to sea", "In a beautiful pea-green boat,", "They took some honey,",
        "and plenty of money,", "Wrapped up in a five-pound note.", "The Owl looked up to the stars",
        "above,", "And sang to a small guitar,",
    ),
    (
        "'Twas brillig, and the slithy toves", "Did gyre and gimble in the wabe;", "All mimsy were the borogoves,",
        "And the mome raths outgrabe.", "Beware the Jabberwock, my son!", "The jaws that bite,",
        "the claws that catch!", "Beware the Jubjub bird, and shun", "The frumious Bandersnatch!",
    ),
)  # fmt: skip
CHART = ("E", "F P", "T O Z", "L P E D", "P E C F D", "E D F C Z P", "F E L O P Z D", "D E F P O T E C")
# Text, x and z of its middle, width and height: all on the board.
NOTICES = (
    (("OPEN", "9 to 6", "Sundays closed"), -0.55, 1.75, 0.46, 0.4),
    (("LOST", "grey cat", "answers to Ada", "tel. 555 0143"), 0.0, 1.7, 0.42, 0.5),
    (("Reading tonight", "POEMS BY LAMPLIGHT", "Friday 7 pm", "Bring a chair"), 0.5, 1.68, 0.5, 0.6),
    (VERSES[1][:4], -0.52, 1.28, 0.5, 0.36),
    (("WANTED", "old maps", "and atlases", "ask inside"), 0.02, 1.2, 0.4, 0.42),
    (("Quiet please", "the cat is reading"), 0.52, 1.17, 0.46, 0.26),
)


@functools.lru_cache
def _face(size: int) -> Any:
    """The serif type in this many pixels."""
    from PIL import ImageFont

    return ImageFont.truetype(str(FONT), size)


@remembered
def page(
    shape: tuple[int, int],
    rng: t.Rng,
    lines: Sequence[str],
    *,
    paper: str,
    ink: str = "1c1a1a",
    shrink: float = 1.0,
) -> t.Texels:
    """Centred lines of text that fill a sheet of worn paper.

    Args:
        shape: (h, w) in texels.
        rng: Source of the wear.
        lines: From top to bottom.
        paper: Hex colour.
        ink: Hex colour.
        shrink: Height of each line over the one before, as on an eye chart.
    """
    from PIL import Image, ImageDraw

    height, width = shape
    canvas = Image.new("L", (width, height))
    draw = ImageDraw.Draw(canvas)
    heights = shrink ** np.arange(len(lines))
    heights *= (height - 2 * MARGIN * width) / heights.sum()
    top = MARGIN * width
    for line, room in zip(lines, heights, strict=True):
        wide = draw.textlength(line, font=_face(100)) / 100  # of the type's size
        size = max(4, int(min(0.72 * room, (1 - 2 * MARGIN) * width / wide)))
        draw.text((width / 2, top + room / 2), line, font=_face(size), fill=255, anchor="mm")
        top += room
    # Row 0 of a texture is its lower edge.
    mask = np.asarray(canvas, dtype=np.float64)[::-1, :, None] / 255
    return t.finish(t.color(paper) * (1 - mask) + t.color(ink) * mask, rng, grain=0.06, hue=0.03)
