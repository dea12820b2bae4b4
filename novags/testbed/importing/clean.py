"""Clean long exposures of dark views, brought to the light of the dark ones by one factor."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from novags.testbed.console.terminal import Update
from novags.testbed.importing.dark import Dark
from novags.testbed.importing.darkroom import Darkroom
from novags.testbed.importing.stored import depth_of

LOOKED_AT, BLOCK, BRIGHT = 4, 8, 0.1  # views; px, whose mean has little noise; share of these
WHITE = 0.99  # linear; a brighter channel of the long exposure may be cut off, and then says nothing of the light


@dataclass(frozen=True)
class Match:
    """How long exposures relate to the dark ones.

    Attributes:
        gain: Dark light over the light of the long exposures: least squares over all views and channels.
        white_share: Share of the values at white in the long exposures: too dark where they are the reference.
    """

    gain: float
    white_share: float


def match_clean(
    dark: Dark, files: Sequence[Path], darkroom: Darkroom, progress: Update, done: int, total: int
) -> Match:
    """One factor for all views.

    Noise of the dark pictures averages out in it as far as they keep it: 8-bit ones are cut off at black, which lifts
    the darkest parts; bright parts, where that does not happen, weigh most.

    Raises:
        ValueError: If the long exposures are not of the kind of the dark pictures, or one of the two shows nothing.
    """
    kind = depth_of(files[0])
    if (kind == "raw") != bool(dark.raws) or kind not in ("raw", dark.depth):
        raise ValueError(
            f"--clean must hold files like the dark ones ({'raw' if dark.raws else dark.depth}), got {kind}: light can "
            "be matched between files of one kind only"
        )
    cross = energy = white = values = 0.0
    for i, (name, file, short) in enumerate(
        zip(dark.source.views.names, files, dark.raws if kind == "raw" else dark.files, strict=True)
    ):
        x, y = (darkroom.linear(f, i).astype(np.float64) for f in (file, short))
        counts = x < WHITE
        cross, energy = cross + float((x * y)[counts].sum()), energy + float((x * x)[counts].sum())
        white, values = white + float((~counts).sum()), values + x.size
        progress(done + i + 1, total, f"clean view {name}")
    if not (energy > 0 and cross > 0):
        raise ValueError("--clean and the dark pictures have no light in common: check that they show the same views")
    return Match(cross / energy, white / values)


def tone_gain(dark: Dark, darkroom: Darkroom) -> float:
    """Light of the pictures, decoded from sRGB, over the light of the raw files beside them; 1 if they are the raw
    files.

    Of the brightest parts of a few views, where 8-bit pictures cut off little noise at black.
    """
    if not dark.raws or dark.depth == "raw":
        return 1.0
    stored = measured = 0.0
    for i in range(0, len(dark.files), max(1, len(dark.files) // LOOKED_AT)):
        x, y = (_blocks(darkroom.linear(file, i)) for file in (dark.raws[i], dark.files[i]))
        bright = x >= np.quantile(x, 1 - BRIGHT)
        measured, stored = measured + float(x[bright].sum()), stored + float(y[bright].sum())
    return stored / measured if measured > 0 else 1.0


def _blocks(light: np.ndarray) -> np.ndarray:
    """Means of blocks, and of their channels; of small pictures, pixels."""
    size = min(BLOCK, *light.shape[:2])
    rows, columns = (side // size * size for side in light.shape[:2])
    cut = light[:rows, :columns].astype(np.float64)
    return cut.reshape(rows // size, size, columns // size, size, -1).mean((1, 3, 4))
