"""The two halves of each reference of a rendered view: what it would be, had only half of the samples been drawn.

Every reference follows from the radiance of its view by a chain of steps: exposure, the camera, an enhancement, the
curve of sRGB, clipping. The two independent renders, whose mean the radiance is, go through that very chain. Half of
what they then differ by is one draw of the reference's noise; scores take it out of squared errors (`metrics.truth`).
"""

import numpy as np
import torch

from novags.methods.enhancers import recorded
from novags.methods.enhancers.applying import enhanced_like, enhanced_view
from novags.methods.problem import encode
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.references import missing_references
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source
from novags.testbed.metrics.picture import Image
from novags.testbed.metrics.truth import Halves
from sensor_model.isp import develop_linear
from sensor_model.mosaicking import mosaic


def reference_halves(run: Run, capture: Capture, lit: Source, i: int) -> dict[str, Halves]:
    """The halves of every reference of view `i`, by name as `references`; {} where they are not known."""
    if (half := lit.half(i)) is None:
        return {}
    part = over(half, lit.radiance(i))
    first, second = (references_at(run, capture, lit, i, factor) for factor in (1 + part, 1 - part))
    return {kind: (first[kind], second[kind]) for kind in first}


def over(light: Image, mean: Image) -> Image:
    """Light over its mean [h,w,3]; 0 where that is black."""
    return np.divide(light, mean, out=np.zeros_like(mean), where=mean > 0)


def references_at(run: Run, capture: Capture, lit: Source, i: int, factor: Image) -> dict[str, Image]:
    """Every reference of view `i` as `references`, had its radiance been `factor` [h,w,3] times as strong."""
    missing, found = missing_references(run, capture, lit), dict[str, Image]()
    for suffix in ("", "_demosaiced") if capture.demosaiced else ("",):
        light = _clean(capture, i, factor, demosaiced=bool(suffix))
        if run.enhancement is not None and "enhanced" not in missing:
            _, config = recorded(run.enhancement)
            pictures, name = run.enhancement["pictures"], capture.names[i]
            dark = torch.from_numpy(capture.dark(i, pictures).copy())
            params = enhanced_view(capture.memo, name, dark, config, pictures, capture.noise_at(i))[1]
            found["enhanced" + suffix] = enhanced_like(torch.from_numpy(encode(light)), config, params).numpy()
        if run.space == "linear" and "linear" not in missing:
            found["linear" + suffix] = light
    return found if "lit" in missing else {**found, "lit": lit.shown(lit.radiance(i) * factor)}


def _clean(capture: Capture, i: int, factor: Image, *, demosaiced: bool) -> Image:
    """The noise-free exposure of that light, as `Capture.clean_linear`."""
    matrix, sensor = capture.record.color_matrix, capture.sensor
    assert sensor is not None  # of a rendered set: simulated
    if demosaiced and sensor.cfa is not None:
        charge = capture.truth(i, "clean") - sensor.black_level
        dn = sensor.black_level + charge * mosaic(factor, sensor.cfa)
        return develop_linear(dn, sensor, demosaic=capture.record.demosaic, color_matrix=matrix)
    transform = np.eye(3) if matrix is None else np.asarray(matrix, np.float64)
    seen = capture.clean_linear(i) @ np.linalg.inv(transform).T  # by the camera's own filters
    return np.asarray((seen * factor) @ transform.T, np.float32)
