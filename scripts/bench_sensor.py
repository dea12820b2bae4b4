"""What the sensor model costs: megapixels per second per effect and for the whole chain.

Three chains in one run, taking turns so that a busy machine slows all alike: ours (exact Poisson), plain numpy
(Poisson, full well, normal read noise, gain, rounding), and getframes. What accuracy costs: `novags pareto sensor`.

    .venv/bin/python scripts/bench_sensor.py [--pixels 4000000] [--repeats 9]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sensor_model import (
    PRESETS,
    Banding,
    Defects,
    DualGain,
    Exposure,
    Sensor,
    SensorOptics,
    expose,
    plan_effects,
)

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
    print("\neach effect on its own, 20 e-: whole chain with it, Mpx/s, and its share, ns/px")
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pixels", type=int, default=4_000_000)
    parser.add_argument("--repeats", type=int, default=9)
    args = parser.parse_args()
    side = int(args.pixels**0.5)
    shape = (side, side)
    bench_chain(shape, args.repeats)
    bench_effects(shape, args.repeats)
    bench_plans((min(side, 1000),) * 2, min(args.repeats, 3))


if __name__ == "__main__":
    main()
