"""3DGS4LL's first branch as a row: see `trainer.py`."""

from novags.methods.calibrated.config import MEMORY, SOURCE, AmplifiedConfig
from novags.methods.rivals.row import rival
from sensor_model.files.registry import Later

METHOD = rival(
    AmplifiedConfig,
    Later("novags.methods.calibrated.trainer:train"),
    title="a lit scene, fitted to amplified pictures and, through a camera model of ONE LIT SCENE, to the dark ones",
    color="#3f7f5f",
    source=SOURCE,
    memory=MEMORY,
)
