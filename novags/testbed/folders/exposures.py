"""The exposures at which a run that ends in linear light is shown: like the dark and like the well-lit pictures."""

from dataclasses import dataclass

import numpy as np

from novags.methods.problem import encode
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.references import pictured, references
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source
from novags.testbed.metrics.linear import exposure_gain, is_black
from novags.testbed.metrics.picture import Image
from sensor_model.isp import srgb_to_linear


@dataclass(frozen=True)
class Exposures:
    """Factors on the light that a run renders, the same for all views.

    Attributes:
        dark: To the exposure of the capture; None where every picture of it is black.
        lit: To the exposure of the well-lit pictures; None where they are not known, or black or white all over.
    """

    dark: float | None
    lit: float | None


def exposures_of(run: Run, capture: Capture, lit: Source) -> Exposures:
    """The exposures of a run in linear light, from its held-out views.

    Where the noise-free exposures are not known, the dark pictures themselves take their place: over so many pixels
    their noise hardly counts.

    Raises:
        ValueError: If a rendering or a picture cannot be read, or the renderings hold no light.
    """
    indices = capture.cameras.test_indices
    dark = bright = None

    def exposed(i: int) -> Image:
        return references(run, capture, lit, i).get("linear", capture.linear(i))

    taken, shown = [i for i in indices if capture.is_dark(i)], [i for i in indices if lit.shows(i)]
    if not all(is_black(exposed(i)) for i in taken):
        dark = exposure_gain((run.rendering(capture.names[i]), exposed(i)) for i in taken)
    if any(_informs(lit.lit(i)) for i in shown):
        bright = exposure_gain((run.rendering(capture.names[i]), _light(lit.lit(i))) for i in shown)
    return Exposures(dark, bright)


def _informs(code: np.ndarray) -> bool:
    return bool(((code > 0) & (code < 1)).any())


def _light(code: np.ndarray) -> np.ndarray:
    """Linear light of a picture in sRGB code; clipped values are put beyond white, where they do not count."""
    return np.where(code < 1, srgb_to_linear(code), 2.0).astype(np.float32)


def as_compared(rendered: Image, run: Run, capture: Capture, reference: str, exposures: Exposures | None) -> Image:
    """A rendering as the picture that is compared with a reference.

    Args:
        rendered: [h, w, 3], as the run ends.
        run: The run.
        capture: Its capture.
        reference: `lit`, or one that went through the enhancement of the run.
        exposures: Of a run in linear light, which is brought to the exposure of `lit`; None for others.
    """
    if exposures is None or reference != "lit":
        return pictured(run, capture, rendered)
    return encode((1.0 if exposures.lit is None else exposures.lit) * rendered)
