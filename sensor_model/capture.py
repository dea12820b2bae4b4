"""One exposure, from light to codes in physical order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sensor_model import effects
from sensor_model.frame import own, streams
from sensor_model.frame.measured import Measured
from sensor_model.frame.prepare import Prepared, as_channels, checked, on_sensor, prepare
from sensor_model.moments import burst_moments, frame_moments
from sensor_model.params import Exposure, Sensor, require
from sensor_model.plan import Plan
from sensor_model.planner import simplify
from sensor_model.radiometry import check_light

Array = NDArray[np.float64]
Shot = Literal["poisson", "normal", "none"]
Backend = Literal["numba", "numpy"]
Precision = Literal["float64", "float32"]


@dataclass(frozen=True)
class RawFrame:
    """Digital numbers of one exposure; the analytic maps are computed when first asked for."""

    dn: NDArray[np.uint16]  # [h, w] or [h, w, 3]
    saturated: NDArray[np.bool_]  # this exposure, or one of a burst, reached the full well or the top of the ADC here
    photons: NDArray  # the light that was exposed
    sensor: Sensor  # as simulated: without effects that the plan left out
    exposure: Exposure
    shot: Shot = "poisson"
    measured: Measured | None = None
    frames: int = 1  # that `dn` is the rounded mean of
    times: float = 1.0  # its exposure over one that is common to several views

    @cached_property
    def _moments(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        draws = streams.Draws(seed=0, origin=self.exposure.origin)
        inputs = prepare(self.photons, self.sensor, self.exposure, draws, noise=False, measured=self.measured)
        mean, variance = frame_moments(inputs, self.shot)
        if self.frames > 1:
            mean, variance = burst_moments(mean, variance, self.frames)
        shape = self.photons.shape
        return mean.reshape(shape).astype(np.float32), variance.reshape(shape).astype(np.float32)

    @property
    def mean_dn(self) -> NDArray[np.float32]:
        """Mean over all frames of this light by this camera: with its fixed pattern, clipping included. DN."""
        return self._moments[0]

    @property
    def variance_dn(self) -> NDArray[np.float32]:
        """Temporal variance of each pixel, clipping and rounding included; of a burst, of its mean. DN**2."""
        return self._moments[1]

    @cached_property
    def clean_dn(self) -> NDArray[np.float32]:
        """The common exposure of the same light without noise and fixed pattern; saturates, is not rounded. DN."""
        common = replace(self.exposure, time=self.exposure.time / self.times)
        return clean_response(self.photons / self.times, self.sensor, common)


def clean_response(photons: ArrayLike, sensor: Sensor, exposure: Exposure) -> NDArray[np.float32]:
    """The mean response to light, without noise, fixed pattern, effects from outside and rounding; it saturates.

    Args:
        photons: As for `expose`; [h, w, 3] needs a sensor without colour filter array.
        sensor: The camera.
        exposure: How it is used.

    Returns:
        The shape of `photons`, DN.

    Raises:
        ValueError: if the photons are of the wrong shape, or NaN, infinite or negative anywhere.
    """
    photons, s = checked(photons, sensor), sensor
    check_light(photons, "photons")
    light = on_sensor(as_channels(photons), s, exposure).astype(np.float64)
    charge = effects.collect(light, eta=s.eta, response=1.0, dark_e=s.dark_e(exposure))
    held = effects.blooming(charge, s.mu_e_sat) if s.blooming else effects.full_well(charge, s.mu_e_sat)
    signal = effects.nonlinear(effects.crosstalk(held, s.coupling) if s.coupling else held, s.droop)
    clean = np.minimum(s.gain * signal + s.black_level, s.white_dn)
    return clean.reshape(photons.shape).astype(np.float32)


def expose(
    photons: ArrayLike,
    sensor: Sensor,
    exposure: Exposure,
    *,
    seed: int,
    view: int,
    frame: int = 0,
    plan: Plan | None = None,
    shot: Shot = "poisson",
    backend: Backend = "numba",
    precision: Precision = "float64",
    threads: int | None = None,
    measured: Measured | None = None,
) -> RawFrame:
    """Take one frame.

    Args:
        photons: Mean photons per pixel over the exposure, behind the colour filter, finite and >= 0: [h, w] for a
            mosaic or monochrome sensor, [h, w, 3] for three chips (`cfa=None`).
        sensor: The camera.
        exposure: How it is used.
        seed: With `view` and `frame` it fixes the temporal noise; the fixed pattern follows from `sensor.serial`.
        view: Which camera position this is, 0..2**32-1.
        frame: Which frame of that position, 0..2**32-1.
        plan: Effects to leave out, from `plan_effects`; None simulates all. The others keep their draws.
        shot: "poisson" is exact; "normal" approximates large signals; "none" leaves shot noise out.
        backend: "numba" is fast, "numpy" the readable reference; both give the same frame. A camera with effects from
            outside takes the second.
        precision: "float64" uses float32 only where that gives the same codes; "float32" always does, and then up to
            one code in a million per DN of noise is off by one (Gaussian read noise, normal shot noise; "numba" only).
        threads: How many to use; None: one per core. The frame does not depend on it.
        measured: Maps and dark frames of this copy of the camera, in place of drawn numbers.

    Returns:
        The frame, with its analytic mean and variance.

    Raises:
        ValueError: if the photons are NaN, infinite or negative anywhere, or of the wrong shape.
    """
    require(shot in get_args(Shot), "shot", f"one of {get_args(Shot)}", shot)
    require(backend in get_args(Backend), "backend", f"one of {get_args(Backend)}", backend)
    require(precision in get_args(Precision), "precision", f"one of {get_args(Precision)}", precision)
    photons = checked(photons, sensor)
    s = simplify(sensor, plan)
    if s.effects:
        backend = "numpy"
    if backend == "numpy" or s.optics:  # otherwise the kernel tests the light while it reads it
        check_light(photons, "photons")
    if plan is not None:
        left_out = shot == "none" or not plan.is_on("photon_shot")
        shot = "none" if left_out else shot if plan.is_on("poisson") else "normal"
    draws = streams.Draws(seed=seed, view=view, frame=frame, origin=exposure.origin)
    inputs = prepare(photons, s, exposure, draws, measured=measured)
    if backend == "numpy":
        dn, saturated = read_out(collect_charge(inputs, shot), inputs)
    else:
        from sensor_model.fast import capture_fused as fused  # imports numba

        dn, saturated, bad = fused.capture(inputs, shot, precision, threads)
        if bad:
            check_light(photons, "photons")
    shape = photons.shape
    return RawFrame(dn.reshape(shape), saturated.reshape(shape), photons, s, exposure, shot, measured)


def expose_burst(photons: ArrayLike, sensor: Sensor, exposure: Exposure, *, frames: int, **how: Any) -> list[RawFrame]:
    """Several frames of one view, one after the other: the same light and fixed pattern, temporal noise of their own.

    Args:
        photons: As for `expose`: one light for all frames, or one per frame along a first axis of length `frames`.
            Without colour filter array, [n, h, 3] is always one light of three chips, not n frames that are 3 px wide.
        sensor: The camera.
        exposure: How each frame is taken.
        frames: How many; they are numbered from 0.
        how: The other arguments of `expose`.
    """
    require(frames >= 1, "frames", ">= 1", frames)
    light = np.asarray(photons)
    moving = light.ndim == 4 or (light.ndim == 3 and (sensor.cfa is not None or light.shape[2] != 3))
    require(not moving or light.shape[0] == frames, "photons", f"one light or {frames}", light.shape)
    return [expose(light[i] if moving else light, sensor, exposure, frame=i, **how) for i in range(frames)]


def mean_of(burst: Sequence[RawFrame]) -> RawFrame:
    """The mean of the frames of a burst, rounded to whole codes; one frame is itself.

    Temporal noise shrinks with the root of their number. The fixed pattern, which they share, stays.
    """
    if len(burst) == 1:
        return burst[0]
    dn = np.rint(sum(frame.dn.astype(np.float64) for frame in burst) / len(burst)).astype(np.uint16)
    saturated = np.logical_or.reduce([frame.saturated for frame in burst])
    return replace(burst[0], dn=dn, saturated=saturated, frames=len(burst))


def collect_charge(inputs: Prepared, shot: Shot) -> Array:
    """Light and dark signal -> the electrons of this exposure, before full well. e-."""
    mu_e = inputs.mean_charge
    if shot == "none":
        return mu_e
    sample = effects.shot_noise if shot == "poisson" else effects.normal_shot_noise
    return sample(inputs.draws.uniforms(mu_e.shape, streams.SHOT), mu_e)


def read_out(charge: Array, inputs: Prepared) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Electrons -> codes, and which pixels saturated."""
    s = inputs.sensor
    held = effects.blooming(charge, s.mu_e_sat) if s.blooming else effects.full_well(charge, s.mu_e_sat)
    full = held >= s.mu_e_sat
    held = effects.crosstalk(held, s.coupling) if s.coupling else held
    sigma_d, code_width = effects.select_gain(held, s.sigma_d, s.dual_gain)
    signal = effects.nonlinear(held, s.droop)
    signal = signal + effects.read_noise(inputs.draws.uniforms(held.shape, streams.READ), sigma_d, s.tukey_lambda)
    offset = 0.0 if inputs.offset is None else inputs.offset.astype(np.float64)
    signal = signal + ((inputs.rows[:, None] + inputs.columns[None, :]) + offset)
    if s.effects:
        signal = signal + own.added(signal, s, inputs.exposure, inputs.draws)
    dn = effects.digitise(s.gain * signal + inputs.black_dn, s.max_dn, code_width)
    return dn, full | (held >= s.mu_e_sat) | (dn == s.max_dn)
