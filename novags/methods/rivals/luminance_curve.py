"""How Luminance-GS brightens a picture: one curve, bent for each view, on three learned orthogonal axes of colour.

The curve has `BINS` values. A cross-attention between the pose of a view and its picture adds to it; a second one
shapes a power law and an S-curve that the first is drawn to. Written from section 3 of Cui et al. 2025 and the
constants of their program.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

BINS = 255
CELLS = 4  # the picture as the attention sees it has CELLS x CELLS of them
FEATURES = 128


class CurveAttention(nn.Module):
    """Numbers for a view: its pose asks, cells of its picture answer."""

    def __init__(self, outputs: int) -> None:
        super().__init__()
        self.near = nn.Conv2d(3, 64, 3, padding=1)
        self.far = nn.Conv2d(64, FEATURES, 3, padding=1)
        self.query = nn.Linear(16, FEATURES)
        self.key = nn.Linear(FEATURES, FEATURES)
        self.value = nn.Linear(FEATURES, FEATURES)
        self.out = nn.Linear(FEATURES, outputs)
        for layer in (self.near, self.far, self.query, self.key, self.value, self.out):
            assert layer.bias is not None
            nn.init.zeros_(layer.bias)
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, mode="fan_out", nonlinearity="relu")
            else:  # nearly nothing at first
                nn.init.xavier_uniform_(layer.weight, gain=0.01)

    def forward(self, picture: Tensor, pose: Tensor) -> Tensor:
        """[outputs] from a picture [3, H, W] and a camera-to-world matrix [4, 4]."""
        x = F.max_pool2d(torch.relu(self.near(picture[None])), 2)
        cells = F.adaptive_avg_pool2d(torch.relu(self.far(x)), CELLS)[0].flatten(1).T  # [CELLS^2, FEATURES]
        scores = self.key(cells) @ self.query(pose.flatten()) / FEATURES**0.5
        found: Tensor = self.out(scores.softmax(0) @ self.value(cells))
        return found


def orthogonal_axes(first: Tensor, second: Tensor) -> Tensor:
    """Three orthogonal unit vectors, rows of [3, 3].

    Args:
        first: Direction of the first axis [3]; its red part must not be 0.
        second: Green and blue parts of the second [2]; its red part follows.
    """
    red = -(second[0] * first[1] + second[1] * first[2]) / first[0]
    across = torch.cat([red[None], second])
    rows = torch.stack([first, across, torch.linalg.cross(first, across)])
    return rows / torch.linalg.vector_norm(rows, dim=1, keepdim=True)


def mapped(picture: Tensor, axes: Tensor, curve: Tensor) -> Tensor:
    """A picture [H, W, 3] after the curve on each axis.

    The colours 0..1 reach from `low` to `high` along an axis: the curve maps that range to itself. It is looked up
    without interpolation, so that the gradient reaches the curve and the way back from the axes.
    """
    low, high = axes.clamp_max(0).sum(1), axes.clamp_min(0).sum(1)
    place = ((picture @ axes.T - low) / (high - low)).clamp(0, 1)
    found = curve[(place.detach() * (len(curve) - 1)).long()]
    return (found * (high - low) + low) @ axes


def power_then_s(gamma: Tensor, alpha: Tensor, beta: Tensor) -> Tensor:
    """x**gamma, then an S-curve with its turning point at alpha and steepness beta (Kang et al. 2010); [BINS]."""
    x = torch.linspace(0, 1, BINS, device=gamma.device).clamp_min(1e-3) ** gamma  # 0**gamma has an infinite slope
    below = alpha - alpha * (1 - (x / alpha).clamp(0, 1 - 1e-3)) ** beta  # likewise, in both
    above = alpha + (1 - alpha) * ((x - alpha) / (1 - alpha)).clamp(1e-3, 1 - 1e-3) ** beta
    return torch.where(x <= alpha, below, above)


def equalising_curve(picture: Tensor) -> Tensor:
    """The cumulative histogram of a picture [H, W, 3], of every fourth pixel: [BINS], 1 at the end."""
    grey = picture[::4, ::4].mean(-1).cpu()
    counts = torch.histc(grey, BINS, 0, 1).cumsum(0)
    return (counts / counts[-1]).to(picture)


class ViewCurves(nn.Module):
    """The curves and axes of all training views."""

    pictures: Tensor
    small: Tensor
    poses: Tensor

    def __init__(self, pictures: Tensor, viewmats: Tensor, size: int) -> None:
        """Begin with curves that change nothing.

        Args:
            pictures: The dark pictures [C, H, W, 3], 0..1.
            viewmats: World-to-camera matrices [C, 4, 4].
            size: Longest side of the pictures that the attention layers see, px.
        """
        super().__init__()
        self.register_buffer("pictures", pictures, persistent=False)
        height, width = pictures.shape[1:3]
        share = min(1.0, size / max(height, width))
        shape = [max(2, round(share * side)) for side in (height, width)]
        self.register_buffer("small", F.interpolate(pictures.movedim(-1, 1), shape, mode="area"), persistent=False)
        self.register_buffer("poses", torch.linalg.inv(viewmats.double()).float(), persistent=False)
        self.curve = nn.Parameter(torch.linspace(0, 1, BINS))
        self.bend = CurveAttention(BINS)
        self.shape = CurveAttention(3)
        self.first = nn.Parameter(torch.zeros(len(pictures), 3))
        self.second = nn.Parameter(torch.zeros(len(pictures), 2))

    def curves(self, view: int) -> tuple[Tensor, Tensor]:
        """The curve of a view and the shape that it is drawn to, [BINS] each."""
        picture, pose = self.small[view], self.poses[view]
        gamma, alpha, beta = self.shape(picture, pose)
        curve = (self.curve + self.bend(picture, pose)).clamp(0, 1)
        return curve, power_then_s(1 + 0.1 * gamma, 0.5 + 0.002 * alpha, 1 + 0.002 * beta)

    def axes(self, view: int) -> Tensor:
        """The axes of a view, rows of [3, 3]: red, green and blue at first."""
        along = self.first.new_tensor([1.0, 0.0, 0.0])
        return orthogonal_axes(self.first[view] + along, self.second[view] + along[:2])

    def brightened(self, view: int, curve: Tensor) -> Tensor:
        """The picture of a view through a curve on its axes, [H, W, 3]."""
        return mapped(self.pictures[view], self.axes(view), curve)
