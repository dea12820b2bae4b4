"""The surroundings of the pixel noise of one frame: optics, fixed pattern, row and column noise, black level."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sensor_model import effects
from sensor_model.frame import own, pattern, streams
from sensor_model.frame.measured import WITHOUT, Measured, cut
from sensor_model.mosaicking import channel_index
from sensor_model.params import LARGEST, Exposure, Sensor, require

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """Everything that one frame is computed from; [h, w, c] with c = 1 or 3."""

    sensor: Sensor
    exposure: Exposure
    draws: streams.Draws
    light: NDArray  # mean photons on each photodiode [h, w, c]
    response: NDArray[np.float32] | None  # PRNU [h, w, c]
    dark_e: float  # mean dark charge, e-
    dark: NDArray[np.float32] | None  # the same per pixel if hot ones differ [h, w, c], e-
    offset: NDArray[np.float32] | None  # DSNU and this frame's telegraph noise [h, w, c], e-
    rows: Array  # this frame's row noise and banding [h, c], e-
    columns: Array  # this frame's column noise [w, c], e-
    black: Array  # black level of each place in the 2 x 2 pattern [2, 2, c], DN
    cap: float  # `charge_cap`, e-
    variance: Array | None = None  # of dark frames [h, w, c], e-**2: of all there is without light but shot noise

    @property
    def mean_charge(self) -> Array:
        """Expected charge of each pixel before full well, e-."""
        response = 1.0 if self.response is None else self.response.astype(np.float64)
        dark = self.dark_e if self.dark is None else self.dark.astype(np.float64)
        with np.errstate(over="ignore"):  # an overflow to infinity is as full as the cap
            mu_e = effects.collect(self.light.astype(np.float64), eta=self.sensor.eta, response=response, dark_e=dark)
        return np.minimum(mu_e, self.cap)

    @property
    def black_dn(self) -> Array:
        """Black level of every pixel [h, w, c], DN."""
        h, w = self.light.shape[:2]
        return self.black[np.arange(h)[:, None] % 2, np.arange(w)[None, :] % 2]


def prepare(
    photons: NDArray,
    sensor: Sensor,
    exposure: Exposure,
    draws: streams.Draws,
    *,
    noise: bool = True,
    measured: Measured | None = None,
) -> Prepared:
    """Everything but the noise of single pixels; `noise=False` also leaves out row, column and telegraph noise.

    Dark frames are an offset of each pixel, and the camera is one without the effects in them.
    """
    measured = measured or Measured()
    frames, cap = measured.dark, charge_cap(sensor, exposure)
    s = sensor if frames is None else replace(sensor, **WITHOUT)
    light = on_sensor(as_channels(photons), s, exposure)
    draws.check_extent(light.shape)
    dark_e, where = s.dark_e(exposure), (light.shape, exposure.origin)
    h, w, channels = light.shape
    offset, response = (
        _frozen(cut(given, *where)) if given is not None else drawn(s.serial, amount, *where) if amount else None
        for amount, given, drawn in (
            (s.dsnu, measured.offset, pattern.offset_map), (s.prnu, measured.response, pattern.response_map),
        )
    )  # fmt: skip
    if frames is not None:
        offset = _frozen(frames.drawn(draws, light.shape) if noise else cut(frames.mean, *where))
    return Prepared(
        sensor=s,
        exposure=exposure,
        draws=draws,
        light=light,
        response=response,
        dark_e=dark_e,
        dark=pattern.dark_map(s, dark_e, *where),
        offset=_with_telegraph(offset, s, draws, *where) if noise else offset,
        rows=_rows(s, draws, h, channels) if noise else np.zeros((h, channels)),
        columns=_columns(s, draws, w, channels) if noise else np.zeros((w, channels)),
        black=_black(s, channels),
        cap=cap,
        variance=None if frames is None else cut(frames.variance, *where),
    )


def _frozen(values: NDArray) -> NDArray[np.float32]:
    """As the maps of `pattern` are: numba compiles once more for writable arrays."""
    out = np.array(values, np.float32)
    out.flags.writeable = False
    return out


def on_sensor(light: NDArray, sensor: Sensor, exposure: Exposure) -> NDArray:
    """The light after the optics, [h, w, c]."""
    o = sensor.optics
    if o is None:
        return light
    if o.corner_angle or o.falloff:
        light = light * pattern.illumination_map(o, light.shape[:2], exposure.origin)[..., None]
    if o.psf:
        return effects.point_spread(light, o.psf)
    return effects.crosstalk(light, o.crosstalk) if o.crosstalk else light


def charge_cap(sensor: Sensor, exposure: Exposure) -> float:
    """A mean charge so far over saturation that every frame is full; keeps bright light within the Poisson sampler."""
    if sensor.blooming and np.isfinite(sensor.mu_e_sat):
        return streams.SIDE * sensor.mu_e_sat  # the excess goes elsewhere: enough to fill the longest column
    s = sensor
    read = s.sigma_d * (s.defects.rts_factor if s.defects else 1) + (s.dual_gain.sigma_d if s.dual_gain else 0)
    noise = read + s.sigma_row + s.sigma_column + s.dsnu + (s.banding.amplitude if s.banding else 0)
    lowest = min(-min(0.0, *s.rgb_bias) / s.gain, LARGEST)  # no light at all shows over a black that is lower yet
    top = s.capacity_e / (1 - s.nonlinearity) + 20 * noise + lowest + own.reach(s, exposure, s.capacity_e)
    return top + 10 * float(np.sqrt(top)) + 100


def _rows(s: Sensor, draws: streams.Draws, h: int, channels: int) -> Array:
    rows = np.zeros((h, channels))
    if s.sigma_row:
        rows += s.sigma_row * effects.standard_normal(draws.row_uniforms(h, channels, streams.ROW))
    if s.banding:
        phase = replace(draws, origin=(0, 0)).uniforms((1, 1), streams.BANDING)  # one phase for the whole sensor
        rows += effects.bands(phase, np.arange(h)[:, None] + draws.origin[0], s.banding)
    return rows


def _columns(s: Sensor, draws: streams.Draws, w: int, channels: int) -> Array:
    if not s.sigma_column:
        return np.zeros((w, channels))
    return s.sigma_column * effects.standard_normal(draws.column_uniforms(w, channels, streams.COLUMN))


def _black(s: Sensor, channels: int) -> Array:
    bias = np.asarray(s.rgb_bias)
    if s.cfa:
        return s.black_level + bias[channel_index((2, 2), s.cfa)][..., None]
    return s.black_level + np.tile(bias if channels == 3 else bias[1:2], (2, 2, 1))


def _with_telegraph(
    offset: NDArray[np.float32] | None, s: Sensor, draws: streams.Draws, shape: tuple[int, ...], origin: tuple[int, int]
) -> NDArray[np.float32] | None:
    sites = pattern.telegraph_sites(s, shape, origin)
    if sites is None or s.defects is None:
        return offset
    offset = np.zeros(shape, np.float32) if offset is None else offset.copy()
    traps = s.defects.rts_traps
    level = effects.telegraph_level(s.sigma_d, s.defects.rts_factor, traps)
    offset[sites] += effects.telegraph(draws.uniforms_at(streams.RTS, *sites), level, traps).astype(np.float32)
    offset.flags.writeable = False
    return offset


def as_channels(photons: NDArray) -> NDArray:
    """[h, w] -> [h, w, 1]; [h, w, 3] stays."""
    return photons[..., None] if photons.ndim == 2 else photons


def checked(photons: ArrayLike, sensor: Sensor) -> NDArray:
    """The photons as an array of a type and shape the chain takes, or ValueError; their values are tested in it."""
    array = np.asarray(photons)
    require(array.dtype.kind in "fiu", "photons", "real numbers", array.dtype)
    fits = array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3 and sensor.cfa is None)
    rule = "[h, w]" if sensor.cfa else "[h, w] or [h, w, 3]"
    require(fits and array.size > 0, "photons", f"of shape {rule}", array.shape, "use mosaic() for a colour filter")
    return np.ascontiguousarray(array, array.dtype if array.dtype in (np.float32, np.float64) else np.float64)
