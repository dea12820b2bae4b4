"""A process of its own that makes a truth, or measures a setting.

The caller gives every setting a NUMBA_CACHE_DIR of its own: machine code of one setting must not serve another.
"""

import json
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from novags.testbed.study.knobs.clock import fastest
from novags.testbed.study.knobs.splat_engine.scene import NAMES, cube_scene, draw, reference, strips, turn
from sensor_model.files.door import opened

CALLS = 15
SUPERSAMPLE = 4  # samples a pixel and axis of the truth that dilation stands in for


def truth(out: str, n: int, size: int, seed: int, supersampled: bool) -> dict[str, Any]:
    """Write the picture in float64 without thresholds; supersampled: without dilation, box-filtered, too."""
    if supersampled:
        image = reference(n, size, seed, exact=True, supersample=SUPERSAMPLE, eps2d=0.0)
    else:
        image = reference(n, size, seed, exact=True)
    np.save(out, image.numpy(), allow_pickle=False)
    return {}


def measure(knob: str, setting: Any, changed: bool, n: int, size: int, seed: int, truth: str) -> dict[str, Any]:
    """Seconds of a forward and a backward pass, and the error of the picture; `changed`: with kernels of its own."""
    if changed:
        turn(knob, setting)
    scene, eps2d = cube_scene(n, size, seed), setting if knob == "eps2d" else 0.3
    bits, plain = (int(setting) if knob == "float_bits" else 32), (knob, setting) in PLAIN
    if bits == 64:
        scene = {name: value.double() for name, value in scene.items()}
    shape = [scene[name].requires_grad_() for name in NAMES]
    weights = torch.ones(size, size, 3, dtype=scene["means"].dtype)

    def once() -> None:
        top = 0
        for image in pictures():
            torch.autograd.grad(image, shape, weights[top : top + len(image)])
            top += len(image)

    def pictures() -> Iterator[Tensor]:
        if plain:
            yield from strips(scene, size, eps2d)
        else:
            yield draw(scene, scene["Ks"], size, size, eps2d=eps2d)

    with torch.no_grad():  # whole: in strips Gaussians beyond their borders are drawn a little differently
        image = reference(n, size, seed, exact=False, bits=bits) if plain else next(pictures())
    with opened(truth) as file:
        exact = np.load(file, allow_pickle=False)
    error = float(np.sqrt(np.mean((image.double().numpy() - exact) ** 2)))
    if not plain:
        once()
    seconds, cpu = fastest(once, 1 if plain else CALLS)
    return {"seconds": seconds, "cpu_seconds": cpu, "error": error}


PLAIN = (("float_bits", 64), ("backend", "torch"))
"""Settings that the readable reference stands for, in strips."""


def main() -> None:
    """Carry out the order in the first argument."""
    order = json.loads(sys.argv[1])
    print(json.dumps((truth if order.pop("do") == "truth" else measure)(**order)))
