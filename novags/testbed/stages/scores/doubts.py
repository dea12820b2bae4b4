"""Doubts about pictures of other programs: what they hold fits the truth far better if it is read in another way."""

from dataclasses import dataclass, field

import numpy as np

from novags.methods.problem import encode
from novags.testbed.importing.pictures import ForeignPicture
from novags.testbed.metrics.picture import Image

FAR_BETTER = 4.0  # ratio of mean squares; by chance two readings of one picture do not differ so
SEEN = 1e-3  # of grey against colour: the least spread of the channels of a truth that is not grey


@dataclass
class Doubts:
    """Mean squares of the pictures of all views, each as it is read and as it might be meant."""

    squares: dict[str, list[float]] = field(default_factory=dict)
    grey: list[bool] = field(default_factory=list)
    clear: bool = False

    def add(self, picture: ForeignPicture, truth: Image, *, linear: bool) -> None:
        """Look at the picture of a view.

        Args:
            picture: The picture.
            truth: Its reference [h,w,3].
            linear: Whether the reference is linear light.
        """
        spread = float(np.ptp(truth, axis=-1).mean())
        self.grey.append(spread > SEEN and not np.ptp(picture.values, axis=-1).any())
        self.clear = self.clear or picture.clear
        self._weigh("exchanged", picture.values - truth, picture.values[..., ::-1] - truth)
        if not linear and picture.kind != "8-bit":
            self._weigh("linear", picture.values - truth, encode(picture.values) - truth)

    def add_depth(self, depth: np.ndarray, z: np.ndarray, K: np.ndarray) -> None:
        """Look at the depth of a view: whether it is the distance from the camera rather than the depth along z."""
        v, u = np.mgrid[0.5 : z.shape[0], 0.5 : z.shape[1]]
        longer = np.sqrt(((u - K[0, 2]) / K[0, 0]) ** 2 + ((v - K[1, 2]) / K[1, 1]) ** 2 + 1)
        known = np.isfinite(z) & np.isfinite(depth) & (z > 0)
        if known.any():
            apart, other = depth[known] / z[known] - 1, depth[known] / (z * longer)[known] - 1
            self._weigh("distance", np.clip(apart, -1, 1), np.clip(other, -1, 1))

    def _weigh(self, what: str, as_read: np.ndarray, as_meant: np.ndarray) -> None:
        pair = [float(np.square(values, dtype=np.float64).mean()) for values in (as_read, as_meant)]
        self.squares[what] = list(np.add(self.squares.get(what, [0.0, 0.0]), pair))

    def notes(self, reference: str) -> list[str]:
        """In words, for the user; [] without doubts."""
        found = []
        meant = [what for what, (read, other) in self.squares.items() if read > FAR_BETTER * other and read > 1e-6]
        if "linear" in meant:
            found.append(f"these pictures fit the reference {reference}, which is sRGB-encoded, far better as linear "
                         "light: score them against --reference linear, or encode them")  # fmt: skip
        if "distance" in meant:
            found.append("the channel Z fits far better as distance from the camera than as depth along its axis, as "
                         "which it is scored: write z-depth")  # fmt: skip
        if "exchanged" in meant:
            found.append("these pictures fit far better with red and blue exchanged: write red first")
        if self.clear:
            found.append("pixels of these pictures are transparent: they count as before white, as those of views do")
        if self.grey and all(self.grey):
            found.append("these pictures are grey and the views are not: scores count the missing colour as error")
        return found
