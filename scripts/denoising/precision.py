"""Pictures of the paper's denoiser in bfloat16 and in float32, from the same pictures and draws."""

import time
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from denoising.pictures import picture
from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.denoiser_config import DenoiserConfig
from novags.testbed.metrics.images import aligned_psnr

PRECISIONS = "float32", "bfloat16"


def views(seed: int, count: int, size: int, electrons: float) -> tuple[Tensor, Tensor]:
    """Pictures and the same with shot noise, as a display shows them, both [count, size, size, 3] in 0..1.

    Args:
        seed: Of pictures and noise.
        count: Pictures, each of another kind.
        size: px.
        electrons: Mean of a picture, before it is encoded.
    """
    rng = np.random.default_rng(seed)
    linear = np.stack([picture(count * seed + i, size) for i in range(count)])
    linear *= 0.25 / linear.mean((1, 2, 3), keepdims=True)
    noisy = rng.poisson(linear * electrons / 0.25) * 0.25 / electrons
    clean, seen = (torch.from_numpy(np.clip(x, 0, 1).astype(np.float32) ** (1 / 2.2)) for x in (linear, noisy))
    return clean, seen


def trained(seed: int, precision: str, steps: int, size: int, *, count: int = 4, electrons: float = 20.0) -> dict:
    """Aligned PSNR of each picture, dB, after so many steps of the paper's denoiser, and what they took."""
    clean, seen = views(seed, count, size, electrons)
    config = DenoiserConfig()
    config = replace(config, network=replace(config.network, precision=precision))
    denoiser, started = Denoiser(seen, config, total_steps=steps, seed=seed), time.process_time()
    for _ in range(steps):
        denoiser.train_step()
    took = time.process_time() - started
    pairs = zip(denoiser.denoise_all().double().numpy(), clean.double().numpy(), strict=True)
    noisy = zip(seen.double().numpy(), clean.double().numpy(), strict=True)
    psnr, before = ([float(aligned_psnr(a, b)) for a, b in each] for each in (pairs, noisy))
    return {"seed": seed, "precision": precision, "steps": steps, "size": size, "psnr": psnr, "noisy": before,
            "cpu_seconds": took}  # fmt: skip
