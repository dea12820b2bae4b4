"""The exposures at which a report shows a run that ends in linear light: of the dark and of the well-lit pictures."""

from dataclasses import dataclass

import numpy as np

from novags.testbed.folders.capture import Capture
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source
from novags.testbed.metrics import exposure_gain
from novags.testbed.stages.score import exposure
from sensor_model import srgb_to_linear


@dataclass(frozen=True)
class Exposures:
    """Factors on the light that a run renders, the same for all views.

    Attributes:
        dark: To the exposure of the capture; None where every picture of it is black.
        lit: To that of the well-lit pictures; None where they are not known, or black or white all over.
    """

    dark: float | None
    lit: float | None


def exposures_of(run: Run, capture: Capture, lit: Source) -> Exposures:
    """The exposures of a run in linear light, from its held-out views.

    Raises:
        ValueError: If a rendering or a picture cannot be read, or the renderings hold no light.
    """
    indices = capture.cameras.test_indices
    bright = None
    if lit.lit_known and any(_informs(lit.lit(i)) for i in indices):
        bright = exposure_gain((run.rendering(capture.names[i]), _light(lit.lit(i))) for i in indices)
    return Exposures(exposure(run, capture, lit, indices), bright)


def _informs(code: np.ndarray) -> bool:
    return bool(((code > 0) & (code < 1)).any())


def _light(code: np.ndarray) -> np.ndarray:
    """Linear light of a picture in sRGB code; what it clips is put beyond white, where it does not count."""
    return np.where(code < 1, srgb_to_linear(code), 2.0).astype(np.float32)
