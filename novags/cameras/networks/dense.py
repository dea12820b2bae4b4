"""Pictures as a network expects them, and cameras and points from its output for every pixel.

Positions have pixel centres at +0.5. A position p of a picture is at p * scale - offset in the prepared one.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from novags.cameras.estimate import Array, CameraEstimate, as_estimate
from novags.cameras.points import averaged, project, subset

Index = NDArray[np.intp]
LARGEST_MISS = 2.0  # px of a prepared picture, twice the effect of conventions of half a pixel and of rounding
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet
UNSOUND = "check the weights, or run it with --device cpu"  # what to do about a network that computes nonsense


@dataclass(frozen=True)
class Window:
    """The part of the pictures that a network sees.

    Attributes:
        scale: Factors (x, y) by which pictures were scaled.
        offset: Columns and rows (x, y) of the scaled pictures that were then cut off on the left and at the top.
        width: Of the kept part, px.
        height: Of the kept part, px.
    """

    scale: Array
    offset: Array
    width: int
    height: int

    def original(self, pixels: Array) -> Array:
        """Positions [..., 2] in the prepared pictures -> in the original ones."""
        result: Array = (pixels + self.offset) / self.scale
        return result

    def original_Ks(self, Ks: Array) -> Array:
        """Intrinsics [C, 3, 3] of prepared pictures -> intrinsics of the original ones."""
        result = Ks.copy()
        result[:, :2, 2] += self.offset
        # Scaling keeps pixel edges in place, not centres, so with centres at +0.5 whole rows of K scale.
        result[:, :2] /= self.scale[:, None]
        return result

    def prepared_Ks(self, Ks: Array) -> Array:
        """Intrinsics [C, 3, 3] of the original pictures -> intrinsics of the prepared ones."""
        result = np.array(Ks, np.float64)
        result[:, :2] *= self.scale[:, None]
        result[:, :2, 2] -= self.offset
        return result


def prepare(
    pictures: NDArray[np.uint8], scaled: tuple[int, int], kept: tuple[int, int], offset: tuple[int, int], resample: int
) -> tuple[Tensor, Window]:
    """Pictures scaled with Pillow, as the loaders of these packages do, and cropped.

    Args:
        pictures: [C, h, w, 3] uint8.
        scaled: Width and height that they are scaled to.
        kept: Width and height of the part that is kept.
        offset: Columns and rows before that part.
        resample: Filter of Pillow.

    Returns:
        float32 [C, 3, H, W] in 0..1, and which part of the pictures that is.
    """
    (width, height), (x, y) = kept, offset
    images = [np.asarray(Image.fromarray(p).resize(scaled, resample))[y : y + height, x : x + width] for p in pictures]
    scale = np.array(scaled) / [pictures.shape[2], pictures.shape[1]]
    prepared = torch.from_numpy(np.stack(images)).movedim(-1, 1).float() / 255
    return prepared, Window(scale, np.array(offset, np.float64), width, height)


def normalised(values: Tensor) -> Tensor:
    """Pictures [C, 3, H, W] in 0..1, minus the mean and over the deviation of ImageNet."""
    mean, deviation = (values.new_tensor(each)[:, None, None] for each in (MEAN, DEVIATION))
    return (values - mean) / deviation


def as_matrices(rotations: Array, translations: Array) -> Array:
    """World-to-camera matrices [C, 4, 4] of [C, 3, 3] and [C, 3]."""
    matrices = np.tile(np.eye(4), (len(rotations), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = rotations, translations
    return matrices


def inverted(cam2world: Array) -> Array:
    """World-to-camera matrices of camera-to-world ones [C, 4, 4], with a rotation in each."""
    rotations = cam2world[:, :3, :3].transpose(0, 2, 1)
    return as_matrices(rotations, -np.einsum("cij,cj->ci", rotations, cam2world[:, :3, 3]))


def with_lens(focals: Array, centres: Array) -> Array:
    """Intrinsics [C, 3, 3] of packages that count pixel centres from 0: focal lengths [C], principal points [C, 2]."""
    Ks = np.tile(np.eye(3), (len(focals), 1, 1))
    Ks[:, 0, 0] = Ks[:, 1, 1] = focals
    Ks[:, :2, 2] = centres + 0.5
    return Ks


def numbers(value: Any) -> Array:
    """A tensor, or a list of tensors of one shape, as a float64 array."""
    parts = [v.detach().double().cpu().numpy() if isinstance(v, Tensor) else np.asarray(v, np.float64) for v in value]
    return np.stack(parts)


def choose(source: str, confidence: Array, usable: NDArray[Any], drop_percent: float, count: int, seed: int) -> Index:
    """View, row and column [P, 3] of at most `count` pixels that are usable and not among the least confident.

    Args:
        source: The camera source, for messages.
        confidence: [C, H, W].
        usable: [C, H, W].
        drop_percent: Of all pixels, the share of the least confident that are left out.
        count: How many pixels.
        seed: Of their choice.

    Raises:
        ValueError: If there is no such pixel, or a confidence is not finite.
    """
    if not np.isfinite(confidence).all():
        raise ValueError(f"{source} returned confidences that are not finite: {UNSOUND}")
    good = np.argwhere((confidence >= np.percentile(confidence, drop_percent)) & usable)
    if not len(good):
        raise ValueError(f"{source} returned no positive depth: the pictures may be too dark, try pictures=enhanced")
    return subset(good, count, np.random.default_rng(seed))


def from_pixels(
    source: str, chosen: Index, points: Array, viewmats: Array, Ks: Array, window: Window, colors_from: Tensor
) -> CameraEstimate:
    """The estimate of a network that places every view and the point behind every pixel.

    Args:
        source: The camera source, for messages.
        chosen: View, row and column [P, 3] of the points' pixels in the prepared pictures.
        points: [P, 3], in the network's frame.
        viewmats: [C, 4, 4], in the same frame.
        Ks: [C, 3, 3], of the prepared pictures.
        window: Which part of the pictures those are.
        colors_from: [C, h, w, 3] dark images, 0..1.

    Raises:
        ValueError: If cameras are not finite, or if points are not seen at their pixels.
    """
    refuse_elsewhere(source, chosen, points, viewmats, Ks, LARGEST_MISS)
    view, row, column = chosen.T
    # The same place in the original pictures; at their very edge, rounding may end just outside.
    sizes = np.array(colors_from.shape[2:0:-1])
    x, y = np.minimum(window.original(np.stack([column, row], -1) + 0.5).astype(int), sizes - 1).T
    colors = colors_from.detach().cpu().double().numpy()[view, y, x]
    return as_estimate(
        tuple(range(len(viewmats))), viewmats, window.original_Ks(Ks), points, averaged(points, colors),
        size=(int(sizes[0]), int(sizes[1])), made_of={"of the network's depths": len(points)},
    )  # fmt: skip


def refuse_elsewhere(source: str, chosen: Index, points: Array, viewmats: Array, Ks: Array, largest: float) -> None:
    """Refuse cameras that are not finite or do not see points at their pixels.

    Args:
        source: The camera source, for messages.
        chosen: View, row and column [P, 3] of the points' pixels.
        points: [P, 3].
        viewmats: [C, 4, 4], in the same frame.
        Ks: [C, 3, 3].
        largest: Distance from the pixels that is allowed, px (median).

    Raises:
        ValueError: If so: then this version of the package has other conventions, and its cameras would be silently
            wrong.
    """
    if not (np.isfinite(viewmats).all() and np.isfinite(Ks).all()):
        raise ValueError(f"{source} returned cameras that are not finite: {UNSOUND}")
    view, row, column = chosen.T
    miss = _miss(points, np.stack([column, row], -1) + 0.5, view, viewmats, Ks)
    if not miss <= largest:
        raise ValueError(
            f"{source} returned points that its own cameras see {miss:.3g} px from their pixels (median, at most "
            f"{largest:g}): this version of the package has other conventions than novags.cameras.networks"
        )


def _miss(points: Array, pixels: Array, view: Index, viewmats: Array, Ks: Array) -> float:
    """Distance between pixels and where their views see the points, px; infinite for points behind the camera.

    Median over the views of their medians: the first view alone, whose pose often is the identity, shows nothing.
    """
    medians = []
    for i in np.unique(view):
        seen, _ = project(points[view == i], viewmats[i], Ks[i])
        distances = np.linalg.norm(seen - pixels[view == i], axis=1)
        medians.append(np.median(np.where(np.isfinite(distances), distances, np.inf)))
    return float(np.median(medians))
