"""The input of a method: the training views of one capture, as arrays. Methods know neither folders nor scenes."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar, get_args

import numpy as np
import torch
from torch import Tensor

from novags.methods.inputs import LacksInput, Pictures
from novags.methods.memo import Memo
from novags.methods.noise import Noise
from novags.splats.views import Views
from sensor_model.isp import linear_to_srgb
from sensor_model.params import Cfa

Result = TypeVar("Result")


class WhenUsed(Generic[Result]):
    """A field of a dataclass that may be given as a function: it is called each time the field is read.

    Fifty views of 1 Mpx are 600 MB: most methods look at one kind of pictures alone, and keep what they make of them.
    """

    def __init__(self, *default: Result) -> None:
        self.default = default

    def __set_name__(self, owner: type, name: str) -> None:
        self.key = f"_{name}"

    def __get__(self, instance: object, owner: type) -> Result:
        if instance is None:  # the dataclass asks for the default of the field
            if not self.default:
                raise AttributeError(self.key)
            return self.default[0]
        value = vars(instance)[self.key]
        found: Result = value() if callable(value) else value
        return found

    def __set__(self, instance: object, value: Result | Callable[[], Result]) -> None:
        vars(instance)[self.key] = value


class Start(Protocol):
    """Initial points of the scene; any object with these attributes will do, such as a `cameras.CameraEstimate`."""

    @property
    def points(self) -> Tensor:
        """[P, 3] float32, world units."""
        ...

    @property
    def colors(self) -> Tensor:
        """[P, 3] float32, 0..1, as the dark pictures show them."""
        ...

    @property
    def extent(self) -> float:
        """Size of the scene that learning rates are relative to, world units."""
        ...


@dataclass(frozen=True, kw_only=True)
class RawPictures:
    """The sensor's own numbers.

    Attributes:
        dn: Digital numbers, float32, [C, H, W] behind a colour filter array or [C, H, W, 3] of three chips. May be
            given as a function (`WhenUsed`).
        cfa: Colour filter array ("RGGB", ...); None for three chips.
        black: DN without light.
        white: DN of saturation.
        balance: Factors that make the signal of a white surface grey, red, green, blue: `linear16` is balance (dn -
            black) / (white - black), of a mosaic interpolated, times `matrix`. None if unknown.
        matrix: [3, 3] from white-balanced camera RGB to linear sRGB; None: the identity.
    """

    dn: WhenUsed[Tensor] = WhenUsed()
    cfa: Cfa | None
    black: float
    white: float
    balance: tuple[float, float, float] | None = None
    matrix: tuple[tuple[float, ...], ...] | None = None


@dataclass(frozen=True, kw_only=True)
class TrueSurface:
    """The surfaces in every view of the set, held-out ones too: truth that no camera measures.

    Attributes:
        viewmats: World-to-camera matrices, float64 [V, 4, 4].
        Ks: Intrinsics, float64 [V, 3, 3].
        depth: z-depths at the pixel centres, float32 [V, H, W], inf in front of empty space.
        normals: Of the surface, world axes, float32 [V, H, W, 3]; 0 in front of empty space.
        training: Which of these views the problem's are, in its order [C].
    """

    viewmats: np.ndarray
    Ks: np.ndarray
    depth: np.ndarray
    normals: np.ndarray
    training: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One reconstruction problem.

    Attributes:
        views: Training cameras (C of them) as the camera source gave them; they may be wrong.
        start: Initial points.
        seed: Of every random choice.
        srgb8: The 8-bit pictures, sRGB-encoded, float32 [C, H, W, 3] in 0..1. May be given as a function (`WhenUsed`).
        linear16: The 16-bit pictures, linear RGB, float32 [C, H, W, 3], 0 = black, 1 = white, not clipped at black;
            None without them. May be given as a function (`WhenUsed`).
        raw: The raw frames, or None.
        noise: Variance of each datum as a function of its mean: from the camera where it is known, else estimated from
            the pictures (`noise_estimate.noise_of` chooses); None if neither is possible. Of one view: `noise_at`.
        exposures: Of each view, times the exposure that `noise` is of; empty: all have that one. The pictures are
            even already: divided by these factors, and of one white balance.
        channels_share: Why the noise of a pixel's three channels is not independent ("demosaicing", "JPEG", "colour
            matrix"); empty where it is.
        pixels_share: Why the noise of neighbouring pixels is not independent, where the channels may be ("resampling");
            empty elsewhere.
        clean: The exposures without noise, developed like `srgb8`, [C, H, W, 3]; behind a colour filter array of all
            three channels of each pixel. Only methods with `sees_clean` get it.
        clean_demosaiced: Behind a colour filter array: the noise-free mosaics, interpolated as the pictures are; None
            elsewhere. Only methods with `sees_clean` get it.
        surface: The true surface. May be given as a function (`WhenUsed`). Only methods with `sees_surface` get it.
        lit_mean: Mean luminance of well-lit pictures of the training views, sRGB code in 0..1. Only methods that are
            set to use statistics of the truth (`truth_statistics` of their configuration) get it.
        n_gaussians: How many Gaussians were asked for; None: as many as there are points at the start.
        names: One name per view; the keys of shared results.
        shared: Results that several methods have in common.
    """

    views: Views
    start: Start
    seed: int
    srgb8: WhenUsed[Tensor] = WhenUsed()
    linear16: WhenUsed[Tensor | None] = WhenUsed(None)
    raw: RawPictures | None = None
    noise: Noise | None = None
    exposures: tuple[float, ...] = ()
    channels_share: tuple[str, ...] = ()
    pixels_share: tuple[str, ...] = ()
    clean: Tensor | None = None
    clean_demosaiced: Tensor | None = None
    surface: WhenUsed[TrueSurface | None] = WhenUsed(None)
    lit_mean: float | None = None
    n_gaussians: int | None = None
    names: tuple[str, ...] = ()
    shared: Memo = field(default_factory=Memo, repr=False, compare=False)

    def __post_init__(self) -> None:
        want = (len(self.views), self.views.height, self.views.width, 3)
        for name in ("srgb8", "linear16", "clean", "clean_demosaiced"):
            value = vars(self).get(f"_{name}", vars(self).get(name))  # where it is a function: not called
            if isinstance(value, Tensor) and value.shape != want:
                raise ValueError(f"{name} must be [C, H, W, 3] = {list(want)} like the views, got {list(value.shape)}")
        if not self.names:
            object.__setattr__(self, "names", tuple(f"{i:04d}" for i in range(len(self.views))))
        if len(self.names) != len(self.views):
            raise ValueError(f"there must be one name per view, got {len(self.names)} for {len(self.views)} views")

    def noise_at(self, view: int) -> Noise | None:
        """The noise of the pictures of one view, as they are here."""
        return self.noise.at(self.exposures[view]) if self.noise is not None and self.exposures else self.noise

    def encoded(self, pictures: Pictures) -> Tensor:
        """The dark pictures, sRGB-encoded, [C, H, W, 3] in 0..1: the 8-bit ones, or the linear ones encoded.

        Raises:
            LacksInput: If there are no 16-bit pictures.
            ValueError: If `pictures` names none.
        """
        if pictures not in get_args(Pictures):
            raise ValueError(f"pictures must be one of {', '.join(get_args(Pictures))}, got {pictures!r}")
        if pictures == "8bit":
            return self.srgb8
        linear = self.linear16
        if linear is None:
            raise LacksInput("pictures = 16bit needs the 16-bit linear pictures, and this capture has none: use 8bit")
        return gathered((torch.from_numpy(encode(view.cpu().numpy())) for view in linear), linear)

    def once(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """The result of `make`, computed once for all problems that share their results."""
        return self.shared.once(key, make)

    def to(self, device: torch.device | str) -> "Problem":
        """The same problem with its pictures and cameras on another device, and no shared results yet."""
        device = torch.device(device)
        if device == self.views.viewmats.device:
            return self

        def moved(value: Tensor | None) -> Tensor | None:
            return None if value is None else value.to(device)

        views = replace(self.views, viewmats=self.views.viewmats.to(device), Ks=self.views.Ks.to(device))
        raw = None if self.raw is None else replace(self.raw, dn=self.raw.dn.to(device))
        return replace(
            self, views=views, srgb8=self.srgb8.to(device), linear16=moved(self.linear16), raw=raw,
            clean=moved(self.clean), clean_demosaiced=moved(self.clean_demosaiced), shared=Memo(),
        )  # fmt: skip


def refuse_uneven(exposures: Sequence[float], method: str) -> None:
    """Raise LacksInput where views are of several exposures, times of a common one."""
    if set(exposures) - {1.0}:
        raise LacksInput(
            f"{method} knows one noise for the data of all views, and these were exposed {min(exposures):.3g} to "
            f"{max(exposures):.3g} times the common time: take a method that fits pictures, such as nova-fast or raw-gs"
        )


def encode(linear: np.ndarray) -> np.ndarray:
    """Linear -> sRGB code, clipped to 0..1 like every developed picture (demosaicing overshoots, noise undershoots)."""
    return linear_to_srgb(np.clip(linear, 0.0, 1.0)).astype(np.float32)


def stacked(read: Callable[[int], np.ndarray], indices: Sequence[int]) -> Tensor:
    """The images [h, w, ...] of at least one view, as [C, h, w, ...] float32; one of them is there twice at a time."""
    first = read(indices[0])
    images = np.empty((len(indices), *first.shape), np.float32)
    images[0] = first
    for k, i in enumerate(indices[1:], 1):
        images[k] = read(i)
    return torch.from_numpy(images)


def gathered(views: Iterable[Tensor], like: Tensor) -> Tensor:
    """Images [h, w, ...], one for each view of `like`, as a tensor of its shape, type and device; one by one."""
    found = torch.empty_like(like, memory_format=torch.contiguous_format)
    for place, view in zip(found, views, strict=True):
        place.copy_(view)
    return found
