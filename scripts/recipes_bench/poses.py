"""Recipe `dark3r`: cameras of dark views, by structure from motion on what a network makes of them, and on themselves.

The network learns, as Dark3R's student does, what the bright exposure of a view shows; here as a picture and not as the
features of a matcher, so that both go through one program: `novags poses` with COLMAP's features.
"""

import math
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from bench_cameras import found_by_poses
from torch import Tensor, nn

from recipes_bench.unet import UNet, trained, turned

NAME, RIVAL, UNIT = "dark3r", "structure from motion", "rotation AUC@5, 0 to 1"
STEPS, BATCH, CROP = 6000, 8, 48
MAPPER = "global"  # which registers more of dark pictures, bench_cameras.py
STEEP = 8.0  # of the curve
Row = Mapping[str, str]


def shown(light: Tensor) -> Tensor:
    """A curve for light over its mean: straight around nothing, where noise lies on both sides, and close to a root."""
    return torch.asinh(STEEP * light) / math.asinh(4 * STEEP)


def exposures(file: Path) -> tuple[Tensor, Tensor, Tensor]:
    """All exposures [L + 1, 3, h, w] over their means through the curve, from the darkest to the bright one; electrons
    of all, [L + 1]; viewmat.
    """
    with np.load(file) as held:
        every = np.concatenate([held["dark"], held["bright"][None]]) - held["black"]
        electrons = np.append(held["electrons"], held["bright_electrons"])
        viewmat = held["viewmat"]
    light = torch.from_numpy(every / every.mean((1, 2, 3), keepdims=True))
    return shown(light), torch.from_numpy(electrons), torch.from_numpy(viewmat)


def train(rows: list[Row], root: Path, steps: int, seed: int, kept: Path) -> nn.Module:
    """A network that is told how many electrons a dark exposure has."""
    if kept.exists():
        return trained(UNet(4, 3), lambda *_: torch.zeros(()), 0, seed, kept)
    held = [exposures(root / row["file"])[:2] for row in rows]

    def loss(network: nn.Module, draw: torch.Generator) -> Tensor:
        pairs, light = [], []
        for i in torch.randint(len(held), (BATCH,), generator=draw).tolist():
            pictures, electrons = held[i]
            level = int(torch.randint(len(pictures) - 1, (), generator=draw))
            y, x = (int(torch.randint(side - CROP + 1, (), generator=draw)) for side in pictures.shape[-2:])
            both = torch.stack([pictures[level], pictures[-1]])[..., y : y + CROP, x : x + CROP]
            pairs.append(turned(both, draw))
            light.append(electrons[level])
        dark, bright = torch.stack(pairs, 1)
        return F.l1_loss(restored(network, dark, torch.stack(light)), bright)

    return trained(UNet(4, 3), loss, steps, seed, kept)


def restored(network: nn.Module, dark: Tensor, electrons: Tensor) -> Tensor:
    """Dark exposures [B, 3, h, w], through the curve, of [B] electrons: as bright ones would be."""
    told = torch.log10(electrons)[:, None, None, None].expand(-1, 1, *dark.shape[2:])
    found: Tensor = dark + network(torch.cat([dark, told], 1))
    return found


def scores(network: nn.Module, rows: list[Row], root: Path) -> Iterator[tuple[Row, str, str, float]]:
    """(row, "", who, area) of every scene and level, of all its views together."""
    for _, group in groupby(rows, key=lambda row: row["scene"]):
        own = list(group)
        every = (exposures(root / row["file"]) for row in own)
        pictures, electrons, viewmats = map(torch.stack, zip(*every, strict=True))
        true = viewmats.double().numpy()
        for level, light in enumerate(electrons[0].tolist()):  # of the bright exposures too, for a ceiling
            dark, row = pictures[:, level], {**own[0], "electrons": f"{light:g}"}
            with torch.no_grad():
                clean = restored(network, dark, electrons[:, level])
            for who, seen in (("network", clean), (RIVAL, dark)):
                codes = (255 * seen.clamp(0, 1)).round().byte().permute(0, 2, 3, 1).numpy()
                found = found_by_poses(codes, true, 0, pictures="raw", mapper=MAPPER)
                yield row, "", who, found["rotation_auc5"]
