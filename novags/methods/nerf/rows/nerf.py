"""A field that is fitted to the enhanced pictures (`plain.py`)."""

from novags.methods.memory import Memory
from novags.methods.nerf.config import NerfConfig, fit_parts
from novags.methods.variant import Method
from sensor_model.files.registry import Later

METHOD = Method(
    title="enhance, then fit a radiance field on grids to the noisy pictures",
    family="NeRF",
    color="#4d7d1f",
    config=NerfConfig,
    train=Later("novags.methods.nerf.plain:train"),
    parts=fit_parts,
    source="NeRF (Mildenhall et al. 2020) with the encoding of Instant-NGP (Mueller et al. 2022)",
    memory=Memory(fixed=1.0e9, pictures=1.25),
)
