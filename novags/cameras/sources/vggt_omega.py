"""The network VGGT-Ω."""

from dataclasses import dataclass
from pathlib import Path

from novags.cameras.settings import Pictures, check_drop, check_kind
from novags.cameras.source import CameraConfig, CameraSource
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class VggtOmegaConfig(CameraConfig):
    """Weights, and which of the network's depths to believe."""

    checkpoint: Path  # vggt_omega_1b_512.pt
    pictures: Pictures = "raw"  # which pictures are used; the caller provides them
    drop_percent: float = 30.0  # of all pixels, the share with the least confident depth, which gives no points

    def __post_init__(self) -> None:
        check_kind("vggt-omega", self.pictures)
        check_drop("vggt-omega", self.drop_percent)


SOURCE = CameraSource(
    "the network VGGT-Ω, by your own installation and weights (non-commercial)",
    VggtOmegaConfig,
    Later("novags.cameras.networks.vggt_omega:check_installed"),
    Later("novags.cameras.networks.vggt_omega:vggt_omega_cameras"),
    "pictures",
)
