"""The known values of every pixel of a dark exposure, in a form that a script of the page can read.

A probe is a list of planes, each [channels, h, w] of 16-bit numbers, low bytes before high bytes, one after the other,
compressed by zlib. Whole numbers are digital numbers; floats are half precision times a scale, which keeps 11 bits: an
error of 0.05 %, far below the noise.
"""

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from novags.testbed.folders.capture import Capture
from sensor_model.isp import white_balance

ROUNDING = 5e-4  # of half precision, relative
LARGEST = 60_000.0  # what the largest number becomes: half precision ends at 65504, and has fewer bits below 6e-5


@dataclass(frozen=True)
class Probe:
    """The planes of one view."""

    header: dict[str, Any]  # their names, shapes and scales, and what turns them into units
    data: bytes  # the planes


def probe_of(capture: Capture, i: int) -> Probe | None:
    """Everything that is known of the pixels of view `i`; None where there are no raw frames.

    Planes: `dn`, the digital numbers; of a simulated exposure `mean`, the mean of all exposures like it above black,
    and `noise`, their temporal standard deviation, both in electrons, unless that is the root of `mean` and of one
    `floor`; `linear` and `linear_mean`, the developed light of this exposure and of the noise-free one, 1 = white,
    where they are not a multiple of `dn` and of `mean`.
    """
    if not (capture.holds("raw") and capture.is_dark(i)):
        return None
    cfa, black, white = capture.levels
    sensor = capture.sensor
    dn = capture.raw(i)
    header = {"cfa": cfa, "black": black, "white": white, "gain": None if sensor is None else sensor.gain,
              "width": dn.shape[1], "height": dn.shape[0], "per_dn": None, "floor": None}  # fmt: skip
    planes: dict[str, np.ndarray] = {"dn": dn}
    mean = None if capture.imported else capture.truth(i, "mean")
    if sensor is not None and mean is not None:
        planes["mean"] = (mean - black) / sensor.gain
        noise = np.sqrt(capture.truth(i, "variance")) / sensor.gain
        floor = float(np.median(noise**2 - planes["mean"]))
        rooted = np.sqrt(np.maximum(planes["mean"] + floor, 0))
        if (np.abs(rooted - noise) <= ROUNDING * noise).all():
            header["floor"] = floor
        else:
            planes["noise"] = noise
    alike = not capture.record.uneven.exposures  # `linear` is evened, `dn` is as taken
    if sensor is not None and dn.ndim == 3 and capture.record.color_matrix is None and alike:
        header["per_dn"] = (white_balance(sensor) / (white - black)).tolist()
    else:
        planes["linear"] = capture.linear(i)
    # The mean has the fixed pattern and the dark charge of the camera, which the noise-free exposure lacks.
    if capture.holds("truth") and ("linear" in planes or mean is None or (mean != capture.truth(i, "clean")).any()):
        planes["linear_mean"] = capture.clean_linear(i)
    packed = [_packed(name, values) for name, values in planes.items()]
    header["planes"] = [told for told, _ in packed]
    return Probe(header, zlib.compress(b"".join(data for _, data in packed), 6))


def _packed(name: str, values: np.ndarray) -> tuple[dict[str, Any], bytes]:
    stacked = values[None] if values.ndim == 2 else np.moveaxis(values, -1, 0)
    told = {"name": name, "channels": len(stacked), "whole": np.issubdtype(values.dtype, np.integer), "scale": 1.0}
    if told["whole"]:
        codes = stacked.astype("<u2")
    else:
        told["scale"] = float(np.abs(stacked).max()) / LARGEST or 1.0
        codes = (stacked / told["scale"]).astype("<f2")
    parts = np.frombuffer(codes.tobytes(), np.uint8).reshape(-1, 2)
    return told, parts[:, 0].tobytes() + parts[:, 1].tobytes()
