"""The knobs of the splat engine. Each measurement is a process of its own: see `splat_engine`."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console
from novags.testbed.pareto.knob import Knob, Measured, Setting, Subject
from sensor_model.files.atomic import atomic
from sensor_model.files.own import cache_folder
from sensor_model.files.python import python
from sensor_model.files.reading import brief

COUNT, SIZE = 2000, 64
SMALL_COUNT, SMALL_SIZE = 500, 32
CHILD = "from novags.process import settle; settle(); from novags.testbed.pareto.splat_engine.child import main; main()"
# Settings from the fastest on, the default, and why.
KNOBS: dict[str, tuple[tuple[Setting, ...], Setting, str]] = {
    "alpha_min": (
        (8 / 255, 4 / 255, 2 / 255, 1 / 255, 1 / 765, 1 / 2550), 1 / 255,
        "an 8-bit step, as in 3DGS and gsplat, so that trained scenes look the same here and there",
    ),
    "transmittance_min": (
        (3e-2, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6), 1e-4, "as in 3DGS and gsplat; what lies behind adds less than this",
    ),
    "exp2_degree": ((2, 3, 4, 5), 5, "below float32 rounding: tests compare kernels with the reference that closely"),
    "eps2d": (
        (0.0, 0.1, 0.2, 0.3, 0.5), 0.3,
        "as in 3DGS and gsplat; small pictures want less, and the presets demo and small take 0.1",
    ),
    "float_bits": ((32, 64), 32, "its rounding errs far less than the thresholds do; only the slow reference has 64"),
    "backend": (("numba", "torch"), "numba", "the same picture up to rounding; torch is what it is tested against"),
    "tile": ((8, 16), 16, "the same picture; the faster of the two on pictures of the usual sizes"),
}  # fmt: skip


def splats(small: bool, folder: Path, console: Console) -> Subject:
    """Forward and backward passes over random Gaussians; truths are kept in `folder`."""
    n, size = (SMALL_COUNT, SMALL_SIZE) if small else (COUNT, SIZE)

    def knob(name: str) -> Knob:
        settings, default, why = KNOBS[name]
        ends = tuple(s for s in settings if s in (settings[0], default, settings[-1]))  # each compiles for a while

        def one(setting: Setting, seed: int) -> Measured:
            return measured(folder, name, setting, n, size, seed)

        return Knob(
            name=name, settings=ends if small else settings, default=default, unit="RMSE of the picture",
            of="a forward and a backward pass", why=why, measure=one,
            shared=None if name == "eps2d" else "a picture",
        )  # fmt: skip

    workload = {"Gaussians": n, "size": f"{size} x {size}", "harmonics": "degree 3"}
    return Subject("splats", workload, tuple(knob(name) for name in KNOBS))


def measured(folder: Path, knob: str, setting: Setting, n: int, size: int, seed: int) -> Measured:
    """One setting, against the truth of this seed, which is made first if it is not there."""
    supersampled = knob == "eps2d"  # dilation stands in for a filter over the pixel
    truth = folder / f"truth-{n}-{size}-{seed}{'-supersampled' if supersampled else ''}.npy"
    common = {"n": n, "size": size, "seed": seed}
    if not truth.exists():
        with atomic(truth) as file:
            make = {"do": "truth", "out": str(file), "supersampled": supersampled, **common}
            in_child(make, "default")
    changed = knob in ("alpha_min", "transmittance_min", "exp2_degree", "tile") and setting != KNOBS[knob][1]
    code = f"{knob}-{setting:.3g}" if changed else "default"
    order = {"do": "measure", "knob": knob, "setting": setting, "changed": changed, "truth": str(truth), **common}
    return Measured(**in_child(order, code))


def in_child(order: dict[str, Any], code: str) -> dict[str, Any]:
    """What the child process says.

    Args:
        order: What it has to do.
        code: Name of the folder for compiled kernels, in the user's own cache: machine code in the folder of the
            measurements would run whoever had made that folder.

    Raises:
        OSError: If it fails; with its last words.
    """
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache_folder("pareto") / code)}
    done = subprocess.run(python(CHILD, json.dumps(order)), capture_output=True, text=True, env=environment)
    if done.returncode:
        words = done.stderr.strip().splitlines() or ["no message"]
        raise OSError(f"measuring {order.get('knob', 'the truth')} = {order.get('setting', '')} ended with exit code "
                      f"{done.returncode}: {brief(words[-1])}")  # fmt: skip
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found
