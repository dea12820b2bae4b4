"""RawNeRF: a field of linear light, fitted to raw data (`raw.py`)."""

from dataclasses import dataclass, field

from novags.fields.training.config import FieldFitConfig
from novags.methods.enhancers.choice import EnhanceConfig, Enhancement
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.methods.nerf.config import fit_parts
from novags.methods.variant import Method
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class RawNerfConfig:
    """All choices.

    Attributes:
        fit: Of the field.
        epsilon: Of the loss, in units of white. Without it the darkest pixels, where noise is all there is, would weigh
            without bound.
        pictures: Through whose enhancement the result is shown, and compared with methods that enhance.
        enhance: That enhancement.
    """

    fit: FieldFitConfig = field(default_factory=FieldFitConfig)
    epsilon: float = 1e-3
    pictures: Pictures = "8bit"
    enhance: Enhancement = field(default_factory=EnhanceConfig)

    def __post_init__(self) -> None:
        if not self.epsilon > 0:
            raise ValueError(f"epsilon must be > 0 (black renders would be divided by zero), got {self.epsilon}")


METHOD = Method(
    title="a radiance field of linear light, fitted to the raw data by the loss of RawNeRF",
    family="NeRF",
    color="#8a6d1d",
    config=RawNerfConfig,
    train=Later("novags.methods.nerf.raw:train"),
    parts=fit_parts,
    source="RawNeRF (Mildenhall et al. 2022)",
    memory=Memory(fixed=1.0e9, pictures=2.3),
)
