"""The network Depth Anything 3."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from novags.cameras.settings import Pictures, check_drop, check_kind, check_one_of
from novags.cameras.source import CameraConfig, CameraSource
from sensor_model.files.registry import Later

Network = Literal["da3-small", "da3-base", "da3-large", "da3-giant"]
Da3Known = Literal["nothing", "cameras"]  # it takes no lens without a pose


@dataclass(frozen=True, kw_only=True)
class Da3Config(CameraConfig):
    """Weights, which network they are of, what it is told, and which of its depths to believe."""

    checkpoint: Path  # model.safetensors of DA3-SMALL, -BASE, -LARGE or -GIANT
    network: Network = "da3-base"  # whose weights these are, by the name of the package's preset
    pictures: Pictures = "raw"  # which pictures are used; the caller provides them
    known: Da3Known = "nothing"  # of the set's cameras, what it is told; "cameras": they stay, depths give first points
    rays: bool = False  # cameras from the rays of all pixels: slower and more accurate than from one token a view
    drop_percent: float = 30.0  # of all pixels, the share with the least confident depth, which gives no points

    def __post_init__(self) -> None:
        check_kind("da3", self.pictures)
        check_drop("da3", self.drop_percent)
        check_one_of("network of da3", self.network, Network)
        check_one_of("known of da3", self.known, Da3Known)


SOURCE = CameraSource(
    "the network Depth Anything 3, your own installation and weights (Apache-2.0 or CC BY-NC)",
    Da3Config,
    Later("novags.cameras.networks.depth_anything:check_installed"),
    Later("novags.cameras.networks.depth_anything:da3_cameras"),
    "pictures and cameras",
)
