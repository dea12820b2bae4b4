"""Denoise: a capture in, its pictures without noise out, in linear light. No cameras, no model."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from novags.methods.denoised.denoiser import denoised
from novags.methods.denoised.measured import of_capture
from novags.methods.denoised.weights import made_by
from novags.methods.problem import refuse_uneven, stacked
from novags.testbed.console.devices import chosen_device
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.ledger.stage import run_stage
from novags.testbed.stages.configs.denoising import DenoisePicturesConfig
from novags.testbed.stages.paths import keep_apart
from novags.testbed.stages.reconstructing import raw_pictures
from sensor_model.isp import to_srgb8
from simscenes.sets.pictures.png import write_png

RECORD, LINEAR, SHOWN = "denoise.json", "linear", "srgb"


def denoise(
    capture_path: Path, out: Path, config: DenoisePicturesConfig, console: Console, *, overwrite: bool = False
) -> dict[str, Any]:
    """Denoise every picture of the capture at `capture_path`; returns denoise.json.

    `linear` holds 16-bit PNGs of linear light, 0 = black and 65535 = white; `srgb` the same as 8-bit sRGB, as dark as
    taken.

    Raises:
        ValueError: If the capture cannot be read, lacks raw data or known noise, or `out` holds other things.
        BlockingIOError: If another process is writing to `out`.
    """
    keep_apart(out, capture_path)
    capture = open_capture(capture_path)
    settings = {"denoise": asdict(config.denoise), "seed": config.seed, "weights": made_by()}
    return run_stage(
        "denoise",
        out,
        RECORD,
        code=config.code.along_with(capture.modules),
        opened={"capture": capture.content},
        inputs=lambda: {"capture": capture.digest()},
        config=settings,
        owns=(RECORD, LINEAR, SHOWN),
        prepare=lambda: None,
        work=lambda _: denoise_views(capture, out, config, console),
        console=console,
        overwrite=overwrite,
    )


def denoise_views(capture: Capture, out: Path, config: DenoisePicturesConfig, console: Console) -> dict[str, Any]:
    """Adapt the network to all views and write each without noise; returns the body of denoise.json."""
    indices, device = list(range(len(capture.names))), chosen_device(config.device, console)
    raw = raw_pictures(capture, indices) if capture.holds("raw") else None
    linear16 = stacked(capture.linear16, indices) if capture.holds("images16") else None
    refuse_uneven(capture.record.uneven.exposures, "denoising")
    pictures = of_capture(capture.noise, raw, linear16, capture.channels_share + capture.pixels_share).to(device)
    steps = 0 if config.denoise.adapt is None else config.denoise.adapt.steps
    with console.progress("denoise", {"denoiser": steps, "views": len(indices)}) as progress:

        def step(done: int, total: int, losses: dict[str, float]) -> None:
            progress(done, total, f"loss {losses['denoiser']:.3f}")

        light = denoised(pictures, config.denoise, seed=config.seed, progress=step, more=len(indices))
        for i, (name, each) in enumerate(zip(capture.names, light, strict=True)):
            view = each.cpu().numpy()
            write_png(out / LINEAR / f"{name}.png", np.round(np.clip(view, 0, 1) * 65535).astype(np.uint16))
            write_png(out / SHOWN / f"{name}.png", to_srgb8(view))
            progress(steps + i + 1, steps + len(indices), f"view {name}")
    return {"pictures": list(capture.names), "white": 65535, "device": str(device)}
