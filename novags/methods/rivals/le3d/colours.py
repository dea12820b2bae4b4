"""The colours of LE3D: a network of the features of a Gaussian and of the direction that it is seen in.

    colour = exp(MLP([f, v]) + b)

f are 16 numbers and b is 3 numbers of each Gaussian, v is the unit vector from the camera to it. In training, b lies in
the place of the constant harmonic, whose learning rate it has. Colours are light over a unit.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from novags.methods.gaussian_scene import GaussianScene
from novags.splats.files.tensors import write_tensors
from novags.splats.first_order import first_order
from novags.splats.gaussians import Gaussians
from novags.splats.sh import rgb_to_sh
from novags.splats.views import Views
from sensor_model.files.door import admitted
from sensor_model.files.reading import brief

FEATURES, HIDDEN = 16, 16
SPREAD = 1e-3  # standard deviation of the first features
DARKEST = -5.0  # natural logarithm of the darkest first colour: black has none
FILE = Path("scene") / "colours.safetensors"  # in the folder of a run
OWN = "features", "bias"


class ColourNetwork(nn.Module):
    """The MLP: [N, 16] and unit vectors [N, 3] to [N, 3]; one hidden layer, the last one without a bias."""

    def __init__(self) -> None:
        super().__init__()
        self.inner, self.outer = nn.Linear(FEATURES + 3, HIDDEN), nn.Linear(HIDDEN, 3, bias=False)

    def forward(self, features: Tensor, directions: Tensor) -> Tensor:
        """The logarithm of the colours over exp(b)."""
        weights = self.inner.weight, self.inner.bias, self.outer.weight
        out: Tensor = _InOneThread.apply(features, directions, *weights)
        return out


class _InOneThread(torch.autograd.Function):
    """The layers, by one thread: the last bits of products of matrices depend on the number of threads."""

    @staticmethod
    def forward(ctx: Any, *tensors: Tensor) -> Tensor:
        ctx.save_for_backward(*tensors)
        with one_thread():
            return _layers(*tensors)

    @staticmethod
    @first_order
    def backward(ctx: Any, v_out: Tensor) -> tuple[Tensor, ...]:
        leaves = [tensor.detach().requires_grad_() for tensor in ctx.saved_tensors]
        with one_thread(), torch.enable_grad():
            return torch.autograd.grad(_layers(*leaves), leaves, v_out)


def _layers(features: Tensor, directions: Tensor, inner: Tensor, bias: Tensor, outer: Tensor) -> Tensor:
    hidden = torch.relu(nn.functional.linear(torch.cat([features, directions], 1), inner, bias))
    return nn.functional.linear(hidden, outer)


@contextmanager
def one_thread() -> Iterator[None]:
    """Let torch compute with one thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def directions_from(center: Tensor, means: Tensor) -> Tensor:
    """Unit vectors from a place [3] to others [N, 3]."""
    # eps: a Gaussian exactly at the camera has no direction; without it the normalisation divides by zero
    return nn.functional.normalize(means - center, dim=-1, eps=1e-12)


def seen_from(center: Tensor, means: Tensor, features: Tensor, bias: Tensor, network: ColourNetwork) -> Tensor:
    """Colours [N, 3] of Gaussians at `means` [N, 3] seen from a place [3]; differentiable in all of these."""
    return torch.exp(network(features, directions_from(center, means)) + bias)


def with_first_colours(gaussians: Gaussians, colors: Tensor, network: ColourNetwork, center: Tensor, seed: int) -> None:
    """Give Gaussians, in place, features and biases that show these colours [N, 3] from a place [3]."""
    generator = torch.Generator().manual_seed(seed)
    gaussians.features = SPREAD * torch.randn(len(gaussians), FEATURES, generator=generator).to(gaussians.means)
    with torch.no_grad():
        first = network(gaussians.features, directions_from(center, gaussians.means))
        logs = colors.clamp_min(0).log().clamp_min(DARKEST)
        gaussians.sh = (logs - first)[:, None].contiguous()


@dataclass(frozen=True)
class ColourScene:
    """Gaussians whose colours come from a network.

    Attributes:
        base: The Gaussians; their harmonics are the colours seen from the middle of the training cameras.
        features: f, [N, 16].
        bias: b, [N, 3].
        network: The MLP.
    """

    base: GaussianScene
    features: Tensor
    bias: Tensor
    network: ColourNetwork

    @staticmethod
    def of(base: GaussianScene, network: ColourNetwork, center: Tensor) -> "ColourScene":
        """The scene of trained Gaussians, whose harmonics are the bias; `center`: of the training cameras [3]."""
        g = base.gaussians
        assert g.features is not None
        features, bias = g.features, g.sh[:, 0].contiguous()
        with torch.no_grad():
            colors = seen_from(center, g.means, features, bias, network)
        plain = replace(g, sh=rgb_to_sh(colors)[:, None], features=None)
        return ColourScene(replace(base, gaussians=plain), features, bias, network)

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        """As `ReconstructedScene` says."""
        means = self.base.gaussians.means
        with torch.no_grad():
            each = [seen_from(center, means, self.features, self.bias, self.network) for center in views.centers]
        images, alphas = self.base.splatted(torch.stack(each), views, render_mode="RGB+ED")
        return self.base.shown(images[..., :3]), alphas[..., 0], images[..., 3]

    def save(self, folder: Path) -> None:
        """Write point_cloud.ply, of one colour from all sides, and scene/colours.safetensors, which has all others."""
        self.base.save(folder)
        (folder / FILE).parent.mkdir(exist_ok=True)
        own = dict(zip(OWN, (self.features, self.bias), strict=True))
        write_tensors(folder / FILE, {**own, **self.network.state_dict()})

    def facts(self) -> dict[str, Any]:
        """Facts about the Gaussians, and the size of the network."""
        return {**self.base.facts(), "colours": {"parameters": sum(p.numel() for p in self.network.parameters())}}


def with_colours(base: GaussianScene, folder: Path) -> "GaussianScene | ColourScene":
    """The scene of a run's folder, whose Gaussians are `base`; they themselves if it has no network of colours.

    Raises:
        ValueError: If its file is damaged, or of other Gaussians.
    """
    path = folder / FILE
    if not path.is_file():
        return base
    try:
        return _assembled(base, load_file(admitted(path)))
    except (SafetensorError, KeyError, RuntimeError, ValueError) as error:
        reason = brief(f"{type(error).__name__}: {error}")
        raise ValueError(f"{path} has not the colours of this scene ({reason}): reconstruct again") from error


def _assembled(base: GaussianScene, tensors: Mapping[str, Tensor]) -> ColourScene:
    if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors.values()):
        raise ValueError("its numbers must be finite")
    features, bias = (tensors[name].float() for name in OWN)
    wanted = [(len(base.gaussians), width) for width in (FEATURES, 3)]
    if (found := [tuple(tensor.shape) for tensor in (features, bias)]) != wanted:
        raise ValueError(f"features and bias must be {wanted}, as point_cloud.ply has it, got {found}")
    network = ColourNetwork()
    network.load_state_dict({name: value for name, value in tensors.items() if name not in OWN})
    return ColourScene(base, features, bias, network)
