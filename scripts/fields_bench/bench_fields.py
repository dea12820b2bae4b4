"""What a step of the field engine costs, part by part, in processor nanoseconds per sample.

    python scripts/fields_bench/bench_fields.py [--rays 512] [--samples 96] [--log2-rows 17] [--repeat 5]

Best of the repetitions, on as many threads as torch has (OMP_NUM_THREADS). Positions lie on a wall in the middle of the
box, as positions of a trained field lie on surfaces.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
import tyro

from novags.fields.box import Box
from novags.fields.evaluate import basis_of, evaluate, gradients
from novags.fields.field import first_field
from novags.fields.layout import SIDE, FieldLayout
from novags.fields.march import Proposal, Rays, sampled, weights_of


@dataclass(frozen=True, kw_only=True)
class Options:
    """What is measured."""

    rays: int = 512
    samples: int = 96
    log2_rows: int = 17
    repeat: int = 5


def best(work: Callable[[], object], repeat: int) -> float:
    """Processor seconds of the fastest of some runs, the first of which is not counted."""
    work()
    found = []
    for _ in range(repeat):
        started = time.process_time()
        work()
        found.append(time.process_time() - started)
    return min(found)


def main(options: Options) -> None:
    """Measure and print a table."""
    rng, layout = np.random.default_rng(0), FieldLayout(log2_rows=options.log2_rows)
    field = first_field(layout, 0)
    wall = np.zeros((SIDE, SIDE, SIDE), np.float32)
    wall[SIDE // 2] = 100.0
    box = Box(center=(0, 0, 0), half=(1, 1, 1), near=0.5, middle=4.0, far=200.0)
    ends = torch.from_numpy(rng.uniform(-1, 1, (options.rays, 2)).astype(np.float32))
    aims = torch.cat([ends, torch.full((options.rays, 1), 2.0)], 1)
    rays = Rays(torch.tensor([[0.0, 0, -2.0]]).repeat(options.rays, 1), torch.nn.functional.normalize(aims, dim=1),
                torch.ones(options.rays))  # fmt: skip
    proposal, jitter = Proposal(wall.reshape(-1)), rng.random((options.rays, options.samples + 1), np.float32)
    found = sampled(rays, box, proposal, jitter, 0.25)
    basis = basis_of(rays.directions)
    raw, encoded = evaluate(field, found.positions, basis)
    slopes = rng.normal(size=raw.shape).astype(np.float32)
    density = torch.from_numpy(raw[:, 0].reshape(options.rays, -1).copy()).requires_grad_()
    parts = {
        "samples along the rays": lambda: sampled(rays, box, proposal, jitter, 0.25),
        "field, values": lambda: evaluate(field, found.positions, basis),
        "field, gradients": lambda: gradients(field, found.positions, basis, encoded, slopes),
        "weights, and their gradients": lambda: weights_of(density, found.widths).sum().backward(),
        "map": lambda: proposal.learn(found.positions, raw[:, 0], 0.9),
    }
    count = options.rays * options.samples
    for name, work in parts.items():
        print(f"{name:30} {best(work, options.repeat) / count * 1e9:7.0f} ns per sample")


if __name__ == "__main__":
    main(tyro.cli(Options))
