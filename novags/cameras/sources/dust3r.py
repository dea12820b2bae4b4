"""The network DUSt3R."""

from dataclasses import dataclass
from pathlib import Path

from novags.cameras.settings import Pictures, check_drop, check_kind
from novags.cameras.source import CameraConfig, CameraSource
from novags.numbers import STEPS, check_range
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class Dust3rConfig(CameraConfig):
    """Weights, which pairs are looked at, how long they are aligned, and which points to believe."""

    checkpoint: Path  # DUSt3R_ViTLarge_BaseDecoder_512_*: model.safetensors with config.json beside it, or the .pth
    pictures: Pictures = "raw"  # which pictures are used; the caller provides them
    pairs: str = "complete"  # scene graph of its make_pairs: complete, swin-5, logwin-4, oneref, ...
    iterations: int = 300  # of the global alignment
    drop_percent: float = 30.0  # of all pixels, the share with the least confident points, which give none

    def __post_init__(self) -> None:
        check_kind("dust3r", self.pictures)
        check_drop("dust3r", self.drop_percent)
        check_range("iterations of dust3r", self.iterations, 1, STEPS)


SOURCE = CameraSource(
    "the network DUSt3R, by your own installation and weights",
    Dust3rConfig,
    Later("novags.cameras.networks.dust3r:check_installed"),
    Later("novags.cameras.networks.dust3r:dust3r_cameras"),
    "pictures",
)
