"""Train the network of `novags.methods.denoised` on simulated pairs.

    python scripts/train_denoiser.py --sets SETS/* --steps 20000 --out weights.safetensors

The clean pictures are views of rendered sets (make them with `novags render`, of scenes and seeds that no table
reports) and synthetic pictures; each is photographed by `sensor_model` with a camera and at a level drawn at random.
An interrupted run continues from its checkpoint, with the same options; --steps may change before the rate falls. Every
step depends on the seed and its own number alone.
"""

import argparse
import os
import shlex
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from denoising.pairs import EXPOSURE, Batches, Cameras, Pairs, Source, TheseCameras, any_camera
from denoising.training import Schedule, Training, checked, checks, loss_of
from torch.utils.data import DataLoader

from novags.methods.denoised.network import Network, NetworkConfig
from novags.methods.denoised.weights import save_weights
from novags.testbed.console.cores import cores_here
from novags.testbed.console.terminal import Console
from novags.testbed.importing.calibration.dark_frames import find_dark_frames
from novags.testbed.importing.calibration.frames import read_frame
from novags.testbed.stages.configs.capturing import camera_file

SAID = 30.0  # s between two lines of progress
CHECKED = 10  # lines between two looks at pairs that are not trained on, which take a second
SAVED = 120.0  # s between two checkpoints


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--sets", type=Path, nargs="*", default=[], help="rendered sets; none: synthetic pictures alone"
    )
    parser.add_argument("--out", type=Path, required=True, help="the weights; the checkpoint lies beside them")
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--stop", type=int, help="stop after this step, as if interrupted")
    parser.add_argument("--rate", type=float, default=1e-3, help="largest learning rate")
    parser.add_argument("--batch", type=int, default=8, help="crops per step")
    parser.add_argument("--crop", type=int, default=96, help="px, even")
    parser.add_argument("--loss", choices=("l1", "l2"), default="l1")
    parser.add_argument("--widths", type=int, nargs="+", default=list(NetworkConfig.widths))
    parser.add_argument("--blocks", type=int, nargs="+", default=list(NetworkConfig.blocks))
    parser.add_argument("--stock", type=int, default=256, help="synthetic pictures that are kept at a time")
    parser.add_argument("--rendered-share", type=float, default=0.4, help="of the crops")
    parser.add_argument("--cameras", nargs="*", default=[], help="presets or files; none: drawn at random")
    parser.add_argument(
        "--dark-frames", type=Path, help="of the one camera: its noise without light is drawn from them"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--makers", type=int, default=int(cores_here() > 1), help="other processes that make pairs ahead; 0: none"
    )
    return parser.parse_args()


def cameras_of(names: list[str], dark_frames: Path | None) -> Cameras:
    """Those that photograph the pictures.

    Raises:
        ValueError: If dark frames are not of one camera, or not of this one.
    """
    files = [camera_file(name) for name in names]
    if dark_frames is None:
        return TheseCameras([file.sensor for file in files]) if files else any_camera
    if len(files) != 1:
        raise ValueError(f"--dark-frames are of one camera, got {len(files)} of --cameras: name theirs alone")
    folder, (file,) = find_dark_frames(dark_frames, files[0]), files
    size = read_frame(folder.files[0]).dn.shape[-2:]
    dark = folder.read(file.sensor, (size[0], size[1]), EXPOSURE.time, Console(quiet=True))
    return TheseCameras([file.sensor], dark)


def main() -> None:
    asked = arguments()
    cameras = cameras_of(asked.cameras, asked.dark_frames)
    torch.manual_seed(asked.seed)
    network = Network(NetworkConfig(widths=tuple(asked.widths), blocks=tuple(asked.blocks)))
    network.to(memory_format=torch.channels_last)
    settings = {name: getattr(asked, name) for name in
                ("seed", "crop", "batch", "widths", "blocks", "loss", "stock", "rendered_share")}  # fmt: skip
    settings["sets"] = [path.name for path in sorted(asked.sets)]
    settings["cameras"] = [Path(name).name for name in asked.cameras]
    settings["dark_frames"] = "" if asked.dark_frames is None else asked.dark_frames.name
    loss = partial(loss_of, kind=asked.loss)
    training = Training(network, Schedule(steps=asked.steps, rate=asked.rate), loss, settings)
    checkpoint = asked.out.with_suffix(".checkpoint.safetensors")
    before = training.restore(checkpoint) if checkpoint.exists() else 0.0
    source = Source(sorted(asked.sets), size=128, stock=asked.stock, rendered_share=asked.rendered_share)
    kept = checks(12, 96)
    print(f"{sum(p.numel() for p in network.parameters())} parameters, {len(source.rendered)} rendered views, "
          f"step {training.step} of {asked.steps}", flush=True)  # fmt: skip
    run(training, Batches(source, cameras, asked.seed, asked.crop, asked.batch), kept, asked, checkpoint, before)


def run(
    training: Training, made: Batches, kept: list[Pairs], asked: argparse.Namespace, checkpoint: Path, before: float
) -> None:
    started, cpu = time.perf_counter(), time.process_time() - before
    first, said, saved, losses, lines = training.step, time.perf_counter(), time.perf_counter(), [], 0
    last = min(asked.steps, asked.stop or asked.steps)
    # Fresh processes: a copy of this one would hold locks of the threads that the network's kernels have started.
    ahead: dict[str, Any] = {"multiprocessing_context": "spawn", "prefetch_factor": 8} if asked.makers else {}
    for pairs in DataLoader(made, batch_size=None, sampler=range(first, last), num_workers=asked.makers, **ahead):
        losses.append(training.advance(pairs))
        now = time.perf_counter()
        if now - said > SAID or training.step == last:
            left = (now - started) / (training.step - first) * (last - training.step)
            print(f"step {training.step} of {last}, loss {np.mean(losses):.4f}, CPU {time.process_time() - cpu:.0f} s, "
                  f"about {left / 60:.0f} min left", flush=True)  # fmt: skip
            if lines % CHECKED == 0 or training.step == last:
                chips, mosaic = checked(training.network, kept)
                print(f"squared error on other pictures: three chips {chips:.4f}, mosaic {mosaic:.4f}", flush=True)
            said, losses, lines = time.perf_counter(), [], lines + 1
        if now - saved > SAVED or training.step == last:
            training.save(checkpoint, time.process_time() - cpu)
            saved = time.perf_counter()
    shown = shlex.join(
        ["python", "scripts/train_denoiser.py", *(Path(a).name if "/" in a else a for a in sys.argv[1:])]
    )
    record = {"command": shown, "seed": asked.seed, "steps": training.step, "cpu_seconds": time.process_time() - cpu,
            "sets": training.settings["sets"], "torch": torch.__version__}  # fmt: skip
    save_weights(asked.out, training.network, record)
    print(asked.out)


if __name__ == "__main__":
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    try:
        main()
    except ValueError as error:
        raise SystemExit(f"train_denoiser.py: {error}") from None
