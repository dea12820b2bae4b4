"""Whether two pictures of each view show the same: their marks of orientation, and their pixels.

Pixels count as stored, so that a mark is of no effect while both pictures come from the camera. A program that turns
the pixels of one of them changes or drops its mark.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simscenes.sets.pictures.image_file import orientation_of

Array = NDArray[np.float64]

LOOKED_AT, FEW = 16, 3  # pairs; fewer show nothing
# Correlation of pairs that are read in another way, and its lead over theirs as they are. Of 2,560 right sets (five
# scenes, 3 to 16 pairs of 48 and 160 px, 0.003 to 3 electrons, read noise of 2, half of them with twins in other light)
# none has both; turned ones of 160 px have both from 3 electrons on, 99 of 100.
LEAST, BETTER = 0.4, 0.3
TURNED: dict[str, Callable[[Array], Array]] = {
    "turned by 180 degrees": lambda picture: picture[::-1, ::-1],
    "mirrored left to right": lambda picture: picture[:, ::-1],
    "mirrored upside down": lambda picture: picture[::-1],
    "turned by 90 degrees": lambda picture: np.rot90(picture),
    "turned by 270 degrees": lambda picture: np.rot90(picture, 3),
}
SHIFTED = {"as pictures of the next view": -1, "as pictures of the view before": 1}
AS_STORED = "as stored"
SIDES = range(5, 9)  # marks that make height of width


def pair_doubts(pairs: Mapping[int, tuple[Path, Path]], small: Callable[[Path], Array]) -> list[str]:
    """In words what speaks against pairs of pictures; [] if nothing does, or too little is seen.

    Args:
        pairs: Two files of each view, by its number.
        small: A picture of a file as stored, gray and shrunk, all of one size [h,w].

    Raises:
        ValueError: If marks of orientation differ and pixels are turned, too.
    """
    if not pairs:
        return []
    height, width = small(next(iter(pairs.values()))[0]).shape
    marks = {i: (orientation_of(one), orientation_of(other)) for i, (one, other) in pairs.items()}
    differ = [i for i, (one, other) in marks.items() if one and other and one != other
              and (height == width or (one in SIDES) == (other in SIDES))]  # fmt: skip
    doubts = []
    for group in ([i for i in pairs if i not in differ], differ):
        views = _looked_at(group)
        found = _correlations(views, *([small(pairs[i][k]) for i in views] for k in (0, 1)))
        own, turns = found[AS_STORED], {way: value for way, value in found.items() if way in TURNED}
        way = max(found, key=lambda way: found[way])
        better = found[way] >= LEAST and found[way] - own >= BETTER
        fit = f"(correlation {found[way]:.2f} of {len(views)} pairs, {own:.2f} as stored)"
        if group is differ and group:
            (one, other), (mark, another) = pairs[group[0]], marks[group[0]]
            stated = f"{other} states the orientation {another}, {one} of the same view {mark}"
            if better and way in TURNED:
                raise ValueError(f"{stated}, and pixels of the one fit pixels of the other {way} {fit}: pixels count "
                                 "as stored, and a program turned those of one of them; give both as the camera stored "
                                 "them, or turn one back")  # fmt: skip
            if own < LEAST or own - max(turns.values()) < BETTER:
                doubts.append(f"{stated} ({len(group)} of {len(pairs)} views differ), and the pictures do not show "
                              "whether a program turned the pixels of one of them: pixels count as stored; look at "
                              "both, and turn one back if they lie differently")  # fmt: skip
        if better:
            doubts.append(f"pictures do not show what others of the same views do: they fit far better {way} {fit}; "
                          "turn them, or give them the right names")  # fmt: skip
    return doubts


def _looked_at(views: Sequence[int]) -> list[int]:
    """Some of the views, two by two, so that neighbours are among them."""
    if len(views) <= LOOKED_AT:
        return [*views]
    first = np.linspace(0, len(views) - 2, LOOKED_AT // 2).round().astype(int)
    return [views[k] for k in sorted({*first.tolist(), *(first + 1).tolist()})]


def _correlations(views: Sequence[int], ones: Sequence[Array], others: Sequence[Array]) -> dict[str, float]:
    """Mean correlation of the pairs as they are and read in other ways; 0 where there are too few."""
    found = dict.fromkeys((AS_STORED, *TURNED), 0.0)
    if len(views) < FEW:
        return found
    one, other = _own(ones), _own(others)
    found[AS_STORED] = float((one * other).sum((1, 2)).mean())
    for way, turn in TURNED.items():
        turned = np.stack([turn(picture) for picture in other])
        if turned.shape == one.shape:
            found[way] = float((one * turned).sum((1, 2)).mean())
    for way, step in SHIFTED.items():
        beside = [(k, views.index(i + step)) for k, i in enumerate(views) if i + step in views]
        if len(beside) >= FEW:
            found[way] = float(np.mean([(one[k] * other[j]).sum() for k, j in beside]))
    return found


def _own(pictures: Sequence[Array]) -> Array:
    """Pictures without their common part (glow, sky, vignetting), of norm 1. Ranks of pixels count, since the curves
    of pictures differ.
    """
    ranks = np.stack([_ranks(picture) for picture in pictures])
    own = ranks - ranks.mean(0)
    own -= own.mean((1, 2), keepdims=True)
    norm = np.linalg.norm(own, axis=(1, 2), keepdims=True)
    return np.asarray(own / np.where(norm > 0, norm, 1.0))  # of one gray all over: it correlates with nothing


def _ranks(picture: Array) -> Array:
    """Of each pixel, 0 to 1; equal ones share theirs."""
    _, place, count = np.unique(picture, return_inverse=True, return_counts=True)
    return np.asarray(((count.cumsum() - count / 2) / picture.size)[place.reshape(picture.shape)])
