"""LLNeRF: a field of reflectance times illumination (`llnerf.py`)."""

from dataclasses import dataclass, field

from novags.fields.training.config import FieldFitConfig
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.methods.nerf.config import fit_parts
from novags.methods.variant import Method
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class LlnerfConfig:
    """All choices.

    Attributes:
        pictures: Which dark pictures.
        mean: Of the enhanced colours.
        exposure: Weight of that mean.
        grey: Weight of the grey term.
        smooth: Weight of the smoothness of a, and of g.
        gamma: Weight of mean(g^2).
        learnt: Share of the steps after which the enhancement comes in.
        fit: Of the field.
    """

    pictures: Pictures = "8bit"
    mean: float = 0.55
    exposure: float = 0.1
    grey: float = 0.1
    smooth: float = 0.1
    gamma: float = 0.01
    learnt: float = 0.75
    fit: FieldFitConfig = field(default_factory=lambda: FieldFitConfig(patch=4))

    def __post_init__(self) -> None:
        if not (0 < self.mean < 1 and 0 <= self.learnt <= 1):
            raise ValueError(f"mean must lie in (0, 1) and learnt in 0..1, got {self.mean} and {self.learnt}")
        if min(self.exposure, self.grey, self.smooth, self.gamma) < 0 or self.fit.patch < 2:
            raise ValueError("weights must be >= 0 and fit.patch >= 2 (neighbours are compared), got "
                             f"{self.exposure}, {self.grey}, {self.smooth}, {self.gamma} and {self.fit.patch}"
                             )  # fmt: skip


METHOD = Method(
    title="a radiance field of reflectance times illumination; the illumination is then brightened",
    family="NeRF",
    color="#5a63b8",
    config=LlnerfConfig,
    train=Later("novags.methods.nerf.llnerf:train"),
    parts=fit_parts,
    source="LLNeRF (Wang et al. 2023)",
    memory=Memory(fixed=1.19e9),
)
