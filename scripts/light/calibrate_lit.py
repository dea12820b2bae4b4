"""Calibrate the camera model of `3dgs4ll` on one scene that is known dark and lit.

    novags render tabletop --views 20 --width 96 --height 96 --spp 256 --out out/lit/set
    novags capture out/lit/set --sensor a7s2-iso6400-3chip --electrons 20 --out out/lit/dark
    python scripts/light/calibrate_lit.py out/lit/dark --out novags/methods/calibrated/calibration.json

It says how far the pictures are from the lit ones before and after. A method with this file has seen that scene in good
light, and every report says so.
"""

import argparse
import json
from pathlib import Path

import torch

from novags.methods.calibrated.calibrate import calibrate
from novags.methods.calibrated.camera_model import Calibration, as_record, smoothed
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.report.place import title_of
from sensor_model.files.atomic import atomic


def psnr(pictures: torch.Tensor, lit: torch.Tensor) -> float:
    return float(-10 * torch.log10(((pictures - lit) ** 2).mean()))


def rows(found: Calibration, dark: torch.Tensor, lit: torch.Tensor) -> dict[str, float]:
    """PSNR of the pictures of each step against their aim, dB."""
    shown = found.amplified(dark)
    balance = torch.tensor(found.balance).to(dark)
    return {
        "dark codes against lit ones": psnr(dark, lit),
        "amplified": psnr(torch.stack([smoothed((one * balance).clamp(0, 1), 1.0) for one in shown]), lit),
        "by the model": psnr(torch.stack([smoothed(one, 1.0) for one in found.to_lit(shown)]), lit),
        "lit ones by the model against dark ones": psnr(found.to_dark(lit), dark),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    console = Console()
    capture = open_capture(asked.capture)
    source = capture.source(console)
    views = [i for i in range(len(capture.names)) if source.shows(i) and capture.is_dark(i)]
    dark = torch.stack([torch.from_numpy(capture.srgb8(i)) for i in views]).double()
    lit = torch.stack([torch.from_numpy(source.lit(i)) for i in views]).double()
    made = {"lit": title_of(capture, source), "views": len(views)}
    with console.progress("calibrate") as progress:
        found = calibrate(dark, lit, made, lambda done, total: progress(done, total, ""))
    for name, value in rows(found, dark, lit).items():
        print(f"{name:42s}{value:6.2f} dB")
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    with atomic(asked.out) as temporary:
        temporary.write_text(json.dumps(as_record(found), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
