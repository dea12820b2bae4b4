"""Zero-DCE as a row: see `zero_dce.py`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.checks import check_training
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later, loaded


@dataclass(frozen=True, kw_only=True)
class ZeroDceConfig(EnhancerConfig):
    """Where the weights come from, and how they are learned where no file names them."""

    weights: tuple[Path, ...] | None = None  # the official Epoch99.pth, say; None: learned from the scene
    steps: int = 200  # published: 200 epochs of 2422 pictures in batches of 8, 60,000 steps
    rate: float = 1e-4
    decay: float = 1e-4
    batch: int = 8
    crop: int = 64  # px; published: whole pictures of 256 px

    def __post_init__(self) -> None:
        check_training(self.steps, self.rate, self.decay, self.batch, self.crop)


ENHANCER = Enhancer(
    ZeroDceConfig,
    Later("novags.methods.enhancers.networks.zero_dce:enhance"),
    Later("novags.methods.enhancers.networks.kind:no_params"),
    network=partial(loaded, "novags.methods.enhancers.networks.zero_dce:ZERO_DCE"),
    title="Zero-DCE (CVPR 2020), a network that learns from the scene",
)
METHOD = by_enhancer(
    ZeroDceConfig(),
    "enhance with the curves of Zero-DCE, learned from the scene without references, or from the authors' file",
    "#6b8e23",
    "Zero-Reference Deep Curve Estimation for Low-Light Image Enhancement (Guo et al. 2020)",
)
