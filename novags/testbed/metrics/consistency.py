"""Consistency between views: whether a scene point keeps its colour when the camera moves.

Correspondences come from the truth (`simscenes.flow`), never from the method's own depth, which may agree with itself.
"""

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from novags.testbed.metrics.picture import Image
from novags.testbed.metrics.tone import check_pair


class ConsistencyScores(TypedDict):
    """Mean absolute colour change between two views of the same points; None where no point is seen by both."""

    rendered: float | None
    reference: float | None
    excess: float | None


def consistency_scores(
    rendered: tuple[Image, Image], reference: tuple[Image, Image], displacement: NDArray, visible: NDArray
) -> ConsistencyScores:
    """Colour change of the method's two views along true correspondences, and the reference's.

    - `rendered`: mean |A(p) - B(p + displacement)| of the method over the visible pixels and the channels.
    - `reference`: the same of the reference: gloss and reflections that move with the camera, and the resampling of B
      between its pixel centres.
    - `excess`: mean absolute difference of the two signed changes: changes in the method and not in the truth. 0 for
      the truth itself, where `rendered` is not; a flat picture cannot win by not changing at all.

    Both pairs must have the same tone, or contrast is compared instead of consistency: score against the reference put
    through the method's own enhancement, or align the tones of a method with one curve for both views.

    Args:
        rendered: The method's images A and B, float [h,w,3].
        reference: The reference's images A and B, same shape.
        displacement: From pixel centres of A to the same point in B, pixels (x, y), [h,w,2]; nan where not visible.
        visible: Whether B sees the point, bool [h,w].

    Raises:
        ValueError: If shapes differ, a value is not finite, or a visible point lies outside B.
    """
    check_pair(rendered[0], reference[0])
    if not visible.any():
        return {"rendered": None, "reference": None, "excess": None}
    own, true = (color_change(*pair, displacement, visible) for pair in (rendered, reference))
    return {
        "rendered": float(np.abs(own).mean()),
        "reference": float(np.abs(true).mean()),
        "excess": float(np.abs(own - true).mean()),
    }


def color_change(a: Image, b: Image, displacement: NDArray, visible: NDArray) -> NDArray[np.float64]:
    """Colour of B minus colour of A at the visible pixels of A, [n,3]; B is interpolated bilinearly.

    Raises:
        ValueError: If shapes differ, a value is not finite, or a visible point lies outside B.
    """
    check_pair(a, b)
    h, w = a.shape[:2]
    if displacement.shape != (h, w, 2) or visible.shape != (h, w):
        got = f"{displacement.shape} and {visible.shape}"
        raise ValueError(f"displacement must be [{h}, {w}, 2] and visible [{h}, {w}] like the images, got {got}")
    y, x = np.nonzero(visible)
    place = np.stack([x + 0.5, y + 0.5], -1) + displacement[y, x]
    if not ((place >= 0) & (place <= (w, h))).all():  # a nan is not inside either
        raise ValueError(f"visible points must lie inside the second image, 0..{w} by 0..{h} px: check the flow")
    # Samples sit at pixel centres, +0.5. The outer half of border pixels has the border's colour ("nearest").
    at = (place - 0.5).T[::-1]
    found = [map_coordinates(b[..., c].astype(np.float64), at, order=1, mode="nearest") for c in range(3)]
    return np.stack(found, -1) - a[y, x]
