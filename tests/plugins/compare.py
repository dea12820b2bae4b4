"""What a plan leaves out of a scene, against everything on: rendered both ways, compared with the bound it states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes import plan_transport
from simscenes.backend import COLORS, activate, using_variant
from simscenes.loading.load import build_scene
from simscenes.render.sensors import sensor_dict
from simscenes.transport import plan as effects
from simscenes.transport.plan import TransportPlan
from simscenes.transport.planner import everything_on
from tests.plugins.row import Node, Row, rig

PASSES = 16
SPP = 36  # of a pass
BACKEND = "scalar"  # whose kernels need not be compiled for every scene
# Its picture has the same power at all wavelengths in spectral variants, not daylight's: another colour than its RGB.
WRONG_IN_SPECTRA = {"projector"}
BLOCK = 4  # px: differences are averaged over blocks of this side


@dataclass(frozen=True)
class Verdict:
    """A row of the table.

    Attributes:
        row: The scene.
        plan: What was planned.
        change: Light that everything on moves, as a share of all: the mean absolute difference over blocks of pixels.
        error: One standard error of `change`.
        bound: The most that the plan says it could be.
        full: Colours of the render with everything on: the most that the scene can be loaded in.
    """

    row: Row
    plan: TransportPlan
    change: float
    error: float
    bound: float
    full: str

    @property
    def holds(self) -> bool:
        """Whether the difference is within the bound, at five standard errors."""
        return self.change - 5 * self.error <= self.bound


def judge(row: Row, folder: Path, *, measure: bool) -> Verdict:
    """Plan a scene, render it by the plan and with everything on, compare."""
    scene = row.make(activate(), folder)
    made = plan_transport(scene, rig=rig(), measure=measure)
    backend = BACKEND if loads(scene, BACKEND, "rgb") or loads(scene, BACKEND, "spectral") else "llvm_ad"
    full = richest(scene, everything_on(made), backend)
    if made.is_on(effects.SPECTRAL_MIS):  # what polarises gives nan where a medium has no extinction at a wavelength
        full = full.force(on=[effects.SPECTRAL_MIS], off=[effects.POLARISATION])
    if row.plugin in WRONG_IN_SPECTRA:
        full = full.force(off=[effects.SPECTRAL, effects.POLARISATION])
    images = [passes(scene, one.integrator(), one.color, seed, backend) for seed, one in enumerate((made, full))]
    change, error = moved(images[0], images[1])
    bound = made.bound + made.biases.get(effects.MADE_UP, 0.0) * (full.color != "rgb")
    return Verdict(row, made, change, error, bound, full.color)


def loads(scene: Node, backend: str, color: str) -> bool:
    """Whether a scene can be loaded so. Tensors that were made for llvm cannot in scalar, for instance."""
    with using_variant(backend, color) as mi:
        try:
            build_scene(scene, mi)
        except ValueError:
            return False
    return True


def richest(scene: Node, full: TransportPlan, backend: str) -> TransportPlan:
    """The plan in the most that a scene can be loaded in."""
    color = next(color for color in reversed(COLORS) if loads(scene, backend, color))
    off = COLORS[COLORS.index(color) + 1 :]
    names = {"spectral_polarized": effects.POLARISATION, "spectral": effects.SPECTRAL}
    return full.force(off=[names[c] for c in off]) if off else full


def passes(scene: Node, integrator: Node, color: str, seed: int, backend: str = BACKEND) -> NDArray[np.float64]:
    """Independent renders of the one view, averaged over blocks of pixels: [pass, block, channel]."""
    with using_variant(backend, color) as mi:
        loaded, view = build_scene(scene, mi), rig()
        sensor, method = mi.load_dict(sensor_dict(mi, view, 0, loaded)), mi.load_dict(integrator)
        images = [
            np.array(mi.render(loaded.scene, sensor=sensor, integrator=method, spp=SPP, seed=1000 * seed + k))
            for k in range(PASSES)
        ]
    found = np.stack(images).astype(np.float64)[..., :3]
    n = view.height // BLOCK
    return found.reshape(PASSES, n, BLOCK, n, BLOCK, 3).mean((2, 4)).reshape(PASSES, n * n, 3)


def moved(plain: NDArray[np.float64], full: NDArray[np.float64]) -> tuple[float, float]:
    """Mean absolute difference over the blocks as a share of all light, and its standard error.

    The sign of each block's difference is taken from one half of the passes, its size from the other: noise adds
    nothing on average. Where it hides the sign, the result is too low, by less than its standard error.
    """
    difference = (full - plain).mean(-1)
    total, half = full.mean(), len(difference) // 2
    values, errors = [], []
    for signs, sizes in ((slice(half), slice(half, None)), (slice(half, None), slice(half))):
        each = (np.sign(difference[signs].mean(0)) * difference[sizes]).mean(1) / total
        values.append(each.mean())
        errors.append(each.std(ddof=1) / np.sqrt(len(each)))
    return float(np.mean(values)), float(np.hypot(*errors) / 2)


def all_rows() -> Sequence[Row]:
    """Every scene of the table."""
    from tests.plugins import lights, shapes, surfaces, volumes

    return (*surfaces.BSDFS, *lights.LIGHTS, *volumes.MEDIA, *surfaces.TEXTURES, *shapes.SHAPES)


def states(made: TransportPlan) -> str:
    """What a plan has on, in a few words."""
    chosen: dict[str, Any] = made.integrator()
    depth = "endless" if chosen["max_depth"] < 0 else chosen["max_depth"]
    return f"{made.color}, {chosen['type']}, depth {depth}"
