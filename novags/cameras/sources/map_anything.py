"""The network MapAnything."""

from dataclasses import dataclass
from pathlib import Path

from novags.cameras.settings import Known, Pictures, check_drop, check_kind, check_one_of
from novags.cameras.source import CameraConfig, CameraSource
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class MapAnythingConfig(CameraConfig):
    """Weights, what the network is told, and which of its depths to believe."""

    checkpoint: Path  # model.safetensors of map-anything-apache or map-anything, with config.json beside it
    pictures: Pictures = "raw"  # which pictures are used; the caller provides them
    known: Known = "lenses"  # which of the set's cameras it is told; "cameras": they stay, its depths give first points
    drop_percent: float = 30.0  # of all pixels, the share with the least confident depth, which gives no points

    def __post_init__(self) -> None:
        check_kind("map-anything", self.pictures)
        check_one_of("known of map-anything", self.known, Known)
        check_drop("map-anything", self.drop_percent)


SOURCE = CameraSource(
    "the network MapAnything, your own installation and weights (Apache-2.0 or CC BY-NC)",
    MapAnythingConfig,
    Later("novags.cameras.networks.map_anything:check_installed"),
    Later("novags.cameras.networks.map_anything:map_anything_cameras"),
    "pictures and cameras",
)
