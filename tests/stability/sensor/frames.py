"""What the hard cases of the camera share: one frame of one camera, and whether two frames are the same."""

import numpy as np
from numpy.typing import NDArray

from sensor_model.capture import RawFrame, expose
from sensor_model.params import Exposure, Sensor
from tests.stability.case import Setting

BOTH = ("numpy", "numba")
EXPOSURE = Exposure(time=0.02)
CAMERA = Sensor(gain=2.0, eta=0.5, mu_e_sat=1800.0, black_level=64, bits=12, sigma_d=1.5, cfa=None)
DIFFER = "codes differ"


def frame(light: NDArray, camera: Sensor, setting: Setting, **how: object) -> RawFrame:
    """One frame in a setting."""
    known: dict = {"seed": 0, "view": 0, "threads": setting.threads, **how}
    return expose(light, camera, EXPOSURE, backend="numpy" if setting.backend == "numpy" else "numba", **known)


def differ(a: NDArray, b: NDArray) -> float:
    return float(np.count_nonzero(np.asarray(a, np.int64) != np.asarray(b, np.int64)))
