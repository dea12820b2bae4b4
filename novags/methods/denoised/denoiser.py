"""The trained denoiser on the pictures of one capture: for single pictures, and for the methods that use it."""

from dataclasses import replace

from torch import Tensor

from novags.methods.denoised.config import DenoiseConfig
from novags.methods.denoised.estimate import estimate_all
from novags.methods.denoised.measured import MeasuredPictures
from novags.methods.denoised.recorrupted import adapt
from novags.methods.denoised.weights import load_weights
from novags.methods.problem import gathered
from novags.methods.reconstruction import Progress


def denoised(
    pictures: MeasuredPictures, config: DenoiseConfig, *, seed: int, progress: Progress | None = None, more: int = 0
) -> Tensor:
    """The pictures without noise, in linear light [C, H, W, 3], clipped and in the unit of `MeasuredPictures.linear`.

    Args:
        pictures: The measurements.
        config: All choices.
        seed: Of the adaptation.
        progress: As for `recorrupted.adapt`.
        more: As for `recorrupted.adapt`.
    """
    network = load_weights().to(pictures.electrons.device)
    adapted = None if config.adapt is None else adapt(
        network, pictures, config.adapt, seed=seed, progress=progress, more=more
    )  # fmt: skip

    def estimated(view: Tensor) -> Tensor:
        if adapted is not None:
            return adapted.estimate_all(replace(pictures, electrons=view), turns=config.turns)
        return estimate_all(network, view, pictures.mask, pictures.read_variance, turns=config.turns)

    views = (pictures.linear(estimated(view))[0] for view in pictures.electrons.split(1))
    return gathered(views, pictures.electrons.movedim(1, -1))
