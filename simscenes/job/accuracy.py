"""The error that a render claims: the noise of its samples and the light its plan leaves out, together and by
brightness.

Noise is seen in the spread of independent passes. What every pass lacks is not: of that only the plan knows, from its
pilots. Both are errors of pixels relative to a mean radiance, and add as squares: they are independent.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.render.sequences import mean_at_most
from simscenes.transport.plan import MOTION, POSES_PER_PIXEL, UNIT, TransportPlan

# Standard errors, of a mean of squares. The estimate scatters about the noise to be expected, and the error of the
# picture at hand does as much: three standard errors of each, together.
AT_MOST = 3 * math.sqrt(2)
SHARED = math.sqrt(0.5)  # of a target that the bias may take at most, before samples alone would have to pay twice


def noise_limits(channels: dict[str, NDArray[Any]]) -> list[float]:
    """Relative RMSE of pixels by noise, at most: of a view, then of each quarter of its pixels, darkest first.

    The variance of every pixel is its own, from its two halves: a variance that neighbours share (var.R/G/B) gives the
    dark pixels at an edge the noise of the bright ones. Scatter of the estimate is added, see `AT_MOST`.

    Args:
        channels: R, G, B and half.R, half.G, half.B of the view.
    """
    light = np.stack([channels[c] for c in "RGB"], -1, dtype=np.float64).mean(-1).ravel()
    square = np.square(np.stack([channels[f"half.{c}"] for c in "RGB"], -1, dtype=np.float64)).mean(-1).ravel()
    order = np.argsort(light, kind="stable")
    found = []
    for chosen in (order, *np.array_split(order, 4)):
        level = float(light[chosen].mean()) if chosen.size else 0.0
        limit = mean_at_most(square[chosen], AT_MOST) if level > 0 else 0.0
        found.append(math.sqrt(limit) / level if level > 0 else 0.0)
    return found


def claimed(noise: float, limits: list[float], made: TransportPlan) -> dict[str, Any]:
    """The errors of a view in set.json; nan where a plan was not asked.

    Args:
        noise: The relative RMSE by noise, as it was estimated.
        limits: `noise_limits` of the view: what it is at most, whole and by brightness.
        made: The plan, whose omitted light is added.
    """
    whole, *parts = (math.hypot(n, b) for n, b in zip(limits, made.bias, strict=True))
    return {"relative_error": noise, "error": whole, "noise_by_brightness": limits[1:],
            "error_by_brightness": parts}  # fmt: skip


def noise_target(target: float, made: TransportPlan) -> float:
    """The noise at which a view may stop, so that noise and omitted light together stay below `target`.

    Where the omitted light takes more than half of the target's square, samples cannot pay for it: then the target
    holds for the noise alone.
    """
    bias = made.bias[0]
    return math.sqrt(target**2 - bias**2) if bias <= SHARED * target else target


def warnings_about(made: TransportPlan, target: float | None) -> list[str]:
    """Warnings before hours are spent: light that is left out against the wish for a small error."""
    said = []
    if made.bound > made.tolerance:
        worst = max((e for e in made.effects if not e.on and e.unit == UNIT), key=lambda e: e.contribution)
        share = "an unknown share" if math.isinf(made.bound) else f"up to {made.bound:.2%}"
        said.append(f"the plan leaves out {share} of the light, more than the {made.tolerance:.2%} allowed, most of it "
                    f"by {worst.name!r} ({worst.reason}); set.json counts it into the error")  # fmt: skip
    moved = made[MOTION].contribution if made.is_on(MOTION) else 0.0  # nan if it was not asked
    if moved * POSES_PER_PIXEL > made.subframes:
        said.append(f"the picture moves {moved:.3g} px during an exposure, rendered as {made.subframes} poses: fine "
                    f"detail shows as copies {moved / made.subframes:.2g} px apart; a shorter motion or smaller "
                    "pictures blur evenly")  # fmt: skip
    bias = made.bias[0]
    if target is not None and bias > SHARED * target:
        said.append(f"what the plan leaves out may be an error of {bias:.2%} by itself: samples reach the target of "
                    f"{target:.2%} for the noise only; a smaller tolerance of the plan leaves out less")  # fmt: skip
    return said


def summary(views: dict[str, dict[str, Any]]) -> str:
    """One line on the views of a set: the largest error, its noise, and the darkest quarter's."""
    errors = [math.nan if v["error"] is None else v["error"] for v in views.values()]  # JSON has no nan
    worst = max(views.values(), key=lambda v: v["relative_error"])
    dark = max(v["error_by_brightness"][0] for v in views.values())
    if any(map(math.isnan, errors)):
        dark = max(v["noise_by_brightness"][0] for v in views.values())
        return (
            f"noise {worst['relative_error']:.2%} (omitted light was not measured), {dark:.2%} in the darkest quarter"
        )
    return f"error at most {max(errors):.2%} (noise {worst['relative_error']:.2%}), {dark:.2%} in the darkest quarter"
