"""MBLLEN (Lv et al. 2018, "MBLLEN: Low-light Image/Video Enhancement Using CNNs").

Ten convolutions one after the other extract features; from each, a small network of its own goes down by three and up
by three convolutions to a picture, and a last convolution mixes the ten pictures. Keras gave the layers of the official
files their names; the files are converted on reading.

The last steps of the authors' program are kept, with its defaults: if fewer than 5 % of the pixels are brighter than
0.8, the picture is multiplied until the 95th percentile is there; the 5th percentile becomes black; the saturation S
becomes S^0.8. The factor and the percentile are parameters of a picture, which its twin shares.

Deviations: the grey level takes 0.114 of blue, where the program takes it of green again; values below the 5th
percentile are cut at black before the saturation, not after; pictures smaller than 13 px are extended by their border.
It does not learn from a scene: it needs pairs.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.methods.enhancers.networks.kind import Kind
from novags.methods.enhancers.networks.rows.mbllen import MbllenConfig

BRANCHES = 10
SMALLEST = 13  # px: three valid convolutions of 5 x 5 leave one pixel
GREY = (0.299, 0.587, 0.114)
BRIGHT, HIGH, LOW, SATURATION = 0.8, 0.95, 0.05, 0.8  # level, quantiles, exponent


class Mbllen(nn.Module):
    """The network."""

    def __init__(self) -> None:
        super().__init__()
        for k in range(BRANCHES):
            widths = [(32, 8, 3), (8, 8, 5), (8, 16, 5), (16, 32, 5)]
            self.add_module(f"conv2d_{5 * k + 1}", nn.Conv2d(32 if k else 3, 32, 3, padding=1))
            for i, (inputs, outputs, size) in enumerate(widths):
                made = nn.Conv2d(inputs, outputs, size, padding=1 if i == 0 else 0)
                self.add_module(f"conv2d_{5 * k + 2 + i}", made)
            for i, (inputs, outputs) in enumerate([(32, 16), (16, 8), (8, 3)]):
                self.add_module(f"conv2d_transpose_{3 * k + 1 + i}", nn.ConvTranspose2d(inputs, outputs, 5))
        self.add_module(f"conv2d_{5 * BRANCHES + 1}", nn.Conv2d(3 * BRANCHES, 3, 1))

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, 3, H, W] in 0..1, H and W at least 13 -> the same shape, at least 0."""
        pictures, features = [], x
        for k in range(BRANCHES):
            features = self._through(f"conv2d_{5 * k + 1}", features)
            branch = features
            for i in range(4):
                branch = self._through(f"conv2d_{5 * k + 2 + i}", branch)
            for i in range(3):
                branch = self._through(f"conv2d_transpose_{3 * k + 1 + i}", branch)
            pictures.append(branch)
        return self._through(f"conv2d_{5 * BRANCHES + 1}", torch.cat(pictures, 1))

    def _through(self, name: str, x: Tensor) -> Tensor:
        return F.relu(self.get_submodule(name)(x))


def from_keras(tensors: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
    """Tensors of an official file under the names and in the order of axes of this network; others unchanged."""
    kinds = {"kernel:0": "weight", "bias:0": "bias"}
    found = {}
    for path, value in tensors.items():
        layer, _, kind = path.rpartition("/")
        if kind in kinds:
            # height, width, in, out -> out, in, height, width; of a transposed one in and out are the other way round
            turned = value.permute(3, 2, 0, 1) if value.ndim == 4 else value
            found[f"{layer.rpartition('/')[2]}.{kinds[kind]}"] = turned.contiguous()
        else:
            found[path] = value
    return found


def run(network: nn.Module, picture: Tensor, config: MbllenConfig) -> Tensor:
    """A picture [1, 3, H, W] of any size through the network, not adjusted."""
    height, width = picture.shape[2:]
    margin = (0, max(0, SMALLEST - width), 0, max(0, SMALLEST - height))
    bright: Tensor = network(F.pad(picture, margin, mode="replicate"))
    return bright[..., :height, :width]


def adjust(bright: Tensor, config: MbllenConfig, params: np.ndarray | None) -> tuple[Tensor, np.ndarray]:
    """The program's last steps on a result [1, 3, H, W]; factor and black level [2] are chosen if they are not
    given.
    """
    if params is None:
        params = _chosen(bright.double()) if config.adjusted else np.array([1.0, 0.0])
    if not config.adjusted:
        return bright, params
    factor, black = params
    shown = (bright * factor).clamp(0, 1)
    shown = ((shown - black) / (1 - black)).clamp(0, 1)
    value, low = shown.amax(1, keepdim=True), shown.amin(1, keepdim=True)
    # Grey has no saturation to raise, and 0 to a negative power would be infinite.
    saturation = torch.where(value > low, (value - low) / value.clamp_min(1e-12), torch.ones_like(value))
    return value - (value - shown) * saturation ** (SATURATION - 1), params


def _chosen(bright: Tensor) -> np.ndarray:
    def grey(picture: Tensor) -> np.ndarray:
        return (picture * picture.new_tensor(GREY)[:, None, None]).sum(1).cpu().numpy()

    level = grey(bright)
    high = float(np.quantile(level, HIGH))
    few = (level >= BRIGHT).sum() < (1 - HIGH) * (level <= 1).sum()
    factor = BRIGHT / high if few and high > 0 else 1.0
    # Below 1: a white picture would have nothing between black and white.
    black = min(float(np.quantile(grey((bright * factor).clamp_max(1)), LOW)), 0.99)
    return np.array([factor, black])


def typical(params: Sequence[np.ndarray]) -> np.ndarray:
    """`Enhancer.typical`: the mean of factors and black levels."""
    return np.mean(params, 0)


MBLLEN = Kind(
    name="MBLLEN", make=lambda config: Mbllen(), run=run, renamed=from_keras, finish=adjust,
    where="one of the authors' .h5 files, or a file of the same network, trained here",
)  # fmt: skip
enhance = MBLLEN.enhance
