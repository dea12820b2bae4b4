"""The networks π³ and π³-X."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from novags.cameras.settings import Known, Pictures, check_drop, check_kind, check_one_of
from novags.cameras.source import CameraConfig, CameraSource
from sensor_model.files.registry import Later

Pi3Network = Literal["pi3", "pi3x"]


@dataclass(frozen=True, kw_only=True)
class Pi3Config(CameraConfig):
    """Weights, which network they are of, what it is told, and which of its points to believe."""

    checkpoint: Path  # model.safetensors of Pi3X or Pi3
    network: Pi3Network = "pi3x"  # whose weights these are
    pictures: Pictures = "raw"  # which pictures are used; the caller provides them
    known: Known = "nothing"  # of the set's cameras, what pi3x is told; "cameras": they stay, depths give first points
    drop_percent: float = 30.0  # of all pixels, the share with the least confident points, which give none

    def __post_init__(self) -> None:
        check_one_of("network of pi3", self.network, Pi3Network)
        check_kind("pi3", self.pictures)
        check_one_of("known of pi3", self.known, Known)
        check_drop("pi3", self.drop_percent)
        if self.network == "pi3" and self.known != "nothing":
            raise ValueError(
                f"the network pi3 cannot be told known cameras, got known={self.known}: leave it out, or take "
                "network=pi3x with its weights"
            )


SOURCE = CameraSource(
    "the networks π³ and π³-X, by your own installation and weights (CC BY-NC)",
    Pi3Config,
    Later("novags.cameras.networks.pi3:check_installed"),
    Later("novags.cameras.networks.pi3:pi3_cameras"),
    "pictures and cameras",
)
