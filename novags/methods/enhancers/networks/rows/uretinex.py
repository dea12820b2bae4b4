"""URetinex-Net as a row: see `uretinex.py`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later, loaded


@dataclass(frozen=True, kw_only=True)
class URetinexConfig(EnhancerConfig):
    """Where the weights come from, and how bright the result is to be."""

    weights: tuple[Path, ...] | None = None  # L_adjust.pth, or that and the other two
    ratio: float = 5.0  # of the illumination; the authors' program's default

    def __post_init__(self) -> None:
        if not 0 < self.ratio < 1000:
            raise ValueError(f"ratio must lie in (0, 1000), got {self.ratio}")


ENHANCER = Enhancer(
    URetinexConfig,
    Later("novags.methods.enhancers.networks.uretinex:enhance"),
    Later("novags.methods.enhancers.networks.kind:no_params"),
    network=partial(loaded, "novags.methods.enhancers.networks.uretinex:URETINEX"),
    title="URetinex-Net (CVPR 2022), a network with official weights",
)
METHOD = by_enhancer(
    URetinexConfig(),
    "enhance with URetinex-Net, whose weights have to be given",
    "#5f6caf",
    "URetinex-Net: Retinex-Based Deep Unfolding Network for Low-Light Image Enhancement (Wu et al. 2022)",
)
