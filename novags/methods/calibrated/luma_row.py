"""3DGS4LL's third branch as a row: see `luma.py`."""

from dataclasses import dataclass, field

from novags.methods.calibrated.config import MEMORY, SOURCE, CalibratedConfig
from novags.methods.enhancers.networks.rows.retinexformer import RetinexformerConfig
from novags.methods.rivals.row import rival
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class LumaConfig(CalibratedConfig):
    """Branch 3: colours of the camera's model, details of an enhancing network.

    Attributes:
        enhance: The network that the details are from.
        detail: How much of them, as published.
    """

    enhance: RetinexformerConfig = field(default_factory=RetinexformerConfig)
    detail: float = 2.0


METHOD = rival(
    LumaConfig,
    Later("novags.methods.calibrated.luma:train"),
    title="a lit scene, fitted to colours by a camera model of ONE LIT SCENE with details of Retinexformer",
    color="#5f9f3f",
    source=SOURCE,
    memory=MEMORY,
)
