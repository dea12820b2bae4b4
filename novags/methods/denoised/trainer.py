"""Denoise the raw data, develop, enhance, then fit Gaussians to the result: the limit of 2D denoising alone."""

import time
from pathlib import Path

from novags.methods.denoised.config import DenoisedConfig, parts
from novags.methods.denoised.kept import denoised_pictures, fit_denoised
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction, counted_on


def train(
    problem: Problem, config: DenoisedConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct from denoised pictures.

    Args:
        problem: The problem; its seed and extent override `config.fit`.
        config: All choices.
        progress: Called with (steps done, of how many, losses); steps of the adaptation and of the fit count alike.
        checkpoint: As in `splats.fit`. The denoised pictures are kept beside it, in `<stem>.denoiser.safetensors`.

    Returns:
        A reconstruction whose targets are the denoised pictures, enhanced with the parameters of the noisy ones.
        Seconds: "denoise", "enhance" and "fit".

    Raises:
        LacksInput: If the noise of the data is not known, or not independent.
        ValueError: If a checkpoint is damaged or belongs to another run.
    """
    started = time.perf_counter()
    linear, earlier = denoised_pictures(problem, config, progress, checkpoint)
    denoising = earlier + time.perf_counter() - started

    result = fit_denoised(problem, config, linear, counted_on(progress, parts(config)["denoiser"]), checkpoint)
    result.seconds = {"denoise": denoising, **result.seconds}
    return result
