"""The enhanced pictures, denoised by a small network that learns from them."""

import numpy as np
from torch import Tensor

from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.denoiser_config import FAST_DENOISER
from novags.testbed.stages.seen.enhanced import enhanced
from novags.testbed.stages.seen.raw import codes

STEPS = 300  # of the network; the method trains its own


def pictures(dark: Tensor, seed: int) -> np.ndarray:
    """As `SEEN` says."""
    denoiser = Denoiser(enhanced(dark), FAST_DENOISER, total_steps=STEPS, seed=seed)
    for _ in range(STEPS):
        denoiser.train_step()
    return codes(denoiser.denoise_all())
