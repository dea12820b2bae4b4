"""Aleth-NeRF: a field that is seen through a concealing field (`aleth.py`)."""

from dataclasses import dataclass, field

from novags.fields.training.config import FieldFitConfig
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.methods.nerf.config import fit_parts
from novags.methods.variant import Method
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class AlethConfig:
    """All choices.

    Attributes:
        pictures: Which dark pictures.
        target: Mean of the lit colours (ETA).
        contrast: By which, and ETA, differences between neighbours grow.
        control: Weight of the mean.
        structure: Weight of the differences.
        grey: Weight of grey on average.
        fit: Of the field.
    """

    pictures: Pictures = "8bit"
    target: float = 0.45
    contrast: float = 12.0
    control: float = 1e-3
    structure: float = 1e-3
    grey: float = 1e-8
    fit: FieldFitConfig = field(default_factory=lambda: FieldFitConfig(patch=4))

    def __post_init__(self) -> None:
        if not (0 < self.target < 1 and self.contrast > 0):
            raise ValueError(f"target must lie in (0, 1) and contrast be > 0, got {self.target} and {self.contrast}")
        if min(self.control, self.structure, self.grey) < 0 or self.fit.patch < 2:
            raise ValueError("weights must be >= 0 and fit.patch >= 2 (neighbours are compared), got "
                             f"{self.control}, {self.structure}, {self.grey} and {self.fit.patch}")  # fmt: skip


METHOD = Method(
    title="a radiance field whose dark views are seen through a learned concealing field, which is then removed",
    family="NeRF",
    color="#a0483c",
    config=AlethConfig,
    train=Later("novags.methods.nerf.aleth:train"),
    parts=fit_parts,
    source="Aleth-NeRF (Cui et al. 2024)",
    memory=Memory(fixed=1.0e9),
)
