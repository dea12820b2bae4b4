"""RawNeRF: a field of linear light, fitted to raw data by a loss that weighs as a tone curve would.

    loss = mean of  ((min(render, white) - datum) / (sg(render) + EPSILON))^2

of Mildenhall et al. 2022, section 4.1; sg holds its argument fixed. Colours are exponentials of the field's outputs.
Data are never clipped at black. Behind a colour filter array only measured channels are compared.

Differences from the original: The field of novags.fields starts dense at the first points, with its steps and rays per
step, and its colours begin at the mean of the data. The data of all views come in one exposure, so that the fit
corrects none. EPSILON is in units of white as there, though pictures here may be darker than its own.
"""

import dataclasses
import time
from pathlib import Path

from torch import Tensor

from novags.fields.training.batch import Batch
from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.applying import enhanced
from novags.methods.light import MeasuredLight, brightness, problem_light, raw_loss
from novags.methods.nerf.fitting import fitted_scene, reconstructed, with_outputs
from novags.methods.nerf.rows.raw_nerf import RawNerfConfig
from novags.methods.nerf.shading import light_of
from novags.methods.noise_estimate import noise_of
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction

DIMMEST = 0.01  # share of the brightest light that the mean is taken for at least: noise can bring it to 0 and below


def train(
    problem: Problem, config: RawNerfConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct the light of a scene from raw frames or linear 16-bit pictures; see `Method.train`.

    Returns:
        A reconstruction in linear light, in the unit of the linear 16-bit pictures.

    Raises:
        LacksInput: If the problem has neither raw frames nor 16-bit linear pictures.
        ValueError: If the pictures hold no light.
    """
    started = time.perf_counter()
    config = dataclasses.replace(config, fit=with_outputs(config.fit, problem, static=0, viewed=3))
    shown = enhanced(problem, config.enhance, config.pictures)
    problem = problem.to("cpu")
    data = problem_light(problem, noise_of(problem), problem.channels_share)
    unit = first_unit(data)
    white = data.white / unit

    def loss(batch: Batch) -> Tensor:
        return raw_loss(light_of(batch.raw, batch.weights), batch.of(data.light) / unit, config.epsilon / unit, white)

    scene, found = fitted_scene(
        problem, loss, config.fit, "light", numbers=numbers_of(data, unit), progress=progress, checkpoint=checkpoint
    )
    return reconstructed(
        scene, found, config, "linear", started, enhanced=shown, found={"unit": unit},
        enhancement=enhancement_record(config.enhance, config.pictures),
    )  # fmt: skip


def first_unit(data: MeasuredLight) -> float:
    """Light of an output of 0, the field's first output: the mean of the data.

    Where it begins brighter than the pictures, it becomes darker by becoming thinner, and loses the first surfaces.
    """
    return max(data.mean(), DIMMEST * brightness(data.light))


def numbers_of(data: MeasuredLight, unit: float) -> dict[str, float]:
    """The numbers that the shading `light` needs to show this light in linear sRGB."""
    if data.matrix is None:
        return {"unit": unit}
    return {"unit": unit, **{f"m{i}{j}": float(data.matrix[i, j]) for i in range(3) for j in range(3)}}
