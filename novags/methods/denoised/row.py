"""Denoising, then a fit, as a row of `METHODS`."""

from novags.methods.denoised.config import DenoisedConfig, parts
from novags.methods.memory import Memory
from novags.methods.variant import Method
from sensor_model.files.registry import Later

METHOD = Method(
    title="denoise the raw data with a network that was trained on simulated cameras and adapts to the capture, "
    "enhance, then fit as naive does",
    family="2D + GS",
    color="#7a5195",
    config=DenoisedConfig,
    train=Later("novags.methods.denoised.trainer:train"),
    parts=parts,
    source="recorrupted-to-recorrupted (Pang et al. 2021) in the generalised Anscombe domain (Murtagh et al. 1995)",
    memory=Memory(fixed=0.6e9, pictures=4.0, work=100.0),
)
