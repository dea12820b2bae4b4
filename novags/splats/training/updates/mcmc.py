"""3DGS as Markov chain Monte Carlo (Kheradmand et al. 2024): relocation of dead Gaussians, growth, Langevin noise."""

import math

import numpy as np
import torch
from torch import Tensor

from ...cpu.parallel import run
from ...cpu.training import noise
from ...gaussians import Gaussians
from ...raster.raster_torch import quat_to_rotmat

DEAD_OPACITY = 0.005  # at or below, a Gaussian shows nothing and is moved
# In extents of the scene. Noise grows with the covariance: a faint haze of ten extents would be thrown a thousand away.
FARTHEST = 1.0
NODES, REACH = 128, 7.0  # trapezoid rule of the relocation integral; exp(-7^2) is below one float64 step
ROWS = 16_384  # whose integrands are evaluated at once: at 1 KB a Gaussian, all seeds at once would take gigabytes


def relocation(opacities: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """Opacity, and factor of the scale, of each of N coinciding Gaussians that together look like one (paper's eq. 9).

    The paper's scale factor is o / sum_i sum_k binom(i-1, k) (-1)^k o'^(k+1) / sqrt(k+1), with o' = 1 - (1 - o)^(1/N).
    Its alternating sum overflows and cancels for large N. Summed over i it is the line integral

        sum = 2 / sqrt(pi) * integral_0^inf 1 - (1 - o' exp(-x^2))^N dx

    of the N-fold alpha, whose integrand is positive; the trapezoid rule converges to rounding for this smooth even
    function.

    Args:
        opacities: [M], 0 < o < 1.
        copies: N >= 1 [M], integer: the Gaussian itself and those moved onto it.

    Returns:
        New opacities, not yet clamped, and factors of the scales, [M] in the input's dtype.
    """
    o, n = opacities.double(), copies.double()
    log_left = torch.log1p(-o) / n  # ln(1 - o')
    new = -torch.expm1(log_left)
    total = torch.cat([_integral(*rows) for rows in zip(new.split(ROWS), n.split(ROWS), strict=True)])
    return new.to(opacities.dtype), (o / total).to(opacities.dtype)


def _integral(new: Tensor, n: Tensor) -> Tensor:
    """The line integral of `relocation` for opacities o' [M] and copies [M], float64."""
    x = torch.linspace(0, REACH, NODES, dtype=torch.float64, device=new.device)
    integrand = -torch.expm1(n[:, None] * torch.log1p(-new[:, None] * torch.exp(-x * x)))
    return 2 / np.sqrt(np.pi) * torch.trapezoid(integrand, x, dim=-1)


def _draw(weights: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Indices [count] drawn with replacement in proportion to weights [N]; sums in float64 keep small weights."""
    edges = torch.cumsum(weights.double(), 0)
    u = torch.rand(count, generator=generator, dtype=torch.float64).to(weights.device) * edges[-1]
    return torch.searchsorted(edges, u, right=True).clamp_max(len(weights) - 1)


def _split(gaussians: Gaussians, sources: Tensor) -> None:
    """Shrink the drawn Gaussians in place so that they and their copies together look like before."""
    drawn = torch.zeros_like(gaussians.logit_opacities, dtype=torch.int64)
    copies = 1 + drawn.index_add_(0, sources, torch.ones_like(sources))[sources]
    # A Gaussian that was drawn twice is worked on twice, from the same numbers; to ask for those that differ would have
    # a GPU waited for. float64: the sigmoid of a logit above 17 is 1 in float32.
    opacities, factors = relocation(torch.sigmoid(gaussians.logit_opacities[sources].double()), copies)
    # eps: an opacity of exactly 1 has an infinite logit
    opacities = opacities.clamp(DEAD_OPACITY, 1 - torch.finfo(torch.float64).eps)
    gaussians.logit_opacities[sources] = torch.logit(opacities).float()
    # in logs: float32 cannot hold a scale below e^-103 or above e^88
    gaussians.log_scales[sources] = gaussians.log_scales[sources] + torch.log(factors).float()[:, None]


@torch.no_grad()
def relocate(gaussians: Gaussians, generator: torch.Generator, dead: Tensor | None = None) -> Tensor:
    """Move dead Gaussians, in place, onto live ones drawn in proportion to opacity.

    Args:
        gaussians: Changed in place.
        generator: Of the draws, on the CPU.
        dead: Indices of the dead ones, in order, where they are known already.

    Returns:
        Indices of the live Gaussians that were drawn, some several times; their Adam moments have to be reset. Empty if
        no Gaussian is dead or all are.
    """
    if dead is None:
        dead = torch.nonzero(gaussians.opacities <= DEAD_OPACITY)[:, 0]
    if len(dead) == 0 or len(dead) == len(gaussians):
        return dead[:0]
    weights = gaussians.opacities.index_fill(0, dead, 0.0)  # which are never drawn
    sources = _draw(weights, len(dead), generator)
    _split(gaussians, sources)
    for tensor in gaussians.tensors().values():
        tensor[dead] = tensor[sources]
    return sources


@torch.no_grad()
def grow(gaussians: Gaussians, target: int, generator: torch.Generator) -> tuple[Gaussians, Tensor]:
    """Add copies of Gaussians drawn in proportion to opacity until there are `target`.

    Returns:
        The grown Gaussians (new rows last; the same object if there is nothing to add), and the indices that were
        drawn, some several times.
    """
    count = target - len(gaussians)
    if count <= 0 or len(gaussians) == 0:
        return gaussians, torch.empty(0, dtype=torch.int64)
    sources = _draw(gaussians.opacities, count, generator)
    _split(gaussians, sources)
    grown = {name: torch.cat([tensor, tensor[sources]]) for name, tensor in gaussians.tensors().items()}
    return Gaussians(**grown), sources


@torch.no_grad()
def prune_to_cap(gaussians: Gaussians, cap: int, generator: torch.Generator) -> Gaussians:
    """The `cap` most opaque Gaussians in their old order, ties drawn at random; the same object if no more."""
    if len(gaussians) <= cap:
        return gaussians
    shuffled = torch.randperm(len(gaussians), generator=generator).to(gaussians.means.device)
    ranking = torch.argsort(gaussians.opacities[shuffled], descending=True, stable=True)
    keep = torch.sort(shuffled[ranking[:cap]]).values
    return Gaussians(**{name: tensor[keep].clone() for name, tensor in gaussians.tensors().items()})


@torch.no_grad()
def add_noise(
    gaussians: Gaussians, amount: float, generator: torch.Generator, *, limit: float = math.inf,
    good: Tensor | None = None,
) -> None:  # fmt: skip
    """Langevin step, in place: means += Sigma xi amount sigmoid(100 (0.005 - o)), xi ~ N(0, 1).

    Args:
        gaussians: Changed in place.
        amount: noise_lr times the current learning rate of the means.
        generator: Source of xi, on the CPU.
        limit: Farthest step along an axis of a Gaussian, world units; longer ones end there.
        good: On a GPU: 0-d bool; where it is False nothing changes.
    """
    g = gaussians
    if g.means.device.type == "cpu":
        key = np.uint64(int(torch.randint(2**63 - 1, (1,), generator=generator)))
        arrays = (t.numpy() for t in (g.means, g.quats, g.log_scales, g.logit_opacities))
        run(noise.add, len(g), 1024, *arrays, np.float32(amount), np.float32(limit), key)
    else:
        _add_noise_torch(g, amount, generator, limit, good)


def _add_noise_torch(
    g: Gaussians, amount: float, generator: torch.Generator, limit: float = math.inf, good: Tensor | None = None
) -> None:
    xi = torch.randn(len(g), 3, generator=generator).to(g.means.device)
    xi *= amount * torch.sigmoid(100 * (DEAD_OPACITY - g.opacities))[:, None]
    R = quat_to_rotmat(g.quats)
    local = ((R.mT @ xi[..., None])[..., 0] * torch.exp(2 * g.log_scales)).clamp(-limit, limit)
    step = (R @ local[..., None])[..., 0]
    g.means += step if good is None else torch.where(good, step, 0.0)
