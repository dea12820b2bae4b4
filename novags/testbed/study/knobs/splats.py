"""The knobs of the splat engine. Each measurement is a process of its own: see `splat_engine`."""

import json
import os
import subprocess
from functools import lru_cache
from pathlib import Path
from typing import Any

from novags.testbed.study.knobs.knob import Knob, Reading, Setting, Subject
from sensor_model.files.atomic import atomic
from sensor_model.files.door import read_bytes
from sensor_model.files.own import cache_folder
from sensor_model.files.python import python
from sensor_model.files.reading import brief
from sensor_model.files.scratch import scratch

MODULE = "novags.testbed.study.knobs.splat_engine.child"
CHILD = f"from novags.process import settle; settle(); from {MODULE} import main; main()"
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
    "backend": (("numba", "torch"), "numba", "the same picture up to rounding; torch is its reference in tests"),
    "tile": ((8, 16), 16, "the same picture; the faster of the two on pictures of the usual sizes"),
}  # fmt: skip


def splats(n: int, size: int) -> Subject:
    """Forward and backward passes over n random Gaussians, pictures of size x size pixels."""

    def knob(name: str) -> Knob:
        settings, default, why = KNOBS[name]

        def one(setting: Setting, seed: int, captured: Path | None) -> Reading:
            return measured(name, setting, n, size, seed)

        return Knob(
            name=name, settings=settings, default=default, unit="RMSE of the picture",
            of="a forward and a backward pass", why=why, measure=one, shared=None if name == "eps2d" else "a picture",
        )  # fmt: skip

    workload = {"Gaussians": n, "size": f"{size} x {size}", "harmonics": "degree 3"}
    return Subject("splats", workload, tuple(knob(name) for name in KNOBS), (__name__, MODULE))


def measured(knob: str, setting: Setting, n: int, size: int, seed: int) -> Reading:
    """One setting, against the truth of this seed."""
    changed = knob in ("alpha_min", "transmittance_min", "exp2_degree", "tile") and setting != KNOBS[knob][1]
    code = f"{knob}-{setting:.3g}" if changed else "default"
    with scratch("pareto") as folder:
        file = folder / "truth.npy"
        with atomic(file) as temporary:  # dilation stands in for a filter over the pixel
            temporary.write_bytes(truth(n, size, seed, supersampled=knob == "eps2d"))
        order = {"do": "measure", "knob": knob, "setting": setting, "changed": changed, "truth": str(file), "n": n,
                 "size": size, "seed": seed}  # fmt: skip
        return Reading(**in_child(order, code))


@lru_cache(maxsize=2)  # all settings of a seed are measured after each other
def truth(n: int, size: int, seed: int, supersampled: bool) -> bytes:
    """The file of the picture that settings are compared with."""
    with scratch("pareto") as folder:
        order = {"do": "truth", "out": str(folder / "truth.npy"), "n": n, "size": size, "seed": seed}
        in_child({**order, "supersampled": supersampled}, "default")
        return read_bytes(folder / "truth.npy")


def in_child(order: dict[str, Any], code: str) -> dict[str, Any]:
    """The answer of the child process.

    Args:
        order: Its work.
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
