"""The ceiling as a row: its configuration; the fit is in `clean_fit.py`."""

from dataclasses import dataclass

from novags.methods.enhanced.config import EnhancedFitConfig, fit_parts
from novags.methods.memory import Memory
from novags.methods.variant import Method
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class OracleConfig(EnhancedFitConfig):
    """How the noise-free exposures are enhanced and fitted."""

    demosaiced: bool = False  # behind a colour filter array: learn from interpolated mosaics, errors of that included


METHOD = Method(
    title="enhance the noise-free exposures, then fit: what no real method can see, hence the ceiling",
    family="bound",
    color="#008560",
    config=OracleConfig,
    train=Later("novags.methods.enhanced.clean_fit:train"),
    parts=fit_parts,
    source="3DGS-MCMC (Kheradmand et al. 2024) on simulated exposures without noise",
    sees_clean=True,
    memory=Memory(pictures=3.0),
    bound="ceiling",
)
