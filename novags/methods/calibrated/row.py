"""3DGS4LL's two branches as rows: see `trainer.py`."""

from novags.methods.calibrated.config import AmplifiedConfig, LumaConfig
from novags.methods.memory import Memory
from novags.methods.rivals.row import rival
from sensor_model.files.registry import Later

SOURCE = "3DGS4LL (2nd place of the NTIRE 2026 low-light 3D challenge), of which the repository tells the constants"
_MEMORY = Memory(fixed=0.6e9, pictures=3.0, work=150.0)
AMPLIFIED = rival(
    AmplifiedConfig,
    Later("novags.methods.calibrated.trainer:train_amplified"),
    title="a lit scene, fitted to amplified pictures and, through a camera model of ONE LIT SCENE, to the dark ones",
    color="#3f7f5f",
    source=SOURCE,
    memory=_MEMORY,
)
LUMA = rival(
    LumaConfig,
    Later("novags.methods.calibrated.trainer:train_luma"),
    title="a lit scene, fitted to colours by a camera model of ONE LIT SCENE with details of Retinexformer",
    color="#5f9f3f",
    source=SOURCE,
    memory=_MEMORY,
)
