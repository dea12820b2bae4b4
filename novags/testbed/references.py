"""What the pictures of a method are compared with; references are never mixed.

`enhanced`: the noise-free dark exposure, enhanced exactly as its noisy twin, for methods whose output is enhanced: it
differs from their input by noise alone. `linear`: the noise-free exposure in linear light, for methods whose output is
linear. `lit`: the well-lit render or photograph, for all methods. Of imported photographs clean long exposures take the
place of the noise-free ones, and what was not given is missing.
"""

from typing import Any

import numpy as np
import torch

from novags.methods.enhancers import enhanced_twins, enhanced_view, recorded
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.imported import MISSING
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source
from novags.testbed.metrics import Image


def enhanced_pair(capture: Capture, i: int, enhancement: dict[str, Any]) -> tuple[Image, Image]:
    """The dark exposure of view `i` enhanced as a run did it, and its noise-free twin through the same enhancement."""
    _, config = recorded(enhancement)
    dark, clean = (
        torch.from_numpy(image.copy()) for image in (capture.dark(i, enhancement["pictures"]), capture.clean(i))
    )
    twins = enhanced_twins(capture.memo, capture.names[i], dark, clean, config, enhancement["pictures"])
    noisy, reference = (image.numpy() for image in twins)
    return noisy, reference


def enhanced_dark(capture: Capture, i: int, enhancement: dict[str, Any]) -> Image:
    """The dark exposure of view `i` enhanced as a run did it, noise and all."""
    _, config = recorded(enhancement)
    dark = torch.from_numpy(capture.dark(i, enhancement["pictures"]).copy())
    found: Image = enhanced_view(capture.memo, capture.names[i], dark, config, enhancement["pictures"])[0].numpy()
    return found


def missing_references(run: Run, capture: Capture, lit: Source) -> dict[str, str]:
    """The references that a run of its kind has elsewhere and here has not, each with the reason."""
    noise_free = "enhanced" if run.enhancement is not None else "linear" if run.space == "linear" else None
    found = {}
    if noise_free is not None and not capture.holds("truth"):
        found[noise_free] = MISSING["truth"]
    if not lit.lit_known:
        found["lit"] = MISSING["lit"]
    return found


def references(run: Run, capture: Capture, lit: Source, i: int) -> dict[str, Image]:
    """Every reference of view `i` for this run, by name, float32 [h,w,3]; the one that isolates noise comes first."""
    missing, found = missing_references(run, capture, lit), dict[str, Image]()
    if run.enhancement is not None and "enhanced" not in missing:
        found["enhanced"] = enhanced_pair(capture, i, run.enhancement)[1]
    if run.space == "linear" and "linear" not in missing:
        found["linear"] = capture.clean_linear(i)
    return found if "lit" in missing else {**found, "lit": lit.lit(i)}


def true_depth(lit: Source, i: int) -> np.ndarray | None:
    """True z-depth [h,w] of view `i`, inf where there is no surface; None for photographs and scaled captures."""
    geometry = None if lit.scaled else lit.views.geometry(i)
    return None if geometry is None else geometry["z"]
