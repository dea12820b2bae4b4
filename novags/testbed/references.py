"""What the pictures of a method are compared with; references are never mixed.

`enhanced`: the noise-free dark exposure, enhanced exactly as its noisy twin, for methods whose output is enhanced: it
differs from their input by noise alone. `linear`: the noise-free exposure in linear light, for methods whose output is
linear. `lit`: the well-lit render or photograph, for all methods.
"""

from typing import Any

import numpy as np
import torch

from novags.methods.enhancers import enhanced_twins, recorded
from novags.testbed.folders.capture import Capture
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


def references(run: Run, capture: Capture, lit: Source, i: int) -> dict[str, Image]:
    """Every reference of view `i` for this run, by name, float32 [h,w,3]; the one that isolates noise comes first."""
    found: dict[str, Image] = {}
    if run.enhancement is not None:
        found["enhanced"] = enhanced_pair(capture, i, run.enhancement)[1]
    if run.space == "linear":
        found["linear"] = capture.clean_linear(i)
    return {**found, "lit": lit.lit(i)}


def true_depth(lit: Source, i: int) -> np.ndarray | None:
    """True z-depth [h,w] of view `i`, inf where there is no surface; None for photographs and scaled captures."""
    geometry = None if lit.scaled else lit.views.geometry(i)
    return None if geometry is None else geometry["z"]
