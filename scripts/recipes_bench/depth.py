"""Recipe `feedforward`: the depth of a dark view among others, by a network and by semi-global matching.

Both read the costs of one plane sweep (`novags.cameras.sweep`), over the first four context views of the index.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.cameras.sweep import PLANES, between, costs, planes, reduced, semi_global
from recipes_bench.unet import UNet, trained

NAME, RIVAL, UNIT = "feedforward", "semi-global matching", "median relative error of depth, %"
STEPS, BATCH, CONTEXT = 3000, 4, 4
SHARPEST = 1.5  # planes: the truth is a bump of this deviation, so that the planes beside the true one are nearly right
Row = Mapping[str, str]


@dataclass(frozen=True)
class Volume:
    """A dark view and its costs.

    Attributes:
        cost: [PLANES, h, w] float16, 0..1; 1 where too few views see it.
        grey: [h, w], over its mean.
        inverse: Inverse depths of the planes [PLANES], rising.
        depth: The true one [h, w], inf where there is none.
        view, electrons: Names of it.
    """

    cost: Tensor
    grey: Tensor
    inverse: Tensor
    depth: Tensor
    view: str
    electrons: str

    @property
    def place(self) -> Tensor:
        """The true depth in planes [h, w], nan beyond them."""
        at = (1 / self.depth - self.inverse[0]) / (self.inverse[1] - self.inverse[0])
        return torch.where(self.depth.isfinite() & (at >= 0) & (at <= PLANES - 1), at, torch.nan)

    def error(self, place: Tensor) -> float:
        """Median relative error of depth, %, of a depth in planes [h, w], where the truth lies between the planes."""
        found = 1 / (self.inverse[0] + place * (self.inverse[1] - self.inverse[0]))
        return 100 * float((found / self.depth - 1).abs()[self.place.isfinite()].median())


def volumes(row: Row, root: Path, brightest: float) -> Iterator[Volume]:
    """One for each light level of a view, but for those brighter than `brightest` electrons; none without planes."""
    file = root / row["file"]
    held = [dict(np.load(each)) for each in (file, *(file.with_name(f"{name}.npz")
                                                     for name in row["context"].split()[:CONTEXT]))]  # fmt: skip
    viewmats, Ks = (np.stack([view[name] for view in held]).astype(np.float64) for name in ("viewmat", "K"))
    near = np.arange(1, len(held))
    for level, electrons in enumerate(row["electrons"].split()):
        if float(electrons) > brightest:
            continue
        dark = np.stack([np.moveaxis(view["dark"][level], 0, -1).astype(np.float32) - view["black"] for view in held])
        small, small_Ks = reduced(dark / dark.mean(), Ks)
        height, width = small.shape[1:]
        inverse = planes(viewmats, small_Ks, 0, near, (height, width))
        if inverse is None:
            return
        cost = np.nan_to_num(costs(small, viewmats, small_Ks, 0, near, inverse), nan=1.0)
        step = dark.shape[1] // height
        depth = held[0]["depth"][step // 2 :: step, step // 2 :: step]
        yield Volume(
            torch.from_numpy(cost).half(), torch.from_numpy(small[0]), torch.from_numpy(inverse).float(),
            torch.from_numpy(depth), row["view"], electrons,
        )  # fmt: skip


class Depth(nn.Module):
    """Costs and the view to the likelihood of each plane: a small correction of the costs themselves."""

    def __init__(self) -> None:
        super().__init__()
        self.unet = UNet(PLANES + 1, PLANES)
        self.sharpness = nn.Parameter(torch.tensor(10.0))

    def forward(self, cost: Tensor, grey: Tensor) -> Tensor:
        """Cost [B, PLANES, h, w], grey [B, h, w] to logarithms of likelihoods [B, PLANES, h, w]."""
        found = self.unet(torch.cat([4 * cost - 2, grey[:, None] - 1], 1)) - self.sharpness * cost
        return F.log_softmax(found, 1)


def train(rows: list[Row], root: Path, steps: int, seed: int, kept: Path) -> nn.Module:
    """A network that puts most likelihood where the true depth is."""
    if kept.exists():
        return trained(Depth(), lambda *_: torch.zeros(()), 0, seed, kept)
    every = [volume for row in rows for volume in volumes(row, root, 100.0)]
    number = torch.arange(PLANES, dtype=torch.float32)[:, None, None]

    def loss(network: nn.Module, draw: torch.Generator) -> Tensor:
        some = [every[i] for i in torch.randint(len(every), (BATCH,), generator=draw).tolist()]
        cost, grey, place = (torch.stack([v.cost.float() for v in some]), torch.stack([v.grey for v in some]),
                             torch.stack([v.place for v in some]))  # fmt: skip
        axes = [axis for axis in (-1, -2) if int(torch.randint(2, (), generator=draw))]
        cost, grey, place = (array.flip(axes) for array in (cost, grey, place))
        known = place.isfinite()
        truth = torch.softmax(-0.5 * ((number - place.nan_to_num()[:, None]) / SHARPEST).square(), 1)
        return -((truth * network(cost, grey)).sum(1) * known).sum() / known.sum().clamp_min(1)

    return trained(Depth(), loss, steps, seed, kept)


def scores(network: nn.Module, rows: list[Row], root: Path) -> Iterator[tuple[Row, str, str, float]]:
    """(row, view, who, error) of every view and level; the depth is the likeliest plane, between its neighbours."""
    for row in rows:
        for volume in volumes(row, root, 100.0):
            of = {**row, "electrons": volume.electrons}
            with torch.no_grad():
                likely = network(volume.cost[None].float(), volume.grey[None])[0].numpy()
            total = semi_global(volume.cost.float().numpy())
            for who, found in (("network", -likely), (RIVAL, total)):
                yield of, volume.view, who, volume.error(torch.from_numpy(between(found, found.argmin(0))))
