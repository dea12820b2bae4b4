"""After Denoise-GS: a denoiser is refined by renders of the fit to what it denoised, and a second fit follows.

The publication: a Noise2Void U-Net for each scene, sparse views, a first reconstruction; then the U-Net is trained on
by a joint loss on its own pictures and on renders, and the scene is reconstructed again. Its losses and weights are not
public.

Here the network is the one of `denoise-gs`, which knows the noise of the camera. In the second round it adapts anew,
from

    recorrupted copies of the data  +  render_weight * mean of (estimate - render)**2 / variance,

both in units of the noise of the data. A render is of enhanced pictures: it goes back to electrons by the factor that
the enhancement gave each denoised pixel. Pixels that the enhancement clipped, and black ones, have no such factor and
teach nothing. How far the refined network is followed is decided by the data alone, as in the first round (`blend`).
Both fits begin at the first points and have all iterations.
"""

import dataclasses
import time
from collections.abc import Iterable
from pathlib import Path

import torch
from torch import Tensor

from novags.methods.denoised.config import parts as one_round
from novags.methods.denoised.kept import denoised_pictures, fit_denoised
from novags.methods.denoised.measured import MeasuredPictures, measured
from novags.methods.denoised.recorrupted import Teacher
from novags.methods.problem import Problem, encode
from novags.methods.reconstruction import Progress, Reconstruction, counted_on
from novags.methods.rivals.rows.denoised_twice import DenoisedTwiceConfig
from sensor_model.isp import srgb_to_linear


def train(
    problem: Problem, config: DenoisedTwiceConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct from pictures that were denoised with the help of a first reconstruction.

    Args:
        problem: The problem; its seed and extent override `config.fit`.
        config: All choices.
        progress: Called with (steps done, of how many, losses); all steps of both rounds count.
        checkpoint: As in `splats.fit`, of the second fit; the first has its own in the folder `checkpoints` beside it,
            and each round keeps its denoised pictures as `denoise-gs` does.

    Returns:
        A reconstruction whose targets are the pictures of the second round. Seconds: "denoise" and "fit" of both rounds
        together, "enhance".

    Raises:
        LacksInput: If the noise of the data is not known, or not independent.
        ValueError: If a checkpoint is damaged or belongs to another run.
    """
    early = checkpoint and checkpoint.parent / "checkpoints" / checkpoint.name
    adapting = one_round(config)["denoiser"]
    once = adapting + config.fit.iterations
    alone = dataclasses.replace(config, fit=dataclasses.replace(config.fit, keep_at=()))

    started = time.perf_counter()
    linear, spent = denoised_pictures(problem, alone, counted_on(progress, 0, once), early)
    denoising = spent + time.perf_counter() - started
    first = fit_denoised(problem, alone, linear, counted_on(progress, adapting, once), early)
    first.enhanced = None  # as many floats as all pictures have, and so is each of what follows
    cameras = problem.views if first.viewmats is None else dataclasses.replace(problem.views, viewmats=first.viewmats)
    assert first.targets is not None
    renders = (first.render(camera)[0][0] for camera in cameras.each())
    teacher = Teacher(electrons_of(renders, linear, first.targets, measured(problem)), config.render_weight)
    fitting = first.seconds["fit"]
    del first, linear, renders

    started = time.perf_counter()
    again, spent = denoised_pictures(problem, config, counted_on(progress, once), checkpoint, teacher)
    del teacher
    denoising += spent + time.perf_counter() - started
    result = fit_denoised(problem, config, again, counted_on(progress, once + adapting), checkpoint)
    result.seconds = {"denoise": denoising, **result.seconds, "fit": fitting + result.seconds["fit"]}
    return result


def electrons_of(renders: Iterable[Tensor], linear: Tensor, enhanced: Tensor, pictures: MeasuredPictures) -> Tensor:
    """Renders of enhanced pictures as the electrons that a camera would have counted on average.

    Args:
        renders: [H, W, 3], enhanced, view by view.
        linear: The pictures before the enhancement, linear light [C, H, W, 3].
        enhanced: The same after it.
        pictures: The measurements, for their units.

    Returns:
        [C, 3, H, W]; NaN where the enhancement has no factor.
    """
    found = torch.empty_like(pictures.electrons)
    back = None if pictures.matrix is None else torch.linalg.inv(pictures.matrix)
    for place, render, light, bright in zip(found, renders, linear, enhanced, strict=True):
        code = torch.from_numpy(encode(light.cpu().numpy())).to(bright)
        known = (code > 0) & (bright > 0) & (bright < 1)
        dark = (render.clamp_min(0) * code / bright).clamp_max(1).masked_fill(~known, torch.nan)
        shown = torch.from_numpy(srgb_to_linear(dark.cpu().numpy())).to(place)
        place.copy_(((shown if back is None else shown @ back.T) / pictures.unit).movedim(-1, 0))
    return found
