"""References for the pictures of a method; they are never mixed.

`enhanced`: the noise-free dark exposure, enhanced exactly as its noisy twin, for methods whose output is enhanced: it
isolates noise. `linear`: the noise-free exposure in linear light, for methods whose output is linear. Of a camera with
a colour filter array both have the signal of all three channels of each pixel; `enhanced_demosaiced` and
`linear_demosaiced` are of the noise-free mosaic, interpolated as the pictures are, with the errors of that. `lit`: the
well-lit render or photograph, for all methods. Of imported photographs clean long exposures take the place of the
noise-free ones, and references that were not given are missing.
"""

from typing import Any, Protocol

import numpy as np
import torch

from novags.methods.enhancers import recorded
from novags.methods.enhancers.applying import enhanced_like, enhanced_twin, enhanced_view, parameters
from novags.methods.problem import encode
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.imported import MISSING, read_depth
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source
from novags.testbed.metrics.picture import Image

LINEAR = ("linear", "linear_demosaiced")  # the references in linear light


def enhanced_truth(capture: Capture, i: int, enhancement: dict[str, Any], *, demosaiced: bool = False) -> Image:
    """The noise-free exposure of view `i` through the enhancement that a run gave its noisy twin.

    `demosaiced`: as for `Capture.clean_linear`.
    """
    _, config = recorded(enhancement)
    pictures = enhancement["pictures"]
    images = capture.dark(i, pictures), capture.clean(i, demosaiced=demosaiced)
    dark, clean = (torch.from_numpy(image.copy()) for image in images)
    found: Image = enhanced_twin(
        capture.memo, capture.names[i], dark, clean, config, pictures, capture.noise_at(i), demosaiced=demosaiced
    ).numpy()
    return found


def enhanced_dark(capture: Capture, i: int, enhancement: dict[str, Any]) -> Image:
    """The dark exposure of view `i` enhanced as a run did it, noise and all."""
    _, config = recorded(enhancement)
    dark = torch.from_numpy(capture.dark(i, enhancement["pictures"]).copy())
    name, pictures = capture.names[i], enhancement["pictures"]
    found: Image = enhanced_view(capture.memo, name, dark, config, pictures, capture.noise_at(i))[0].numpy()
    return found


class MethodOutcome(Protocol):
    """The outcome of a method: a run, or the reconstruction that becomes one."""

    @property
    def space(self) -> str:
        """See `Reconstruction.space`."""
        ...

    @property
    def enhancement(self) -> dict[str, Any] | None:
        """See `Reconstruction.enhancement`."""
        ...


def pictured(run: MethodOutcome, capture: Capture, rendered: Image) -> Image:
    """A render as a picture in sRGB code, to be looked at and to be compared with `enhanced`.

    Of a run in linear light that states an enhancement: through it, with the parameters that the training views have
    on average. Nothing of a held-out view goes into it, not even its noisy picture.
    """
    if run.space != "linear":
        return rendered
    code = encode(rendered)
    if run.enhancement is None:
        return code
    enhancer, config = recorded(run.enhancement)
    pictures = run.enhancement["pictures"]

    def typical() -> Any:
        found = []
        for i in capture.cameras.train_indices:
            dark = torch.from_numpy(capture.dark(i, pictures).copy())
            found.append(parameters(capture.memo, capture.names[i], dark, config, pictures, capture.noise_at(i)))
        return enhancer.typical(found)

    params = capture.memo.once(("typical", pictures, config), typical)
    found: Image = enhanced_like(torch.from_numpy(code), config, params).numpy()
    return found


def missing_references(run: Run, capture: Capture, lit: Source) -> dict[str, str]:
    """The references that runs of this kind usually have and this one lacks, each with the reason."""
    found = {} if run.lacks is None else {"enhanced": run.lacks}
    if not capture.holds("truth"):
        wanted = {"enhanced": run.enhancement is not None, "linear": run.space == "linear"}
        found |= {kind: MISSING["truth"] for kind, holds in wanted.items() if holds}
    if not lit.lit_known:
        found["lit"] = MISSING["lit"]
    return found


def references(run: Run, capture: Capture, lit: Source, i: int) -> dict[str, Image]:
    """Every reference of view `i` for this run, by name, float32 [h,w,3]; the reference that isolates noise comes
    first.
    """
    missing, found = missing_references(run, capture, lit), dict[str, Image]()
    for suffix in ("", "_demosaiced") if capture.demosaiced else ("",):
        if run.enhancement is not None and "enhanced" not in missing:
            found["enhanced" + suffix] = enhanced_truth(capture, i, run.enhancement, demosaiced=bool(suffix))
        if run.space == "linear" and "linear" not in missing:
            found["linear" + suffix] = capture.clean_linear(i, demosaiced=bool(suffix))
    return found if "lit" in missing or not lit.shows(i) else {**found, "lit": lit.lit(i)}


def true_depth(lit: Source, i: int) -> np.ndarray | None:
    """True z-depth [h,w] of view `i`, inf where no surface is seen, 0 where nobody measured it; None where it is not
    known at all: of scaled captures, and of photographs without a scan.
    """
    if (scan := lit.scanned.get(i)) is not None:
        return read_depth(scan)
    geometry = None if lit.scaled else lit.views.geometry(i)
    return None if geometry is None else geometry["z"]
