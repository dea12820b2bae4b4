"""The knobs of the sensor model: shot noise, width of numbers, tolerance of the plan, demosaicing."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from novags.testbed.study.knobs.clock import fastest
from novags.testbed.study.knobs.knob import Knob, Reading, Setting, Subject
from sensor_model.capture import expose
from sensor_model.isp import develop_linear
from sensor_model.mosaicking import mosaic
from sensor_model.params import Exposure, Sensor
from sensor_model.planner import plan_effects
from sensor_model.presets import PRESETS
from sensor_model.radiometry import photons_for_electrons

DEMOSAIC_SIDE, CALLS = 512, 7
LEVELS = (0.5, 2.0, 20.0, 200.0, 2000.0)
EXPOSURE = Exposure(time=0.05)
PLAIN = Sensor(gain=1.6, eta=0.9, mu_e_sat=9458.0, black_level=240.0, bits=14, sigma_d=2.0, cfa=None)
CAMERA, PLAN_LEVEL = "imx900-lcg", 20.0
OTHER = 1000  # seeds of the frames that are compared with

Image = np.ndarray


def sensor(side: int) -> Subject:
    """One frame of side x side pixels each."""
    fine = min(side, DEMOSAIC_SIDE)
    knobs = (*(_shot(level, side) for level in LEVELS), _light(side), _precision(side), _plan(side), _demosaic(fine))
    workload = {"frame": f"{side} x {side}", "demosaicing": f"{fine} x {fine}"}
    return Subject("sensor", workload, knobs, (__name__,))


def _timed(take: Callable[[], Any], error: Callable[[Any], float], pixels: int) -> Reading:
    """Seconds per megapixel of `take`, and the error of its result."""
    found = error(take())
    wall, cpu = fastest(take, CALLS)
    return Reading(wall / pixels * 1e6, cpu / pixels * 1e6, found)


def kolmogorov(a: Image, b: Image) -> float:
    """Largest difference of the distribution functions of two integer samples."""
    top = int(max(a.max(), b.max())) + 1
    counts = [np.bincount(x.ravel(), minlength=top).cumsum() / x.size for x in (a, b)]
    return float(np.abs(counts[0] - counts[1]).max())


def _knob(name: str, settings: tuple[Setting, ...], default: Setting, unit: str, why: str, measure: Any) -> Knob:
    return Knob(
        name=name, settings=settings, default=default, unit=unit, of="a megapixel", why=why,
        measure=lambda setting, seed, captured: measure(setting, seed),
    )  # fmt: skip


def _shot(level: float, side: int) -> Knob:
    """Normal for Poisson. Error: Kolmogorov distance of the codes to the codes of exact frames with other seeds."""
    light = np.full((side, side), level / PLAIN.eta)

    def measured(shot: Any, seed: int) -> Reading:
        exact = expose(light, PLAIN, EXPOSURE, seed=OTHER + seed, view=0).dn
        return _timed(
            lambda: expose(light, PLAIN, EXPOSURE, seed=seed, view=0, shot=shot).dn,
            lambda dn: kolmogorov(dn, exact), light.size,
        )  # fmt: skip

    why = "exact at every level, and light is scarce here; the rest of its error is the distance of any two samples"
    unit = "Kolmogorov distance of codes"
    return _knob(f"shot noise at {level:g} e-", ("normal", "poisson"), "poisson", unit, why, measured)


def _random_light(side: int) -> Image:
    return np.random.default_rng(0).uniform(0, 200, (side, side))


def _light(side: int) -> Knob:
    """Width of the light that is read. Error against float64 light."""
    light = _random_light(side)

    def measured(name: Any, seed: int) -> Reading:
        exact, narrow = expose(light, PLAIN, EXPOSURE, seed=seed, view=0).dn.astype(int), light.astype(name)
        return _timed(
            lambda: expose(narrow, PLAIN, EXPOSURE, seed=seed, view=0).dn,
            lambda dn: float(np.abs(dn - exact).mean()), light.size,
        )  # fmt: skip

    why = "renders are float32 files and are not converted; arrays of float64 are not narrowed"
    return _knob("light", ("float32", "float64"), "float64", "mean |DN|", why, measured)


def _precision(side: int) -> Knob:
    """Width of the arithmetic. Error: share of the codes that differ from float64's, all by one."""
    light = _random_light(side)

    def measured(precision: Any, seed: int) -> Reading:
        exact = expose(light, PLAIN, EXPOSURE, seed=seed, view=0).dn
        return _timed(
            lambda: expose(light, PLAIN, EXPOSURE, seed=seed, view=0, precision=precision).dn,
            lambda dn: float(np.count_nonzero(dn != exact) / dn.size), light.size,
        )  # fmt: skip

    why = "takes float32 by itself where that provably gives the same codes"
    return _knob("precision", ("float32", "float64"), "float64", "share of codes", why, measured)


def _plan(side: int) -> Knob:
    """Tolerance of the plan; none simulates everything. Error: relative standard deviation of the frame."""
    camera = PRESETS[CAMERA]
    light = np.full((side, side), PLAN_LEVEL / camera.eta)

    def measured(tolerance: Any, seed: int) -> Reading:
        whole = expose(light, camera, EXPOSURE, seed=seed, view=0).dn.std()
        plan = None if tolerance is None else plan_effects(camera, EXPOSURE, PLAN_LEVEL, tolerance)
        return _timed(
            lambda: expose(light, camera, EXPOSURE, seed=seed, view=0, plan=plan).dn,
            lambda dn: abs(float(whole / dn.std()) - 1), light.size,
        )  # fmt: skip

    why = f"{CAMERA} at {PLAN_LEVEL:g} e-; a capture leaves out what changes the noise by less than a twentieth"
    return _knob("plan's tolerance", (0.2, 0.05, 0.01, None), 0.05, "relative sd of the frame", why, measured)


def _demosaic(side: int) -> Knob:
    """Demosaicing a fine texture, 50 e-, noise-free. Error: root mean square against three chips."""
    camera, chips = PRESETS["imx900-hcg"], PRESETS["imx900-hcg-3chip"]

    @cache
    def pair(seed: int) -> tuple[Image, Image]:
        y, x = np.mgrid[0:side, 0:side][..., None]
        rng = np.random.default_rng(seed)
        texture = 1 + 0.5 * np.sin(x * rng.uniform(0.1, 0.6) + y * rng.uniform(-0.6, 0.6) + rng.uniform(0, 1, 3))
        photons = photons_for_electrons(texture, electrons=50, mean_green=1.0, sensor=camera)
        seen = expose(mosaic(photons, "RGGB"), camera, EXPOSURE, seed=0, view=0).clean_dn
        return seen, develop_linear(expose(photons, chips, EXPOSURE, seed=0, view=0).clean_dn, chips)

    def measured(method: Any, seed: int) -> Reading:
        seen, truth = pair(seed)

        def error(found: Image) -> float:
            cells = side // found.shape[0]
            same = truth.reshape(found.shape[0], cells, found.shape[1], cells, 3).mean((1, 3))
            return float(np.sqrt(((found - same) ** 2).mean()) * camera.capacity_e)

        return _timed(lambda: develop_linear(seen, camera, demosaic=method), error, side * side)

    why = "made for the edges of photographs, which these waves do not have; half gives pictures of half the size"
    return _knob("demosaicing", ("half", "bilinear", "malvar", "menon"), "menon", "e- rms", why, measured)
