"""SCI and SCI++ as a row: see `sci.py`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.checks import check_training
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later, loaded


@dataclass(frozen=True, kw_only=True)
class SciConfig(EnhancerConfig):
    """Where the weights come from, and how they are learned where no file names them."""

    weights: tuple[Path, ...] | None = None  # official easy.pt, medium.pt or difficult.pt; None: learned from the scene
    steps: int = 1000  # published: 1000 epochs of hundreds of pictures; the fewer, the darker the result
    rate: float = 3e-4
    decay: float = 3e-4
    batch: int = 1
    crop: int = 64  # px; published: whole pictures
    additivity: float = 0.0  # weight of the condition of SCI++

    def __post_init__(self) -> None:
        check_training(self.steps, self.rate, self.decay, self.batch, self.crop)
        if not 0 <= self.additivity < 1e6:
            raise ValueError(f"additivity must be >= 0, got {self.additivity}")


ENHANCER = Enhancer(
    SciConfig,
    Later("novags.methods.enhancers.networks.sci:enhance"),
    Later("novags.methods.enhancers.networks.kind:no_params"),
    network=partial(loaded, "novags.methods.enhancers.networks.sci:SCI"),
    title="SCI (CVPR 2022) and SCI++ (TPAMI 2025), a network that learns from the scene",
)
METHOD = by_enhancer(
    SciConfig(),
    "divide by the illumination that SCI estimates, learned from the scene without references, or "
    "from the authors' file",
    "#2e8b57",
    "Toward Fast, Flexible, and Robust Low-Light Image Enhancement (Ma et al. 2022)",
)
