"""MBLLEN as a row: see `mbllen.py`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later, loaded


@dataclass(frozen=True, kw_only=True)
class MbllenConfig(EnhancerConfig):
    """Where the weights come from, and whether the result is adjusted as the authors' program does."""

    weights: tuple[Path, ...] | None = None
    adjusted: bool = True


ENHANCER = Enhancer(
    MbllenConfig,
    Later("novags.methods.enhancers.networks.mbllen:enhance"),
    Later("novags.methods.enhancers.networks.mbllen:typical"),
    network=partial(loaded, "novags.methods.enhancers.networks.mbllen:MBLLEN"),
    title="MBLLEN (BMVC 2018), a network with official weights",
)
METHOD = by_enhancer(
    MbllenConfig(),
    "enhance with MBLLEN, whose weights have to be given",
    "#4682b4",
    "MBLLEN: Low-light Image/Video Enhancement Using CNNs (Lv et al. 2018)",
)
