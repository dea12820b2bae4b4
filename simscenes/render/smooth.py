"""Smoothing of rendered views by Intel's Open Image Denoise, for previews: it is biased, and no truth may pass it."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Standard errors that a pixel may be moved by. Without a limit the edges of a lamp in view, which have hardly any
# noise, are blurred: of `cornell` at 8 samples the squared error then grows to 2 to 6 times the one of the noisy view.
MOST = 2.0
PACKAGE = "mitsuba_oidn"
HOW_TO_GET = "pip install 'novags[denoise]'"


def missing() -> str | None:
    """Why views cannot be smoothed here, and the way out; None if they can."""
    return None if find_spec(PACKAGE) else f"the package of Intel's denoiser, {PACKAGE}, is not installed; {HOW_TO_GET}"


def smoothed(
    radiance: NDArray[Any], variance: NDArray[Any], surfaces: Mapping[str, NDArray[Any]]
) -> NDArray[np.float32]:
    """A view without most of its Monte Carlo noise.

    Args:
        radiance: [h,w,3], linear, as rendered.
        variance: Of the radiance [h,w,3]: no pixel moves by more than `MOST` roots of it.
        surfaces: "albedo.R", ..., "N.X", ...: albedo and shading normal behind each pixel [h,w]; `geometry_channels`.

    Returns:
        float32 [h,w,3], not below 0.

    Raises:
        ValueError: If the package is missing; the message says how to get it.
    """
    if (why := missing()) is not None:
        raise ValueError(f"denoise: {why}")
    import mitsuba_oidn

    albedo, normal = (
        np.ascontiguousarray(np.stack([surfaces[f"{kind}.{axis}"] for axis in axes], -1), dtype=np.float32)
        for kind, axes in (("albedo", "RGB"), ("N", "XYZ"))
    )
    raw = np.ascontiguousarray(radiance, dtype=np.float32)
    reach = np.float32(MOST) * np.sqrt(variance, dtype=np.float32)
    found = np.clip(mitsuba_oidn.denoise(raw, albedo, normal, hdr=True), raw - reach, raw + reach)
    return np.maximum(found, 0)
