"""Settings that methods with a field share."""

from dataclasses import dataclass, field

from novags.fields.training.config import FieldFitConfig
from novags.methods.enhancers.choice import EnhanceConfig, Enhancement
from novags.methods.inputs import Pictures


@dataclass(frozen=True, kw_only=True)
class NerfConfig:
    """Which pictures, how they are enhanced, how a field is fitted to them."""

    pictures: Pictures = "8bit"
    enhance: Enhancement = field(default_factory=EnhanceConfig)
    fit: FieldFitConfig = field(default_factory=FieldFitConfig)


def fit_parts(config: NerfConfig) -> dict[str, int]:
    """`Method.parts`: the fit alone."""
    return {"fit": config.fit.iterations}
