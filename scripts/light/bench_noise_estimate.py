"""What the noise is worth that the dark pictures tell themselves, beside the known camera: docs/own-camera.md.

    python scripts/light/bench_noise_estimate.py [--sets DIR ...] [--views 12] [--size 128]

Without --sets it renders tabletop and studio. For each camera, kind of picture and light: the error of the variance
in dB, root mean square over the brightnesses of the pictures, and its mean; gain and read noise over the true ones.
"""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from novags.methods.noise import Variance, camera_noise
from novags.methods.noise_estimate import camera_figures, noise_from
from novags.methods.problem import RawPictures
from novags.process import settle
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.set import open_source
from novags.testbed.stages.capturing import expose_with_truth
from novags.testbed.stages.configs.rendering import RenderConfig
from sensor_model import PRESETS, Exposure, develop, develop_linear, from_linear16

QUIET = Console(quiet=True)
CAMERAS = ("a7s2-iso6400", "imx900-hcg", "imx686-iso800", "d850-iso400")
ELECTRONS = (2.0, 5.0, 20.0, 80.0)
EXPOSURE = Exposure(time=1 / 30)
SHARES = np.linspace(0.02, 0.98, 49)  # quantiles of the brightness at which curves are compared
KINDS = {"16-bit": "16-bit", "8-bit": "8-bit", "blind": "16-bit, filters unknown"}


def decibels(found: Variance, known: Variance, clean: NDArray) -> NDArray:
    """Estimated over known variance at brightnesses of the pictures, dB, of all channels."""
    at = torch.from_numpy(np.quantile(clean.reshape(-1, 3), SHARES, axis=0))
    return 10 * np.log10(np.maximum(found(at).numpy(), 1e-30) / known(at).numpy())


def measured(light: list[NDArray], name: str, electrons: float) -> tuple[dict[str, NDArray], tuple[float, float]]:
    """Errors by kind of picture, and gain and read noise over the true ones."""
    sensor, mean = PRESETS[name], float(np.mean([view[..., 1].mean() for view in light]))
    frames, clean = [], []
    for i, radiance in enumerate(light):
        frame, three = expose_with_truth(
            radiance, sensor, EXPOSURE, electrons=electrons, mean_green=mean, seed=0, view=i
        )
        frames.append(frame)
        clean.append(develop_linear(frame.clean_dn if three is None else three, replace(sensor, cfa=None)))
    developed = [develop(frame, sensor) for frame in frames]
    linear = torch.from_numpy(np.stack([from_linear16(d.linear16) for d in developed]))
    srgb8 = torch.from_numpy(np.stack([d.srgb8 for d in developed]) / np.float32(255))
    raw = RawPictures(dn=torch.from_numpy(np.stack([f.dn for f in frames]).astype(np.float32)), cfa=sensor.cfa,
                      black=sensor.black_level, white=sensor.white_dn)  # fmt: skip
    known = camera_noise(sensor, EXPOSURE, demosaic="menon", color_matrix=None)
    found = {"16-bit": noise_from(srgb8, linear, raw, mixed=False), "8-bit": noise_from(srgb8, None, None, mixed=False)}
    if sensor.cfa:
        found["blind"] = noise_from(srgb8, linear, None, mixed=False)
    figures = camera_figures(raw)
    assert known.raw is not None
    read = np.sqrt(known.raw.curve.offset[0] - 1 / 12) / sensor.gain
    errors = {kind: decibels(noise.linear16, known.linear16, np.stack(clean)) for kind, noise in found.items()}
    return errors, (figures.gain / sensor.gain, figures.read_noise / read)


def table(scenes: list[list[NDArray]]) -> Iterator[str]:
    """The measurements as Markdown, line by line."""
    yield "| camera | pictures |" + "".join(f" {e:g} e- |" for e in ELECTRONS)
    yield "| --- | --- |" + " ---: |" * len(ELECTRONS)
    for name in (f"{camera}{chips}" for camera in CAMERAS for chips in ("-3chip", "")):
        runs = {e: [measured(light, name, e) for light in scenes] for e in ELECTRONS}
        for kind in runs[ELECTRONS[0]][0][0]:
            errors = [np.concatenate([errors[kind] for errors, _ in runs[e]]) for e in ELECTRONS]
            cells = [f" {np.sqrt((error**2).mean()):.2f} ({error.mean():+.2f}) |" for error in errors]
            yield f"| `{name}` | {KINDS[kind]} |" + "".join(cells)
        ratios = [np.mean([ratio for _, ratio in runs[e]], axis=0) for e in ELECTRONS]
        yield f"| `{name}` | raw: gain, read noise |" + "".join(f" {gain:.2f}, {read:.2f} |" for gain, read in ratios)


def main() -> None:
    """Render or open, expose, estimate, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--sets", nargs="+", type=Path, help="sets or posed photographs instead of the renders")
    parser.add_argument("--views", type=int, default=12)
    parser.add_argument("--size", type=int, default=128, help="px")
    parser.add_argument("--spp", type=int, default=512, help="samples per pixel; what noise they leave is texture")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folders = args.sets or []
        if not folders:
            for scene in ("tabletop", "studio"):
                config = RenderConfig(scene=scene, n_views=args.views, width=args.size, height=args.size, spp=args.spp)
                stages.render(Path(temporary) / scene, config, QUIET)
                folders.append(Path(temporary) / scene)
        sources = [open_source(folder, QUIET, args.size) for folder in folders]
        scenes = []
        for source in sources:
            chosen = np.linspace(0, len(source.views) - 1, min(args.views, len(source.views))).round().astype(int)
            scenes.append([source.radiance(int(i)) for i in chosen])
        for line in table(scenes):
            print(line, flush=True)


if __name__ == "__main__":
    settle()
    main()
