"""The denoised pictures of a problem, kept beside the checkpoint of the fit that follows, and that fit."""

import dataclasses
import hashlib
import json
import math
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from novags.methods.denoised.config import DenoiseConfig, DenoisedConfig
from novags.methods.denoised.denoiser import denoised
from novags.methods.denoised.measured import MeasuredPictures, measured
from novags.methods.denoised.recorrupted import Teacher
from novags.methods.denoised.weights import PACKAGED
from novags.methods.enhanced.config import EnhancedFitConfig
from novags.methods.enhanced.gaussian_fit import fit_enhanced
from novags.methods.enhancers.applying import enhanced, enhanced_light
from novags.methods.enhancers.choice import Enhancement
from novags.methods.inputs import Pictures
from novags.methods.problem import Problem, gathered
from novags.methods.reconstruction import Progress, Reconstruction
from novags.splats.files.tensors import digest, read, write_tensors
from sensor_model.files.door import read_bytes


def denoised_pictures(
    problem: Problem, config: DenoisedConfig, progress: Progress | None, checkpoint: Path | None,
    teacher: Teacher | None = None,
) -> tuple[Tensor, float]:  # fmt: skip
    """The denoised pictures, linear [C, H, W, 3], and the seconds that they took an interrupted run; 0 if made now.

    They are in the unit of `Problem.linear16`, and kept in `<stem>.denoiser.safetensors` beside the checkpoint.
    A teacher is one of `recorrupted.adapt`.

    Raises:
        LacksInput: If the noise of the data is not known, or not independent.
        ValueError: If the file is damaged or belongs to another run.
    """
    started = time.perf_counter()
    pictures = measured(problem)
    like = pictures.electrons.movedim(1, -1)
    path = None if checkpoint is None else checkpoint.with_name(f"{checkpoint.stem}.denoiser.safetensors")
    identity = _identity(pictures, config.denoise, problem.seed, teacher)
    if path is not None and path.exists():
        tensors = read(path)
        kept, of = tensors.get("linear"), tensors.get("run", torch.empty(0))
        seconds = float(tensors.get("seconds", torch.tensor(torch.nan)))
        if of.dtype != identity.dtype or not torch.equal(of, identity):
            raise ValueError(f"{path} belongs to a run of other pictures or settings: delete it or restore them")
        whole = kept is not None and kept.shape == like.shape and bool(torch.isfinite(kept).all())
        if kept is None or not whole or not 0 <= seconds < math.inf:
            raise ValueError(f"{path} is damaged: delete it, the run then starts over")
        return kept.to(like), seconds
    views = denoised(
        pictures, config.denoise, seed=problem.seed, progress=progress, more=config.fit.iterations, teacher=teacher
    )
    made = gathered(views, like)
    if path is not None:
        took = torch.tensor(time.perf_counter() - started, dtype=torch.float64)
        write_tensors(path, {"linear": made.contiguous(), "run": identity, "seconds": took})
    return made, 0.0


def fit_denoised(
    problem: Problem, config: DenoisedConfig, linear: Tensor, progress: Progress | None, checkpoint: Path | None
) -> Reconstruction:
    """Fit Gaussians to denoised pictures [C, H, W, 3], linear, enhanced with the parameters of the noisy ones."""

    def targets(problem: Problem, enhancer: Enhancement, pictures: Pictures) -> Tensor:
        return gathered(enhanced_light(problem, linear, enhancer, pictures), linear)

    fitting = EnhancedFitConfig(
        pictures=config.pictures, enhance=config.enhance, init_scale=config.init_scale, fit=config.fit
    )
    result = fit_enhanced(problem, fitting, targets, progress, checkpoint)
    result.config = dataclasses.replace(config, fit=result.config.fit)
    result.enhanced = enhanced(problem, config.enhance, config.pictures)
    return result


def _identity(pictures: MeasuredPictures, config: DenoiseConfig, seed: int, teacher: Teacher | None = None) -> Tensor:
    """Hash of everything that the denoised pictures depend on, uint8."""
    content = digest(pictures.electrons, pictures.mask, pictures.read_variance, pictures.unit)
    weights = hashlib.blake2b(read_bytes(PACKAGED)).hexdigest()
    if teacher is not None:
        content += f"{digest(teacher.electrons)} {teacher.weight!r}"
    settings = json.dumps([dataclasses.asdict(config), seed])
    run = hashlib.blake2b((content + weights + settings).encode(), digest_size=16)
    return torch.from_numpy(np.frombuffer(run.digest(), np.uint8).copy())
