"""The trained denoiser on the pictures of one capture: for single pictures, and for the methods that use it."""

from collections.abc import Iterator
from dataclasses import replace

from torch import Tensor

from novags.methods.denoised.config import DenoiseConfig
from novags.methods.denoised.estimate import estimate_all
from novags.methods.denoised.measured import MeasuredPictures
from novags.methods.denoised.recorrupted import Teacher, adapt
from novags.methods.denoised.weights import load_weights
from novags.methods.reconstruction import Progress


def denoised(
    pictures: MeasuredPictures, config: DenoiseConfig, *, seed: int, progress: Progress | None = None, more: int = 0,
    teacher: Teacher | None = None,
) -> Iterator[Tensor]:  # fmt: skip
    """The pictures without noise, one by one, in linear light [H, W, 3], as `MeasuredPictures.linear` gives it.

    Args:
        pictures: The measurements.
        config: All choices.
        seed: Of the adaptation.
        progress: As for `recorrupted.adapt`.
        more: As for `recorrupted.adapt`.
        teacher: As for `recorrupted.adapt`.
    """
    network = load_weights().to(pictures.electrons.device)
    adapted = None if config.adapt is None else adapt(
        network, pictures, config.adapt, seed=seed, progress=progress, more=more, teacher=teacher
    )  # fmt: skip

    def estimated(view: Tensor) -> Tensor:
        if adapted is not None:
            return adapted.estimate_all(replace(pictures, electrons=view), turns=config.turns)
        return estimate_all(network, view, pictures.mask, pictures.read_variance, turns=config.turns)

    return (pictures.linear(estimated(view))[0] for view in pictures.electrons.split(1))
