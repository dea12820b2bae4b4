"""Rays through a field: where they are sampled, and the sums of their samples."""

from dataclasses import dataclass, field

import numpy as np
import torch
from scipy.ndimage import binary_dilation
from torch import Tensor

from novags.fields.box import Box, contracted
from novags.fields.cpu import sample
from novags.fields.layout import DENSITY_MAX, SIDE
from novags.splats.cpu.parallel import run
from novags.splats.views import Views

FIRST = 0.05  # density of the map before anything is known: every ray gets through
RAYS = 256  # in a range of work


@dataclass(frozen=True)
class Rays:
    """Rays in world coordinates.

    Attributes:
        origins: [R, 3].
        directions: Of unit length [R, 3].
        forward: z-depth at a distance of 1 [R].
    """

    origins: Tensor
    directions: Tensor
    forward: Tensor

    def __len__(self) -> int:
        return len(self.origins)


def rays_of(views: Views, view: Tensor, x: Tensor, y: Tensor) -> Rays:
    """Rays through pixel centres.

    Args:
        views: The cameras.
        view: Which camera, int64 [R].
        x: Column, [R].
        y: Row, [R].
    """
    K, viewmat = views.Ks[view].double(), views.viewmats[view].double()
    pixel = torch.stack([x + 0.5, y + 0.5, torch.ones_like(x, dtype=torch.float64)], -1)
    local = torch.linalg.solve(K, pixel[..., None])
    length = local.norm(dim=1, keepdim=True)
    turn = viewmat[:, :3, :3].mT
    directions = (turn @ (local / length))[..., 0]
    return Rays(-(turn @ viewmat[:, :3, 3:])[..., 0].float(), directions.float(), (1 / length[:, 0, 0]).float())


@dataclass(frozen=True)
class Samples:
    """Samples along rays.

    Attributes:
        distances: From the cameras, world units [R, N].
        widths: Of their intervals, units of the box [R, N].
        positions: In the unit cube, float32 [R * N, 3].
    """

    distances: Tensor
    widths: Tensor
    positions: np.ndarray


@dataclass
class Proposal:
    """A coarse map of the densities in the unit cube, after which rays are sampled; it is not trained.

    Attributes:
        density: Per unit of the box, float32 [96^3], z-major.
    """

    density: np.ndarray = field(default_factory=lambda: np.full(SIDE**3, FIRST, np.float32))

    def learn(self, positions: np.ndarray, log_density: np.ndarray, kept: float) -> None:
        """Take in the densities of samples; see `sample.learn`."""
        found = np.exp(np.minimum(log_density, np.float32(DENSITY_MAX))).astype(np.float32)
        sample.learn(positions, found, SIDE, np.float32(kept), self.density)


def cells_near(points: Tensor, box: Box) -> np.ndarray:
    """Which cells hold one of the points [P, 3], or are next to one that does; bool [96^3], z-major."""
    u = contracted(points.double().cpu(), box).numpy()
    cells = np.clip((u * SIDE).astype(int), 0, SIDE - 1)
    found = np.zeros((SIDE, SIDE, SIDE), bool)
    found[cells[:, 2], cells[:, 1], cells[:, 0]] = True
    return np.asarray(binary_dilation(found, np.ones((3, 3, 3)))).reshape(-1)


def sampled(rays: Rays, box: Box, proposal: Proposal, jitter: np.ndarray, even: float) -> Samples:
    """Samples along rays, more of them where the map is dense and not hidden.

    Args:
        rays: The rays.
        box: Where the field is.
        proposal: The map.
        jitter: In 0..1, float32 [R, N + 1] for N samples per ray; 1/2 for pictures.
        even: Share of the samples that is spread evenly.
    """
    r, n = len(rays), jitter.shape[1] - 1
    center, half = torch.tensor(box.center), torch.tensor(box.half)
    origins = ((rays.origins - center) / half).contiguous().numpy()
    directions = (rays.directions / half).contiguous().numpy()
    distances, widths = np.empty((r, n), np.float32), np.empty((r, n), np.float32)
    positions = np.empty((r * n, 3), np.float32)
    reach = np.array([box.near, box.middle, box.far], np.float32)
    run(
        sample.sample, r, RAYS, origins, directions, reach, np.float32(box.unit), proposal.density,
        SIDE, jitter, np.float32(even), distances, widths, positions,
    )  # fmt: skip
    return Samples(torch.from_numpy(distances), torch.from_numpy(widths), positions)


def weights_of(log_density: Tensor, widths: Tensor) -> Tensor:
    """Share of every sample in its ray's colour, [R, N]: T_i (1 - exp(-density_i width_i)).

    Max 1995, equation 3, as in NeRF; nothing limits an opaque first sample, whose share is 1.

    Args:
        log_density: Logarithm of the density per unit [R, N].
        widths: Of the intervals, units [R, N].
    """
    depth = torch.exp(log_density.clamp_max(DENSITY_MAX)) * widths
    # shifted, not the sum minus its own term: behind a dense sample that difference would have lost the earlier terms
    before = torch.nn.functional.pad(torch.cumsum(depth, 1)[:, :-1], (1, 0))
    return torch.exp(-before) * -torch.expm1(-depth)


def without_jitter(rays: int, samples: int) -> np.ndarray:
    """The `jitter` of pictures."""
    return np.full((rays, samples + 1), 0.5, np.float32)
