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

from simscenes.transport.plan import MOTION, POSES_PER_PIXEL, UNIT, TransportPlan

SHARED = math.sqrt(0.5)  # of a target that the bias may take at most, before samples alone would have to pay twice


def noise_by_brightness(channels: dict[str, NDArray[Any]]) -> list[float]:
    """Relative RMSE by noise within each quarter of a view's pixels, darkest first.

    Args:
        channels: R, G, B and var.R, var.G, var.B of the view.
    """
    light, variance = (np.stack([channels[p + c] for c in "RGB"], -1, dtype=np.float64).mean(-1).ravel()
                       for p in ("", "var."))  # fmt: skip
    found = []
    for chosen in np.array_split(np.argsort(light, kind="stable"), 4):
        level = float(light[chosen].mean()) if chosen.size else 0.0
        found.append(float(np.sqrt(variance[chosen].mean())) / level if level > 0 else 0.0)
    return found


def claimed(noise: float, quarters: list[float], made: TransportPlan) -> dict[str, Any]:
    """The errors of a view in set.json: noise and omitted light, together; nan where a plan was not asked."""
    whole, *parts = made.bias
    both = [math.hypot(n, b) for n, b in zip(quarters, parts, strict=True)]
    return {"relative_error": noise, "error": math.hypot(noise, whole), "noise_by_brightness": quarters,
            "error_by_brightness": both}  # fmt: skip


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
    return f"error {max(errors):.2%} (noise {worst['relative_error']:.2%}), {dark:.2%} in the darkest quarter"
