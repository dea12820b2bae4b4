"""The methods by name. All share one enhancement and one fit configuration, so that they differ in their idea alone."""

from dataclasses import replace
from pathlib import Path

from novags.methods import enhance_then_fit as naive
from novags.methods import oracle
from novags.methods.enhance_then_fit import NaiveConfig
from novags.methods.nova import trainer
from novags.methods.nova.trainer import NovaConfig, Progress
from novags.methods.problem import MethodInput, MethodResult
from sensor_model import Sensor

METHODS = {
    "nova": "the paper: enhance, denoise with a network that learns from the noisy images alone, fit with geometric "
    "consistency and a penalty on view-dependent colour that follows the noise",
    "naive": "enhance, then fit the noisy images with the same loss (L1 and D-SSIM)",
    "naive-l1": "enhance, then fit the noisy images with L1 alone, which averages noise over the views",
    "oracle": "enhance the noise-free exposures, then fit: what no real method can see, so the ceiling",
}


def method_config(method: str, nova: NovaConfig) -> NovaConfig | NaiveConfig:
    """What `method` makes of the shared configuration.

    Raises:
        ValueError: If there is no such method.
    """
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; there are {', '.join(METHODS)}")
    if method == "nova":
        return nova
    shared = NaiveConfig(enhance=nova.enhance, init_scale=nova.init_scale, fit=nova.fit)
    return shared.with_l1() if method == "naive-l1" else shared


def suited(nova: NovaConfig, sensor: Sensor, *, color_matrix: bool = False) -> NovaConfig:
    """The settings for pictures of this camera: where the channels of a pixel share their noise, all are blinded.

    Demosaicing and a colour matrix make them share it; a network that sees two of them knows the third one's.
    """
    spots = nova.denoiser.blind_spots
    if (sensor.cfa is None and not color_matrix) or not spots.per_channel:
        return nova
    return replace(nova, denoiser=replace(nova.denoiser, blind_spots=replace(spots, per_channel=False)))


def train(
    method: str, inputs: MethodInput, config: NovaConfig | NaiveConfig, progress: Progress, checkpoint: Path
) -> MethodResult:
    """Run `method` with its `method_config`; goes on from the checkpoint if there is one."""
    if isinstance(config, NovaConfig):
        return trainer.train(inputs, config, progress=progress, checkpoint=checkpoint)
    module = oracle if method == "oracle" else naive
    return module.train(inputs, config, progress=progress, checkpoint=checkpoint)
