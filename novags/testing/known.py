"""A dark capture with its whole truth, as plain arrays.

Cameras are OpenCV's: world-to-camera, x right, y down, z forward, pixel centres at +0.5.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # heavy: a plugin of pytest loads with it
    from novags.testbed.folders.capture import Capture
    from novags.testbed.folders.set import Source

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class PosedViews:
    """Some views of a capture. Pictures and truth are read when they are first asked for.

    Attributes:
        names: One per view; the stems of its files.
        viewmats: World-to-camera, float64 [C,4,4].
        Ks: Intrinsics, float64 [C,3,3], pixels.
        width: Of every picture, px.
        height: Of every picture, px.
    """

    names: tuple[str, ...]
    viewmats: NDArray[np.float64]
    Ks: NDArray[np.float64]
    width: int
    height: int
    _indices: tuple[int, ...] = field(repr=False)
    _capture: "Capture" = field(repr=False)
    _source: "Source" = field(repr=False)

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def pictures(self) -> Float32:
        """The dark 8-bit pictures, sRGB-encoded, [C,h,w,3] in 0..1."""
        return self._all(self._capture.srgb8)

    @cached_property
    def linear(self) -> Float32:
        """The dark 16-bit pictures, linear RGB [C,h,w,3]: 0 is black, 1 white; noise around black stays below 0."""
        return self._all(self._capture.linear16)

    @cached_property
    def raw(self) -> NDArray[np.uint16]:
        """The sensor's digital numbers, uint16 [C,h,w], or [C,h,w,3] of three chips."""
        return np.stack([self._capture.raw(i) for i in self._indices]).astype(np.uint16)

    @cached_property
    def lit(self) -> Float32:
        """Truth: the same views in good light, sRGB-encoded [C,h,w,3] in 0..1."""
        return self._all(self._source.lit)

    @cached_property
    def clean(self) -> Float32:
        """Truth: the dark exposures without noise, developed like `pictures`, [C,h,w,3]."""
        return self._all(self._capture.clean)

    @cached_property
    def clean_linear(self) -> Float32:
        """Truth: the dark exposures without noise, developed like `linear`, [C,h,w,3]."""
        return self._all(self._capture.clean_linear)

    @cached_property
    def depth(self) -> Float32:
        """Truth: z-depth [C,h,w], world units, inf where a ray hits nothing.

        Raises:
            ValueError: If it is not known: of photographs, and of a set that was scaled down for the capture.
        """
        from novags.testbed.folders.references import true_depth

        found = [true_depth(self._source, i) for i in self._indices]
        if any(depth is None for depth in found):
            raise ValueError(f"the depth of {self._source.views.path} is not known: only rendered scenes have it, in "
                             "their own size (without max_size)")  # fmt: skip
        return np.stack([np.asarray(depth, np.float32) for depth in found])

    @cached_property
    def mean_dn(self) -> Float32:
        """Truth: mean of `raw` over all exposures like this one, fixed pattern and clipping included, DN."""
        return self._truth("mean")

    @cached_property
    def variance_dn(self) -> Float32:
        """Truth: temporal variance of `raw`, clipping and rounding included, DN²."""
        return self._truth("variance")

    def _truth(self, kind: str) -> Float32:
        return self._all(lambda i: self._capture.truth(i, kind))

    def _all(self, read: Callable[[int], Any]) -> Float32:
        return np.stack([read(i) for i in self._indices]).astype(np.float32)


@dataclass(frozen=True)
class DarkCapture:
    """A capture: what a reconstructor may see (`train`), the views that it must show (`test`), and the truth on both.

    Attributes:
        folder: On disk, with its cameras as COLMAP, nerfstudio and instant-ngp read them. Tests must not change it.
        train: The training views.
        test: The held-out views: every 8th, from the first, unless the set has a split of its own.
        points: On the true surfaces, to start from, float64 [P,3]; empty for photographs without points.
        electrons: Mean signal of green, e- per pixel and exposure.
    """

    folder: Path
    train: PosedViews
    test: PosedViews
    points: NDArray[np.float64] = field(repr=False)
    electrons: float

    @staticmethod
    def of(capture: "Capture", source: "Source") -> "DarkCapture":
        """An open capture and the set that it was made from."""
        cameras = capture.cameras

        def some(indices: list[int]) -> PosedViews:
            rig = cameras.rig
            return PosedViews(
                names=tuple(cameras.names[i] for i in indices), viewmats=np.asarray(rig.viewmats, np.float64)[indices],
                Ks=np.asarray(rig.Ks, np.float64)[indices], width=rig.width, height=rig.height,
                _indices=tuple(indices), _capture=capture, _source=source,
            )  # fmt: skip

        points, told = source.points(), capture.record.simulated
        assert told is not None
        return DarkCapture(
            folder=capture.path, train=some(cameras.train_indices), test=some(cameras.test_indices),
            points=np.empty((0, 3)) if points is None else points.xyz, electrons=float(told.electrons),
        )  # fmt: skip
