"""What a trained denoiser is measured against, each with the strength that suits the pictures best by their truth."""

from collections.abc import Callable

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import roots_hermitenorm
from scipy.stats import poisson
from skimage.restoration import cycle_spin, denoise_nl_means, denoise_wavelet
from torch import Tensor

from novags.methods.denoised.anscombe import Anscombe
from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.denoiser_config import FAST_DENOISER

Planes = NDArray[np.float32]  # [H, W, D] in units of the noise
BLURS = (0.4, 0.6, 0.8, 1.0, 1.2, 1.5, 1.8, 2.2, 2.8, 3.5)  # px
STRENGTHS = (0.5, 0.65, 0.8, 1.0)  # of non-local means, in units of the noise
N2V_STEPS = 400

Filter = Callable[[Planes], Planes]


def blur(sigma: float) -> Filter:
    return lambda planes: _planes(cv2.GaussianBlur(planes, (0, 0), sigma), planes)


def non_local_means(strength: float) -> Filter:
    """Buades, Coll, Morel 2005, all channels of a pixel compared together."""

    def run(planes: Planes) -> Planes:
        return denoise_nl_means(
            planes, patch_size=5, patch_distance=7, h=strength, sigma=1.0, fast_mode=True, channel_axis=-1
        ).astype(np.float32)

    return run


def wavelets(_: float) -> Filter:
    """BayesShrink (Chang, Yu, Vetterli 2000), averaged over shifts of the picture (Coifman, Donoho 1995)."""

    def run(planes: Planes) -> Planes:
        low, high = float(planes.min()), float(np.ptp(planes)) or 1.0
        how = {"sigma": 1.0 / high, "method": "BayesShrink", "mode": "soft", "rescale_sigma": False, "channel_axis": -1}
        found = cycle_spin((planes - low) / high, denoise_wavelet, max_shifts=3, shift_steps=1, workers=1,
                           func_kw=how, channel_axis=-1)  # fmt: skip
        return (low + high * found).astype(np.float32)

    return run


FILTERS: dict[str, tuple[Callable[[float], Filter], tuple[float, ...]]] = {
    "Gaussian blur": (blur, BLURS),
    "non-local means": (non_local_means, STRENGTHS),
    "wavelets": (wavelets, (1.0,)),
}


def _planes(found: Planes, like: Planes) -> Planes:
    return found.reshape(like.shape)


def filtered(electrons: Tensor, cfa: str | None, read_variance: Tensor, run: Filter) -> Tensor:
    """Pictures through a filter that expects noise of variance 1, and back without bias.

    Args:
        electrons: [C, H, W] of a mosaic, whose four half-size planes are filtered as the channels of one picture, or
            [C, 3, H, W] of three chips.
        cfa: The filter array, None for three chips.
        read_variance: One number, electrons**2.
        run: The filter.

    Returns:
        The shape of `electrons`.
    """
    stabilised = Anscombe(read_variance)
    back = unbiased_inverse(float(read_variance), float(electrons.max()))
    found = []
    for picture in electrons:
        planes = picture if cfa is None else torch.nn.functional.pixel_unshuffle(picture[None], 2)
        values = run(np.ascontiguousarray(stabilised(planes).permute(1, 2, 0).numpy()))
        means = torch.from_numpy(back(values)).permute(2, 0, 1)
        found.append(means if cfa is None else torch.nn.functional.pixel_shuffle(means, 2)[0])
    return torch.stack(found)


def unbiased_inverse(read_variance: float, largest: float) -> Callable[[Planes], Planes]:
    """The exact unbiased inverse (Maekitalo, Foi 2013): from E T(y) back to the mean of y, by a table."""
    means = np.concatenate([[0.0], np.geomspace(1e-3, max(largest, 10.0), 300)])
    stabilised = Anscombe(torch.tensor(read_variance, dtype=torch.float64))
    nodes, weights = roots_hermitenorm(24)
    spread = np.sqrt(read_variance) * nodes
    expected = np.empty_like(means)
    for i, mean in enumerate(means):
        reach = 9 * np.sqrt(mean) + 12
        counts = np.arange(max(0, int(mean - reach)), int(mean + reach) + 1)
        values = stabilised(torch.from_numpy(counts[:, None] + spread[None])).numpy()
        expected[i] = poisson.pmf(counts, mean) @ values @ weights / weights.sum()
    return lambda planes: np.interp(planes, expected, means).astype(np.float32)


def noise_to_void(enhanced: Tensor, seed: int) -> Tensor:
    """The blind-spot denoiser of NOVA-GS on enhanced pictures [C, H, W, 3], trained on them alone."""
    network = Denoiser(enhanced, FAST_DENOISER, total_steps=N2V_STEPS, seed=seed)
    for _ in range(N2V_STEPS):
        network.train_step()
    return network.denoise_all()


__all__ = ["FILTERS", "N2V_STEPS", "filtered", "noise_to_void"]
