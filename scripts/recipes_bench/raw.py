"""Recipe `denoiser`: a raw frame without its noise, by a network and by non-local means."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from denoising.rivals import FILTERS, filtered
from torch import Tensor, nn

from novags.methods.denoised.anscombe import Anscombe
from recipes_bench.unet import UNet, trained, turned

NAME, RIVAL, UNIT = "denoiser", "non-local means", "dB of squared error"
BRIGHT = 100.0  # electrons: frames above are not dark
STEPS, BATCH, CROP = 6000, 8, 48  # CROP: cells of 2 x 2 px
Row = Mapping[str, str]


def frame(file: Path) -> tuple[Tensor, Tensor, Tensor]:
    """A noisy and a clean frame [4, h, w] in electrons, and the read variance, electrons**2, []."""
    with np.load(file) as held:
        noisy, clean = ((held[name].astype(np.float32) - held["black"]) / held["gain"] for name in ("noisy", "clean"))
        read = held["sigma_d"] ** 2 + 1 / (12 * held["gain"] ** 2)  # rounding to codes is noise too
    return torch.from_numpy(noisy), torch.from_numpy(clean), torch.tensor(read, dtype=torch.float32)


def train(rows: list[Row], root: Path, steps: int, seed: int, kept: Path) -> nn.Module:
    """A network that knows what the noise is by the brightness alone: data have noise of variance 1."""
    frames = [frame(root / row["file"]) for row in rows if float(row["electrons"]) < BRIGHT]

    def loss(network: nn.Module, draw: torch.Generator) -> Tensor:
        pairs = []
        for i in torch.randint(len(frames), (BATCH,), generator=draw).tolist():
            noisy, clean, read = frames[i]
            both = torch.stack([Anscombe(read)(noisy), Anscombe(read)(clean)])
            y, x = (int(torch.randint(side - CROP + 1, (), generator=draw)) for side in both.shape[-2:])
            pairs.append(turned(both[..., y : y + CROP, x : x + CROP], draw))
        noisy, clean = torch.stack(pairs, 1)
        return F.l1_loss(noisy + network(noisy), clean)

    return trained(UNet(4, 4), loss, steps, seed, kept)


def scores(network: nn.Module, rows: list[Row], root: Path) -> Iterator[tuple[Row, str, str, float]]:
    """(row, view, who, score) of every frame: the squared error of electrons, dB below that of the noisy frame.

    Non-local means have the strength that is best for each frame by its truth.
    """
    means, strengths = FILTERS[RIVAL]
    for row in (row for row in rows if float(row["electrons"]) < BRIGHT):
        noisy, clean, read = frame(root / row["file"])
        curve = Anscombe(read)

        def better(found: Tensor, noisy: Tensor = noisy, clean: Tensor = clean) -> float:
            return 10 * float(torch.log10((noisy - clean).square().mean() / (found - clean).square().mean()))

        with torch.no_grad():
            stable = curve(noisy)
            yield row, row["view"], "network", better(curve.inverse(stable + network(stable[None])[0]))
        # Whatever the pattern of the camera, its planes are in this order.
        mosaic = F.pixel_shuffle(noisy[None], 2)[0]
        tried = (filtered(mosaic, "RGGB", read, means(strength)) for strength in strengths)
        yield row, row["view"], RIVAL, max(better(F.pixel_unshuffle(found[None], 2)[0]) for found in tried)
