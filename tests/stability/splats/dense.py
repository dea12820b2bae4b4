"""A second rasteriser, in float64, for the hard cases: one camera that looks along z from the origin.

Written from the formulas of EWA splatting alone, with none of the code that it is a reference for. The footprint's
determinant is a sum of squares (Cauchy and Binet), so that needles keep their digits.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

NAMES = ("means", "quats", "scales", "opacities", "colors")


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with its principal point in the middle of the image."""

    width: int
    height: int
    focal: float

    def matrix(self, dtype: torch.dtype) -> Tensor:
        """K, [3, 3]."""
        rows = [[self.focal, 0, self.width / 2], [0, self.focal, self.height / 2], [0, 0, 1]]
        return torch.tensor(rows, dtype=dtype)


def _turned(quats: Tensor) -> Tensor:
    """Rotation matrices [N, 3, 3] as q v q*, column by column."""
    q = quats / quats.square().sum(1, keepdim=True).sqrt()
    w, axis = q[:, :1], q[:, 1:]
    columns = []
    for v in torch.eye(3, dtype=q.dtype):
        v = v.expand(len(q), 3)
        twice = 2 * torch.linalg.cross(axis, v)
        columns.append(v + w * twice + torch.linalg.cross(axis, twice))
    return torch.stack(columns, 2)


def render(
    means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, colors: Tensor, camera: Camera, eps2d: float = 0.3
) -> tuple[Tensor, Tensor]:
    """Image [H, W, D] and alpha [H, W], differentiable; arguments as in `novags.splats.rasterize`, float64."""
    x, y, z = means.unbind(1)
    half = torch.tensor([camera.width, camera.height], dtype=means.dtype) / 2
    center = camera.focal * means[:, :2] / z[:, None] + half
    limit = (half + 0.15 * 2 * half) / camera.focal
    slope = torch.minimum(torch.maximum(means[:, :2] / z[:, None], -limit), limit)
    J = torch.zeros(len(means), 2, 3, dtype=means.dtype)
    J[:, 0, 0] = J[:, 1, 1] = 1
    J = torch.cat([J[..., :2], -slope[..., None]], 2) * (camera.focal / z)[:, None, None]
    M = J @ (_turned(quats) * scales[:, None, :])
    minors = torch.stack([M[:, 0, i] * M[:, 1, j] - M[:, 0, j] * M[:, 1, i] for i, j in ((0, 1), (0, 2), (1, 2))], 1)
    xx, yy = M.square().sum(2).unbind(1)
    det = minors.square().sum(1) + eps2d * (xx + yy) + eps2d**2
    xy = (M[:, 0] * M[:, 1]).sum(1)
    order = torch.argsort(z.detach(), stable=True)
    order = order[(z[order] > 0.01) & (opacities[order] > 0)]
    rows, columns = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    place = torch.stack([columns, rows], -1).reshape(-1, 1, 2) + 0.5
    dx, dy = (place - center[order]).unbind(2)
    # completed square: det times the exponent is (yy) (dx - xy / yy dy)^2 + det / yy dy^2, where nothing cancels
    across = (yy + eps2d)[order]
    power = across * (dx - xy[order] / across * dy) ** 2 / det[order] + dy**2 / across
    raw = opacities[order] * torch.exp(-0.5 * power)
    alpha = torch.where(raw >= 1 / 255, torch.where(raw > 0.999, 0.999, raw), 0.0)
    log_left = torch.cumsum(torch.log1p(-alpha), 1)
    before = torch.exp(torch.cat([torch.zeros_like(log_left[:, :1]), log_left[:, :-1]], 1))
    weight = torch.where(torch.exp(log_left) >= 1e-4, alpha * before, 0.0)
    image = (weight @ colors[order]).reshape(camera.height, camera.width, -1)
    return image, weight.sum(1).reshape(camera.height, camera.width)
