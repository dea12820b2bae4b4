"""A view exposed again, at any light level: linear light in, the developed picture of one exposure out."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from novags.testbed.folders.capture import Capture
from novags.testbed.folders.set import Source
from novags.testbed.stages.capturing import camera_for, expose_view
from novags.testbed.stages.configs.capturing import CaptureConfig
from sensor_model.isp import Demosaic, develop, white_balance
from sensor_model.params import Exposure, Sensor

GREY = 0.18  # linear; where a brightened picture has its mean green, as photographs have theirs


@dataclass(frozen=True)
class ViewerCamera:
    """A camera and how its pictures are developed."""

    sensor: Sensor
    exposure: Exposure
    demosaic: Demosaic
    color_matrix: Any
    seed: int

    @staticmethod
    def of(capture: Capture, source: Source, config: CaptureConfig | None = None) -> "ViewerCamera":
        """The capture's own; where `config` is given or the camera of photographs is not known, the camera of
        `config`.
        """
        record = capture.record
        seed = 0 if record.simulated is None else record.simulated.noise_seed
        if config is not None or capture.sensor is None:
            chosen = CaptureConfig() if config is None else config
            sensor = camera_for(source, chosen)
            return ViewerCamera(sensor, chosen.exposure, chosen.demosaic, source.color_matrix, seed)
        # The known light of imported photographs is in linear sRGB, not in the camera's own colours.
        matrix = None if capture.imported else record.color_matrix
        return ViewerCamera(capture.sensor, record.exposure, record.demosaic, matrix, seed)

    def for_srgb(self) -> "ViewerCamera":
        """The same camera before light that is in linear sRGB already, for any colours that the set was rendered in."""
        return replace(self, color_matrix=None)

    def brightening(self, electrons: float) -> float:
        """The digital gain that shows a grey pixel of so many electrons in green at `GREY`; never below 1."""
        s = self.sensor
        linear = electrons * s.gain * float(white_balance(s)[1]) / (s.white_dn - s.black_level)
        return max(1.0, GREY / linear)


def expose_again(
    radiance: NDArray, camera: ViewerCamera, *, electrons: float, mean_green: float, view: int, brighten: bool = True
) -> tuple[NDArray[np.uint8], float]:
    """One exposure of a view with every effect of the camera.

    Args:
        radiance: Linear [h, w, 3], any unit.
        camera: The camera.
        electrons: Mean signal of green, e- per pixel, of a pixel whose radiance is `mean_green`.
        mean_green: Usually the mean over all views, as in a capture.
        view: Number of the view, which with the camera's seed fixes the noise.
        brighten: Whether to develop with a digital gain that brings `mean_green` to middle grey.

    Returns:
        The 8-bit sRGB picture [h, w, 3], and the digital gain.

    Raises:
        ValueError: If the light is black as a whole, not finite or negative.
    """
    frame = expose_view(
        radiance, camera.sensor, camera.exposure, electrons=electrons, mean_green=mean_green, seed=camera.seed,
        view=view,
    )  # fmt: skip
    gain = camera.brightening(electrons) if brighten else 1.0
    developed = develop(
        frame, camera.sensor, demosaic=camera.demosaic, color_matrix=camera.color_matrix, digital_gain=gain
    )
    return developed.srgb8, gain
