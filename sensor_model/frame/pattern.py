"""The fixed pattern of one camera: the same for every view, frame and seed, and for every crop of the sensor.

Maps are cached, because a camera keeps its pattern over all views, and read-only.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sensor_model import effects
from sensor_model.frame import streams
from sensor_model.params import Sensor, SensorOptics

Shape = tuple[int, ...]
Sites = tuple[NDArray[np.intp], ...]  # indices of the affected pixels, as numpy.nonzero gives them


@lru_cache(maxsize=4)
def response_map(serial: int, prnu: float, shape: Shape, origin: tuple[int, int]) -> NDArray[np.float32]:
    """Relative response of each pixel (PRNU), 1 on average."""
    return _frozen(effects.pixel_response(_normal(serial, shape, origin, streams.PRNU), prnu))


@lru_cache(maxsize=4)
def offset_map(serial: int, dsnu: float, shape: Shape, origin: tuple[int, int]) -> NDArray[np.float32]:
    """Dark offset of each pixel (DSNU), 0 on average, e-.

    An offset of the readout: signed, and without shot noise of its own. At the short exposures of a photograph, the
    dark non-uniformity in an EMVA 1288 report comes from it.
    """
    return _frozen(dsnu * _normal(serial, shape, origin, streams.DSNU))


@lru_cache(maxsize=8)
def sites(serial: int, fraction: float, shape: Shape, origin: tuple[int, int], stream: int) -> Sites:
    """Which pixels have a defect: each with the same probability."""
    draws = streams.Draws(seed=serial, origin=origin)
    return np.nonzero(draws.uniforms(shape, stream) < fraction)


@lru_cache(maxsize=4)
def illumination_map(optics: SensorOptics, shape: tuple[int, int], origin: tuple[int, int]) -> NDArray[np.float32]:
    """Relative illumination of each pixel [h, w]; cached, because the lens does not change either."""
    map_ = effects.relative_illumination(
        shape,
        origin=origin,
        sensor_shape=optics.sensor_shape,
        corner_angle=optics.corner_angle,
        falloff=optics.falloff,
    )
    return _frozen(map_)


def telegraph_sites(sensor: Sensor, shape: Shape, origin: tuple[int, int]) -> Sites | None:
    """Pixels with random telegraph noise; None if the camera does not have any."""
    d = sensor.defects
    if d is None or d.rts_fraction == 0 or d.rts_factor == 1 or sensor.sigma_d == 0:
        return None
    return sites(sensor.serial, d.rts_fraction, shape, origin, streams.RTS_SITE)


def dark_map(sensor: Sensor, dark_e: float, shape: Shape, origin: tuple[int, int]) -> NDArray[np.float32] | None:
    """Mean dark charge of each pixel where hot ones differ from the rest, or None if all are alike. e-."""
    d = sensor.defects
    if d is None or d.hot_fraction == 0 or d.hot_factor == 1 or dark_e == 0:
        return None
    dark = np.full(shape, dark_e)
    dark[sites(sensor.serial, d.hot_fraction, shape, origin, streams.HOT)] *= d.hot_factor
    return _frozen(dark)


def _normal(serial: int, shape: Shape, origin: tuple[int, int], stream: int) -> NDArray[np.float64]:
    from sensor_model.fast.blocks import standard_normals  # imports numba

    return standard_normals(streams.Draws(seed=serial, origin=origin), shape, stream)


def _frozen(values: NDArray) -> NDArray[np.float32]:
    out = values.astype(np.float32)
    out.flags.writeable = False
    return out
