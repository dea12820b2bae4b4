"""I2-NeRF: a field in a medium that absorbs light (`i2.py`)."""

from dataclasses import dataclass, field

from novags.fields.training.config import FieldFitConfig
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.methods.nerf.config import fit_parts
from novags.methods.variant import Method
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class I2Config:
    """All choices.

    Attributes:
        pictures: Which dark pictures.
        mean: Of the lit colours.
        contrast: By how much differences from the mean grow.
        truth_statistics: Take `mean` from well-lit pictures instead, as the original does.
        dark: Weight of RawNeRF's loss: 1 in four of five scenes of LOM, 2 in buu.
        structure: Weight of S3IM.
        bright: Weight of the bright channel.
        overlap: Weight of medium where the surface is.
        variation: Weight of the variation along rays.
        fit: Of the field.
    """

    pictures: Pictures = "8bit"
    mean: float = 0.45
    contrast: float = 6.0
    truth_statistics: bool = False
    dark: float = 1.0
    structure: float = 1.0
    bright: float = 1e-3
    overlap: float = 1e-3
    variation: float = 0.1
    fit: FieldFitConfig = field(default_factory=lambda: FieldFitConfig(patch=4, table_decay=10.0))

    def __post_init__(self) -> None:
        if not (0 < self.mean < 1 and self.contrast > 0):
            raise ValueError(f"mean must lie in (0, 1) and contrast be > 0, got {self.mean} and {self.contrast}")
        if min(self.dark, self.structure, self.bright, self.overlap, self.variation) < 0:
            raise ValueError("weights must be >= 0, got "
                             f"{self.dark}, {self.structure}, {self.bright}, {self.overlap} and {self.variation}"
                             )  # fmt: skip


METHOD = Method(
    title="a radiance field in a medium that absorbs light, which is then removed",
    family="NeRF",
    color="#2a8a8f",
    config=I2Config,
    train=Later("novags.methods.nerf.i2:train"),
    parts=fit_parts,
    source="I2-NeRF (Liu et al. 2025)",
    memory=Memory(fixed=1.0e9),
)
