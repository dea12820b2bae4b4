"""How well single pictures are denoised: the trained network beside blur, blind spots, non-local means and wavelets.

    python scripts/bench_denoiser.py SET [SET ...] --electrons 5 20 80 --out denoiser.json

Every set is photographed by a three-chip and a Bayer camera. Scores are means over views against the noise-free
three-channel exposure: aligned PSNR after the guided enhancement of the noisy picture, which is what a reconstruction
is fitted to; and the squared error in units of the noise, in the variance-stabilised domain. Filters work in that
domain; of each the strength is taken whose aligned PSNR is the highest, by the truth.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from denoising.rivals import BLURS, FILTERS, blur, filtered, noise_to_void
from torch import Tensor

from novags.methods.denoised.anscombe import Anscombe
from novags.methods.denoised.config import AdaptConfig
from novags.methods.denoised.estimate import estimate_all
from novags.methods.denoised.measured import MeasuredPictures, of_capture
from novags.methods.denoised.recorrupted import adapt
from novags.methods.denoised.weights import PACKAGED, load_weights
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import enhance
from novags.methods.noise import camera_noise
from novags.methods.problem import RawPictures, encode
from novags.process import settle
from novags.testbed.metrics.images import aligned_psnr
from sensor_model import PRESETS, Exposure, Sensor, develop, expose, from_linear16, mosaic, photons_for_electrons
from sensor_model.isp import interpolate, white_balance
from simscenes.sets.multiview import load_set

EXPOSURE = Exposure(time=1 / 30)


class Pictures:
    """Some views of a set, photographed: the pictures that a method sees, and the truth."""

    def __init__(self, folder: Path, sensor: Sensor, electrons: float, views: int, seed: int) -> None:
        source = load_set(folder)
        chosen = source.train_indices[:: max(1, len(source.train_indices) // views)][:views]
        radiance = [np.maximum(source.radiance(i), 0) for i in chosen]
        mean = float(np.mean([r[..., 1].mean() for r in radiance]))
        light = [photons_for_electrons(r, electrons=electrons, mean_green=mean, sensor=sensor) for r in radiance]
        seen = light if sensor.cfa is None else [mosaic(p, sensor.cfa) for p in light]
        frames = [expose(p, sensor, EXPOSURE, seed=seed, view=i, threads=1) for i, p in enumerate(seen)]
        self.sensor = sensor
        self.dn = torch.from_numpy(np.stack([f.dn for f in frames]).astype(np.float32))
        means = np.stack([np.minimum(p * sensor.eta, sensor.capacity_e) for p in light]).astype(np.float32)
        self.truth = torch.from_numpy(means).permute(0, 3, 1, 2)
        linear = np.stack([from_linear16(develop(f, sensor).linear16) for f in frames])
        self.dark = torch.from_numpy(encode(linear))
        red, green, blue = white_balance(sensor).tolist()
        raw = RawPictures(
            dn=self.dn, cfa=sensor.cfa, black=sensor.black_level, white=sensor.white_dn, balance=(red, green, blue)
        )
        noise = camera_noise(sensor, EXPOSURE, demosaic="menon", color_matrix=None)
        self.pictures: MeasuredPictures = of_capture(noise, raw, None, ())
        self.params = [enhance(dark, EnhanceConfig())[1] for dark in self.dark]
        self.reference = self.enhanced(self.truth)

    def enhanced(self, electrons: Tensor) -> Tensor:
        """Electrons [C, 3, H, W] as enhanced pictures [C, H, W, 3]."""
        code = torch.from_numpy(encode(self.pictures.linear(electrons).numpy()))
        return torch.stack([enhance(c, EnhanceConfig(), p)[0] for c, p in zip(code, self.params, strict=True)])

    def demosaiced(self, electrons: Tensor) -> Tensor:
        """A mosaic of electrons [C, H, W] as [C, 3, H, W]; Menon's interpolation wants white-balanced data."""
        gains = np.asarray(white_balance(self.sensor))[:, None, None]
        where = self.pictures.mask[0].numpy()
        planes = [interpolate((e.numpy() * (where * gains).sum(0)), self.sensor.cfa, "menon") for e in electrons]
        return torch.from_numpy(np.stack(planes).transpose(0, 3, 1, 2) / gains).float()

    def scores(self, electrons: Tensor) -> tuple[float, float]:
        """Aligned PSNR of the enhanced pictures, dB, and squared error in units of the noise."""
        stabilised = Anscombe(self.pictures.read_variance[None, :, None, None])
        error = float((stabilised(electrons) - stabilised(self.truth)).square().mean())
        return self.psnr(self.enhanced(electrons)), error

    def psnr(self, enhanced: Tensor) -> float:
        """Aligned PSNR of enhanced pictures [C, H, W, 3], mean over views, dB."""
        pairs = zip(enhanced.numpy(), self.reference.numpy(), strict=True)
        return float(np.mean([aligned_psnr(a.astype(np.float64), b.astype(np.float64)) for a, b in pairs]))


def rivals(data: Pictures) -> dict[str, tuple[float, float | None]]:
    cfa, mask = data.sensor.cfa, data.pictures.mask
    electrons = data.pictures.electrons if cfa is None else (data.pictures.electrons * mask).sum(1)
    whole = (lambda e: e) if cfa is None else data.demosaiced
    found: dict[str, tuple[float, float | None]] = {"noisy": data.scores(whole(electrons))}
    variance = data.pictures.read_variance[1]
    for name, (make, strengths) in FILTERS.items():
        tried = [data.scores(whole(filtered(electrons, cfa, variance, make(s)))) for s in strengths]
        found[name] = max(tried)
    noisy = torch.stack([enhance(d, EnhanceConfig(), p)[0] for d, p in zip(data.dark, data.params, strict=True)])
    found["blur after enhancement"] = max(data.psnr(blurred(noisy, sigma)) for sigma in BLURS), None
    found["N2V"] = data.psnr(noise_to_void(noisy, 0)), None
    return found


def blurred(pictures: Tensor, sigma: float) -> Tensor:
    """Each of [C, H, W, 3] by itself."""
    return torch.from_numpy(np.stack([blur(sigma)(picture) for picture in pictures.numpy()]))


def ours(data: Pictures, weights: Path, config: AdaptConfig) -> dict[str, tuple[float, float]]:
    network, p = load_weights(weights), data.pictures
    adapted, found = adapt(network, p, config, seed=0), {}
    for turns, name in ((1, ""), (8, ", 8 turns")):
        plain = estimate_all(network, p.electrons, p.mask, p.read_variance, turns=turns)
        found[f"network{name}"] = data.scores(plain)
        found[f"network, adapted{name}"] = data.scores(adapted.estimate_all(p, turns=turns))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", type=Path, nargs="+", help="rendered sets")
    parser.add_argument("--electrons", type=float, nargs="+", default=[5.0, 20.0, 80.0])
    parser.add_argument("--camera", default="a7s2-iso6400", help="a preset; its three-chip twin is taken as well")
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--weights", type=Path, default=PACKAGED)
    parser.add_argument("--only", choices=("rivals", "ours"), help="measure these alone")
    parser.add_argument(
        "--earlier", type=Path, nargs="*", default=[], help="results of --out to show in the same table"
    )
    parser.add_argument("--steps", type=int, default=AdaptConfig().steps, help="of the adaptation")
    parser.add_argument("--adapt-rate", type=float, default=AdaptConfig().learning_rate)
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    config = replace(AdaptConfig(), steps=asked.steps, learning_rate=asked.adapt_rate)
    rows: list[dict] = [row for path in asked.earlier for row in json.loads(path.read_text())]
    for folder in asked.sets:
        for camera in (f"{asked.camera}-3chip", asked.camera):
            for level in asked.electrons:
                started = time.process_time()
                data = Pictures(folder, PRESETS[camera], level, asked.views, asked.seed)
                found = {} if asked.only == "ours" else rivals(data)
                found |= {} if asked.only == "rivals" else ours(data, asked.weights, config)
                rows += [{"set": folder.name, "camera": camera, "electrons": level, "method": name, "psnr": psnr,
                          "squared_error": error} for name, (psnr, error) in found.items()]  # fmt: skip
                shown = ", ".join(
                    f"{name} {p:.2f} ({'-' if e is None else f'{e:.3f}'})" for name, (p, e) in found.items()
                )
                print(
                    f"{folder.name} {camera} {level:g} e-: {shown}; CPU {time.process_time() - started:.0f} s",
                    flush=True,
                )
    if asked.out:
        asked.out.write_text(json.dumps(rows, indent=1) + "\n")
    print(table(rows))


def table(rows: list[dict]) -> str:
    """Markdown: a row per method, a column per capture, aligned PSNR."""
    columns = list(dict.fromkeys((r["set"], r["camera"], r["electrons"]) for r in rows))
    methods = list(dict.fromkeys(r["method"] for r in rows))
    value = {(r["method"], r["set"], r["camera"], r["electrons"]): r["psnr"] for r in rows}
    heads = [f"{s}, {'three chips' if c.endswith('3chip') else 'Bayer'}, {e:g} e-" for s, c, e in columns]
    lines = [f"| | {' | '.join(heads)} |", f"|---|{'---|' * len(columns)}"]
    lines += [f"| {m} | {' | '.join(f'{value[(m, *c)]:.2f}' for c in columns)} |" for m in methods]
    return "\n".join(lines)


if __name__ == "__main__":
    settle()
    main()
