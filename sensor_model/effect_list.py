"""Every effect of the camera: where the parts of ours are, and effects from outside.

Names of functions are relative to this package. `novags new effect NAME` writes one from outside.
"""
# docs/adding-a-sensor-effect.md shows how to add one of either kind. tests/sensor_model/test_effect_list.py goes
# through our rows and fails if one of the parts is missing or disagrees with the others.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from sensor_model.files.registry import Registry

# Fields of `Sensor` that describe the camera itself: without them there would be no frame.
STRUCTURAL = ("gain", "eta", "black_level", "bits", "cfa", "rgb_response", "serial")
ELSEWHERE = ("effects",)  # the effects from outside, which have no field of their own
SHARED = "shared"  # the numba chain takes the result of the numpy code: a map, a line, or the whole charge


@dataclass(frozen=True, kw_only=True)
class EffectParts:
    """Where one effect is."""

    fields: tuple[str, ...]  # of `Sensor`, fields of its parts as "defects.hot_factor"; empty: it needs none
    sampled: str  # function that puts it into the frame
    moments: str  # function that puts it into the analytic mean and variance
    fused: str = SHARED  # function of the numba chain that does the same as `sampled`
    in_noise: bool = True  # part of `noise.NoiseCurve`; False for outliers, and for effects of saturated pixels alone


@dataclass(frozen=True, kw_only=True)
class OwnEffect:
    """One effect from outside: electrons that it adds to the signal of each pixel, between the read noise and the ADC.

    Its functions take `pixels`, a `frame.own.Pixels`, and `settings`, an instance of `config`; results may be of any
    shape that broadcasts to the signal's. What it adds may depend on the signal, and must not be correlated with the
    signal's noise. `novags.testing.assert_effect` holds the functions against each other.

    Attributes:
        title: One line, for lists and plans.
        config: Frozen dataclass of its settings, with defaults; the numbers in `[effects.NAME]` of a camera's file.
        sample: (signal, pixels, settings) -> electrons that it adds to this frame, whose signal is [h, w, c], e-.
        mean: (signal, pixels, settings) -> electrons that it adds on average over frames of this mean signal, e-.
        variance: (signal, pixels, settings) -> what it adds to the variance over frames, e-**2, finite and >= 0.
        cost: (signal, kept, exposure, settings) -> two numbers for each of some mean signals [n], e-, at which every
            plan keeps the variance `kept` [n], e-**2: the relative error of the standard deviation, and the error of
            the mean, e-, that leaving it out makes in the worst pixel at most.
    """

    title: str
    config: type[Any]
    sample: Callable[..., Any]
    mean: Callable[..., Any]
    variance: Callable[..., Any]
    cost: Callable[..., Any]


OURS: dict[str, str | EffectParts | OwnEffect] = {  # by the name that plans use, in the order of the signal chain
    "vignetting": EffectParts(
        fields=("optics.corner_angle", "optics.falloff", "optics.sensor_shape"),
        sampled="frame.pattern.illumination_map",
        moments="frame.prepare.on_sensor",
    ),
    "crosstalk": EffectParts(
        fields=("optics.crosstalk", "optics.psf"),
        sampled="frame.prepare.on_sensor",
        moments="frame.prepare.on_sensor",
    ),
    "prnu": EffectParts(fields=("prnu",), sampled="frame.pattern.response_map", moments="effects.collect"),
    "dark_current": EffectParts(
        fields=("dark_current", "dark_temperature", "dark_doubling"),
        sampled="params.Sensor.dark_e",
        moments="effects.collect",
        fused="fast.capture_fused._shoot",
    ),
    "hot_pixels": EffectParts(
        fields=("defects.hot_fraction", "defects.hot_factor"),
        sampled="frame.pattern.dark_map",
        moments="effects.collect",
        in_noise=False,
    ),
    "photon_shot": EffectParts(
        fields=(), sampled="effects.shot_noise", moments="moments.frame_moments", fused="fast.poisson.poisson"
    ),
    "poisson": EffectParts(
        fields=(), sampled="effects.shot_noise", moments="moments.integrated_moments", fused="fast.poisson.poisson"
    ),
    "full_well": EffectParts(
        fields=("mu_e_sat",),
        sampled="effects.full_well",
        moments="effects.full_well",
        fused="fast.capture_fused._codes",
        in_noise=False,
    ),
    "blooming": EffectParts(
        fields=("blooming",), sampled="effects.blooming", moments="frame.interpixel.bloomed", in_noise=False
    ),
    "coupling": EffectParts(
        fields=("coupling",), sampled="effects.crosstalk", moments="frame.interpixel.coupled_variance"
    ),
    "nonlinearity": EffectParts(
        fields=("nonlinearity",),
        sampled="effects.nonlinear",
        moments="moments.response_moments",
        fused="fast.capture_fused._codes",
    ),
    "dual_gain": EffectParts(
        fields=("dual_gain.threshold", "dual_gain.sigma_d", "dual_gain.ratio"),
        sampled="effects.select_gain",
        moments="effects.select_gain",
        fused="fast.capture_fused._codes",
    ),
    "read_noise": EffectParts(
        fields=("sigma_d",),
        sampled="effects.read_noise",
        moments="moments.frame_moments",
        fused="fast.capture_fused._read_noise",
    ),
    "read_tails": EffectParts(
        fields=("tukey_lambda",),
        sampled="effects.tukey_quantile",
        moments="moments._normal_components",
        fused="fast.kernels.tukey",
    ),
    "telegraph_noise": EffectParts(
        fields=("defects.rts_fraction", "defects.rts_factor", "defects.rts_traps"),
        sampled="effects.telegraph",
        moments="moments.extra_variance",
        in_noise=False,
    ),
    "dsnu": EffectParts(fields=("dsnu",), sampled="frame.pattern.offset_map", moments="moments.frame_moments"),
    "row_noise": EffectParts(fields=("sigma_row",), sampled="frame.prepare._rows", moments="moments.extra_variance"),
    "column_noise": EffectParts(
        fields=("sigma_column",), sampled="frame.prepare._columns", moments="moments.extra_variance"
    ),
    "banding": EffectParts(
        fields=("banding.amplitude", "banding.period"), sampled="effects.bands", moments="moments.extra_variance"
    ),
    "black_bias": EffectParts(fields=("rgb_bias",), sampled="frame.prepare._black", moments="frame.prepare._black"),
}

EFFECT_LIST: Registry[EffectParts | OwnEffect] = Registry(OURS, "novags.effects", OwnEffect)
