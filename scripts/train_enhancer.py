"""Train MBLLEN, URetinex-Net, Retinexformer or Naka-GS's correction on simulated pairs.

    python scripts/train_enhancer.py mbllen --sets SETS/* --steps 20000 --out mbllen.safetensors

One recipe for all: pictures as for scripts/train_denoiser.py, photographed by `sensor_model` with cameras drawn
at random at 0.2 to 8 % of white and developed to 8 bits; what the network makes of one is to be the same picture
without noise at middle grey. The loss is L1 plus half of 1 - SSIM. An interrupted run continues from its checkpoint,
with the same options; --steps may change before the rate falls. At the end it says what the network makes of pictures
that it has not seen, beside the best factor on each.
"""

import argparse
import json
import os
import shlex
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from denoising.bright import BrightPairs, bright_batch, bright_checks
from denoising.pairs import Source
from denoising.training import Schedule, Training
from torch import Tensor

from novags.methods.enhancers import ENHANCERS, network_of
from novags.methods.enhancers.curves.gain import gain
from novags.methods.enhancers.networks.kind import Kind
from novags.methods.enhancers.rows.gain import GainConfig
from novags.splats.files.tensors import write_tensors
from novags.splats.training.losses import ssim

NAMES = ("mbllen", "uretinex", "retinexformer", "naka-net")
SAID, SAVED = 30.0, 120.0  # s between two lines of progress, and between two checkpoints


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network", choices=NAMES)
    parser.add_argument("--sets", type=Path, nargs="*", default=[], help="rendered sets; none: synthetic pictures")
    parser.add_argument(
        "--out", type=Path, required=True, help="the weights, FILE.safetensors; the checkpoint lies beside them"
    )
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--stop", type=int, help="stop after this step, as if interrupted")
    parser.add_argument("--rate", type=float, default=5e-4, help="largest learning rate")
    parser.add_argument("--batch", type=int, default=4, help="crops per step")
    parser.add_argument("--crop", type=int, default=64, help="px")
    parser.add_argument("--checks", type=int, default=24, help="pictures of 96 px that it is measured on")
    parser.add_argument("--beside", type=Path, nargs="*", help="other weights, measured on the same pictures")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    if asked.out.suffix != ".safetensors":  # by which the methods know how to read it
        parser.error(f"--out must end in .safetensors, got {asked.out}")
    return asked


def loss_of(network: torch.nn.Module, pairs: BrightPairs, *, kind: Kind, config: object) -> Tensor:
    """L1 and half of 1 - SSIM; light above white counts as well, so that it has a slope."""
    found = kind.run(network, pairs.dark, config)
    alike = torch.stack([ssim(a.movedim(0, -1), b.movedim(0, -1)) for a, b in zip(found, pairs.bright, strict=True)])
    return F.l1_loss(found, pairs.bright) + 0.5 * (1 - alike.mean())


def measured(network: torch.nn.Module, kind: Kind, config: object, checks: list[BrightPairs]) -> dict[str, float]:
    """PSNR in dB and SSIM, means over pictures: of the network, and of the factor that gives the true mean code."""
    found: dict[str, list[float]] = {"psnr": [], "ssim": [], "factor_psnr": [], "factor_ssim": []}
    network.eval()
    for pairs in checks:
        dark, bright = (picture[0].movedim(0, -1) for picture in (pairs.dark, pairs.bright))
        with torch.no_grad():
            shown = kind.run(network, pairs.dark, config)[0].movedim(0, -1).clamp(0, 1)
        by_factor = gain(dark, GainConfig(target=float(bright.mean().clamp(0.01, 0.99))), None, None)[0]
        for prefix, picture in (("", shown), ("factor_", by_factor)):
            found[f"{prefix}psnr"].append(float(-10 * (picture - bright).square().mean().log10()))
            found[f"{prefix}ssim"].append(float(ssim(picture, bright)))
    network.train()
    return {name: float(np.mean(values)) for name, values in found.items()}


def main() -> None:
    asked = arguments()
    enhancer = ENHANCERS[asked.network]
    config = enhancer.config()
    kind: Kind = network_of(config)
    other = kind.load(enhancer.config(weights=tuple(asked.beside))) if asked.beside else None
    torch.manual_seed(asked.seed)
    network = kind.make(config)
    loss = partial(loss_of, kind=kind, config=config)
    settings = {name: getattr(asked, name) for name in ("network", "seed", "crop", "batch")}
    settings["sets"] = [path.name for path in sorted(asked.sets)]
    training = Training(network, Schedule(steps=asked.steps, rate=asked.rate), loss, settings)
    checkpoint = asked.out.with_suffix(".checkpoint.safetensors")
    before = training.restore(checkpoint) if checkpoint.exists() else 0.0
    source = Source(sorted(asked.sets), size=128, stock=256, rendered_share=0.4)
    print(
        f"{sum(p.numel() for p in network.parameters())} parameters, step {training.step} of {asked.steps}", flush=True
    )
    seconds = run(training, source, asked, checkpoint, time.process_time() - before)
    checks = bright_checks(asked.checks, 96)
    scores = measured(network, kind, config, checks)
    if other is not None:
        found = measured(other, kind, config, checks)
        scores |= {f"beside_{name}": found[name] for name in ("psnr", "ssim")}
    shown = shlex.join(
        ["python", "scripts/train_enhancer.py", *(Path(a).name if "/" in a else a for a in sys.argv[1:])]
    )
    made = {"command": shown, "steps": training.step, "cpu_seconds": seconds, "torch": torch.__version__, **scores}
    write_tensors(asked.out, network.state_dict(), {"made": json.dumps(made)})
    print(f"{json.dumps(made)}\n{asked.out}")


def run(training: Training, source: Source, asked: argparse.Namespace, checkpoint: Path, began: float) -> float:
    """Train; returns processor seconds in all."""
    said = saved = time.perf_counter()
    losses, last = [], min(asked.steps, asked.stop or asked.steps)
    training.network.train()
    while training.step < last:
        rng = np.random.default_rng([asked.seed, training.step])
        losses.append(training.advance(bright_batch(source, rng, training.step, crop=asked.crop, count=asked.batch)))
        now = time.perf_counter()
        if now - said > SAID or training.step == last:
            spent = time.process_time() - began
            print(f"step {training.step} of {last}, loss {np.mean(losses):.4f}, CPU {spent:.0f} s", flush=True)
            said, losses = now, []
        if now - saved > SAVED or training.step == last:
            training.save(checkpoint, time.process_time() - began)
            saved = now
    return time.process_time() - began


if __name__ == "__main__":
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    try:
        main()
    except ValueError as error:
        raise SystemExit(f"train_enhancer.py: {error}") from None
