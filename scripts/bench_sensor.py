"""What the sensor model costs: megapixels per second per effect and for the whole chain, and what accuracy costs.

Three chains in one run, taking turns so that a busy machine slows all alike: ours (exact Poisson), plain numpy
(Poisson, full well, normal read noise, gain, rounding), and getframes. Tables go to standard output, cost curves as
JSON lines (knob, setting, seconds per megapixel, error, error_unit, error_sd, default) to --out.

    .venv/bin/python scripts/bench_sensor.py [--pixels 4000000] [--repeats 9] [--out FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sensor_model import (
    PRESETS,
    Banding,
    Defects,
    DualGain,
    Exposure,
    Sensor,
    SensorOptics,
    develop_linear,
    expose,
    photons_for_electrons,
    plan_effects,
)
from sensor_model import mosaic as filter_array
from sensor_model.plan import Plan

LEVELS = (2.0, 20.0, 200.0, 2000.0)
PLAN_LEVELS = (0.5, 2.0, 10.0, 50.0, 500.0)
EXPOSURE = Exposure(time=0.05)
PLAIN = Sensor(gain=1.6, eta=0.9, mu_e_sat=9458.0, black_level=240.0, bits=14, sigma_d=2.0, cfa=None)
EFFECTS: dict[str, dict] = {
    "prnu": {"prnu": 0.01},
    "dsnu": {"dsnu": 2.0},
    "read_tails": {"tukey_lambda": -0.07},
    "row_noise": {"sigma_row": 0.5},
    "column_noise": {"sigma_column": 0.5},
    "banding": {"banding": Banding(amplitude=1.0, period=20)},
    "dark_current": {"dark_current": 20.0},
    "hot_pixels": {"dark_current": 20.0, "defects": Defects(hot_fraction=1e-4, hot_factor=100)},
    "telegraph_noise": {"defects": Defects(rts_fraction=0.01, rts_factor=2.7)},
    "several_traps": {"defects": Defects(rts_fraction=0.01, rts_factor=2.7, rts_traps=3)},
    "nonlinearity": {"nonlinearity": 0.02},
    "black_bias": {"rgb_bias": (1.0, 1.0, 1.0)},
    "dual_gain": {"dual_gain": DualGain(threshold=1000.0, sigma_d=9.0, ratio=8.0)},
    "vignetting": {"optics": SensorOptics(corner_angle=30)},
    "crosstalk": {"optics": SensorOptics(crosstalk=0.02)},
    "point_spread": {"optics": SensorOptics(psf=((0.01, 0.03, 0.01), (0.03, 0.84, 0.03), (0.01, 0.03, 0.01)))},
    "coupling": {"coupling": 0.01},
    "blooming": {"blooming": True},
}


def fastest(calls: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Shortest time of each call, s; the calls take turns."""
    for call in calls:
        call()  # compiles, and fills the caches of the fixed pattern
    times = np.zeros((repeats, len(calls)))
    for i in range(repeats):
        for j, call in enumerate(calls):
            start = time.perf_counter()
            call()
            times[i, j] = time.perf_counter() - start
    return list(times.min(0))


def numpy_chain(photons: np.ndarray, s: Sensor, rng: np.random.Generator) -> np.ndarray:
    """The textbook chain as everybody writes it."""
    charge = np.minimum(rng.poisson(photons * s.eta), s.mu_e_sat)
    signal = charge + rng.normal(0.0, s.sigma_d, charge.shape)
    return np.clip(np.rint(s.gain * signal + s.black_level), 0, s.max_dn).astype(np.uint16)


def getframes_chain(shape: tuple[int, int], s: Sensor) -> Callable[[np.ndarray], object] | None:
    """The same camera in getframes, or None if it is not installed."""
    try:
        import getframes
    except ImportError:
        return None  # a peer to compare with, not a part of novags: its columns stay empty
    config = getframes.CameraConfig(
        name="bench", sensor_type="CMOS", resolution=shape, pixel_size_um=3.0, quantum_efficiency=s.eta,
        full_well_e=s.mu_e_sat, bit_depth=s.bits, gain_e_per_adu=1 / s.gain, bias_offset_adu=s.black_level,
        read_noise_e=s.sigma_d, dark_current_e_per_s=0.0,
    )  # fmt: skip
    camera = getframes.Camera(config)
    return lambda photons: camera.expose(photons, 1.0, 20.0, seed=1, include_truth=False)


def bench_chain(shape: tuple[int, int], repeats: int) -> None:
    rng, theirs = np.random.default_rng(0), getframes_chain(shape, PLAIN)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    print(f"whole chain, Mpx/s, {cores} cores, {shape[0]} x {shape[1]}; ratios to ours on all cores")
    print(f"{'e-':>6} {'ours':>7} {'1 core':>7} {'normal':>7} {'numpy':>7} {'ratio':>6} {'getframes':>9} {'ratio':>6}")
    for level in LEVELS:
        light = np.full(shape, level / PLAIN.eta)
        calls = [
            lambda light=light: expose(light, PLAIN, EXPOSURE, seed=1, view=0),
            lambda light=light: expose(light, PLAIN, EXPOSURE, seed=1, view=0, threads=1),
            lambda light=light: expose(light, PLAIN, EXPOSURE, seed=1, view=0, shot="normal"),
            lambda light=light: numpy_chain(light, PLAIN, rng),
        ]
        if theirs:
            calls.append(lambda light=light: theirs(light))
        speed = [light.size / 1e6 / t for t in fastest(calls, repeats)] + ([] if theirs else [np.nan])
        ours, single, normal, plain, other = speed
        row = f"{level:6g} {ours:7.1f} {single:7.1f} {normal:7.1f} {plain:7.1f} {ours / plain:6.2f}"
        print(f"{row} {other:9.1f} {ours / other:6.2f}")


def bench_effects(shape: tuple[int, int], repeats: int) -> None:
    light = np.full(shape, 20 / PLAIN.eta)
    sensors = {"plain chain": PLAIN} | {name: replace(PLAIN, **fields) for name, fields in EFFECTS.items()}
    calls = [lambda s=s: expose(light, s, EXPOSURE, seed=1, view=0) for s in sensors.values()]
    times = fastest(calls, repeats)
    print("\neach effect on its own, 20 e-: whole chain with it, Mpx/s, and what it adds, ns/px")
    for name, t in zip(sensors, times, strict=True):
        print(f"{name:>16} {light.size / 1e6 / t:8.1f} {(t - times[0]) / light.size * 1e9:8.2f}")


def bench_plans(shape: tuple[int, int], repeats: int) -> None:
    """All presets at all levels: what a plan saves, and that its error stays below its bound."""
    print("\nplanned against everything on, tolerance 5 %: time saved, and the error that the bound promises")
    print(f"{'camera':>15} {'e-':>5} {'all ms':>8} {'plan ms':>8} {'saved':>6} {'error':>8} {'bound':>8}")
    times, worst = [], 0.0
    for name in (name for name in PRESETS if not name.endswith("-3chip")):
        sensor = PRESETS[name]
        for level in PLAN_LEVELS:
            light = np.full(shape, level / sensor.eta)
            plan = plan_effects(sensor, EXPOSURE, level, 0.05)
            both = [lambda p=p, s=sensor, x=light: expose(x, s, EXPOSURE, seed=1, view=0, plan=p) for p in (None, plan)]
            whole, planned = fastest(both, repeats)
            sds = [call().dn.std() for call in both]
            error = abs(sds[0] / sds[1] - 1) if sds[1] else 0.0
            times.append((whole, planned))
            worst = max(worst, error - plan.bound)
            saved = f"{100 * (1 - planned / whole):5.0f}%"
            row = f"{name:>15} {level:5g} {1e3 * whole:8.2f} {1e3 * planned:8.2f} {saved}"
            print(f"{row} {error:8.5f} {plan.bound:8.5f}")
    whole, planned = np.sum(times, axis=0)
    print(f"together: {100 * (1 - planned / whole):.0f} % of the time saved; largest error less bound {worst:.5f}")


def kolmogorov(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference of the distribution functions of two integer samples."""
    top = int(max(a.max(), b.max())) + 1
    counts = [np.bincount(x.ravel(), minlength=top).cumsum() / x.size for x in (a, b)]
    return float(np.abs(counts[0] - counts[1]).max())


def point(
    knob: str,
    setting: str,
    take: Callable[[int], np.ndarray],
    error: Callable[[np.ndarray, int], float],
    unit: str,
    *,
    pixels: int,
    repeats: int,
    default: bool,
) -> dict:
    """One point of a cost curve: take(seed) is timed, error(its result, seed) is averaged over three seeds."""
    errors = [error(take(seed), seed) for seed in range(3)]
    return {
        "knob": f"sensor.{knob}",
        "setting": setting,
        "seconds": round(fastest([lambda: take(0)], repeats)[0] / pixels * 1e6, 6),
        "error": float(np.mean(errors)),
        "error_unit": unit,
        "error_sd": float(np.std(errors, ddof=1)),
        "default": default,
    }


def curve_shot(shape: tuple[int, int], repeats: int) -> list[dict]:
    """Normal for Poisson. Error: Kolmogorov distance of the codes to those of exact frames with other seeds."""
    lines = []
    for level in (0.5, *LEVELS):
        light = np.full(shape, level / PLAIN.eta)
        exact = [expose(light, PLAIN, EXPOSURE, seed=10 + s, view=0).dn for s in range(3)]
        for shot in ("poisson", "normal"):

            def take(seed: int, shot: str = shot, light: np.ndarray = light) -> np.ndarray:
                return expose(light, PLAIN, EXPOSURE, seed=seed, view=0, shot=shot).dn

            def error(dn: np.ndarray, seed: int, exact: list[np.ndarray] = exact) -> float:
                return kolmogorov(dn, exact[seed])

            unit, size = "Kolmogorov distance of codes", {"pixels": light.size, "repeats": repeats}
            lines.append(point("shot", f"{shot} {level:g} e-", take, error, unit, **size, default=shot == "poisson"))
    return lines


def curve_light(shape: tuple[int, int], repeats: int) -> list[dict]:
    """Width of the light that is read. Error against float64 light."""
    light = np.random.default_rng(0).uniform(0, 200, shape)
    exact = [expose(light, PLAIN, EXPOSURE, seed=s, view=0).dn.astype(int) for s in range(3)]
    lines = []
    for name in ("float64", "float32"):
        narrow = light.astype(name)

        def take(seed: int, narrow: np.ndarray = narrow) -> np.ndarray:
            return expose(narrow, PLAIN, EXPOSURE, seed=seed, view=0).dn

        def error(dn: np.ndarray, seed: int) -> float:
            return float(np.abs(dn - exact[seed]).mean())

        size = {"pixels": light.size, "repeats": repeats}
        lines.append(point("light", name, take, error, "mean |DN|", **size, default=name == "float64"))
    return lines


def curve_precision(shape: tuple[int, int], repeats: int) -> list[dict]:
    """Width of the arithmetic. Error: share of the codes that differ from those of float64, all by one."""
    light = np.random.default_rng(0).uniform(0, 200, shape)
    exact = [expose(light, PLAIN, EXPOSURE, seed=s, view=0).dn for s in range(3)]
    lines = []
    for precision in ("float64", "float32"):

        def take(seed: int, precision: str = precision) -> np.ndarray:
            return expose(light, PLAIN, EXPOSURE, seed=seed, view=0, precision=precision).dn

        def error(dn: np.ndarray, seed: int) -> float:
            return float(np.count_nonzero(dn != exact[seed]) / dn.size)

        size = {"pixels": light.size, "repeats": repeats}
        lines.append(
            point("precision", precision, take, error, "share of codes", **size, default=precision == "float64")
        )
    return lines


def curve_plan(shape: tuple[int, int], repeats: int) -> list[dict]:
    """Tolerance of the plan. Error: relative standard deviation of the frame."""
    sensor, lines = PRESETS["imx900-lcg"], []
    light = np.full(shape, 20 / sensor.eta)
    whole = [expose(light, sensor, EXPOSURE, seed=s, view=0).dn.std() for s in range(3)]
    for tolerance in (None, 0.01, 0.05, 0.2):
        plan = None if tolerance is None else plan_effects(sensor, EXPOSURE, 20.0, tolerance)

        def take(seed: int, plan: Plan | None = plan) -> np.ndarray:
            return expose(light, sensor, EXPOSURE, seed=seed, view=0, plan=plan).dn

        def error(dn: np.ndarray, seed: int) -> float:
            return abs(float(whole[seed] / dn.std()) - 1)

        setting = "everything" if tolerance is None else f"tolerance {tolerance:g}"
        size = {"pixels": light.size, "repeats": repeats}
        lines.append(point("plan", setting, take, error, "relative sd", **size, default=tolerance is None))
    return lines


def curve_demosaic(side: int, repeats: int) -> list[dict]:
    """Demosaicing a fine texture, 50 e-, noise-free. Error: root mean square against three chips."""
    y, x = np.mgrid[0:side, 0:side][..., None]
    rng = np.random.default_rng(0)
    sensor, chips, lines = PRESETS["imx900-hcg"], PRESETS["imx900-hcg-3chip"], []
    mosaics, truths = [], []
    for _ in range(3):
        texture = 1 + 0.5 * np.sin(x * rng.uniform(0.1, 0.6) + y * rng.uniform(-0.6, 0.6) + rng.uniform(0, 1, 3))
        photons = photons_for_electrons(texture, electrons=50, mean_green=1.0, sensor=sensor)
        mosaics.append(expose(filter_array(photons, "RGGB"), sensor, EXPOSURE, seed=0, view=0).clean_dn)
        truths.append(develop_linear(expose(photons, chips, EXPOSURE, seed=0, view=0).clean_dn, chips))
    for method in ("menon", "malvar", "bilinear", "half"):

        def take(seed: int, method: str = method) -> np.ndarray:
            return develop_linear(mosaics[seed], sensor, demosaic=method)

        def error(found: np.ndarray, seed: int) -> float:
            cells = side // found.shape[0]
            truth = truths[seed].reshape(found.shape[0], cells, found.shape[1], cells, 3).mean((1, 3))
            return float(np.sqrt(((found - truth) ** 2).mean()) * sensor.capacity_e)

        size = {"pixels": side * side, "repeats": repeats}
        lines.append(point("demosaic", method, take, error, "e- rms", **size, default=method == "menon"))
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pixels", type=int, default=4_000_000)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--out", type=Path, help="append the cost curves to this file instead of printing them")
    args = parser.parse_args()
    side = int(args.pixels**0.5)
    shape = (side, side)
    bench_chain(shape, args.repeats)
    bench_effects(shape, args.repeats)
    bench_plans((min(side, 1000),) * 2, min(args.repeats, 3))
    curves = [f for curve in (curve_shot, curve_light, curve_precision, curve_plan) for f in curve(shape, args.repeats)]
    curves += curve_demosaic(min(side, 512), args.repeats)
    text = "\n".join(map(json.dumps, curves))
    if args.out:
        with args.out.open("a", encoding="utf-8") as file:
            file.write(text + "\n")
    else:
        print("\n" + text)


if __name__ == "__main__":
    main()
