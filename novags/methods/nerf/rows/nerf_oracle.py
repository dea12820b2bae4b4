"""The ceiling of fields: `nerf`, from exposures without noise (`clean.py`)."""

from novags.methods.memory import Memory
from novags.methods.nerf.config import NerfConfig, fit_parts
from novags.methods.variant import Method
from sensor_model.files.registry import Later

METHOD = Method(
    title="enhance the noise-free exposures, then fit a radiance field: the ceiling of fields",
    family="bound",
    color="#2f6b5e",
    config=NerfConfig,
    train=Later("novags.methods.nerf.clean:train"),
    parts=fit_parts,
    source="NeRF (Mildenhall et al. 2020) on simulated exposures without noise",
    sees_clean=True,
    memory=Memory(fixed=1.0e9),
)
