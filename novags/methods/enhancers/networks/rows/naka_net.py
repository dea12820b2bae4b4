"""Naka-GS's tone mapping with its network as a row: see `naka.py`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later, loaded


@dataclass(frozen=True, kw_only=True)
class NakaNetConfig(EnhancerConfig):
    """Where the weights come from."""

    weights: tuple[Path, ...] | None = None  # the authors' best.pth, say


ENHANCER = Enhancer(
    NakaNetConfig,
    Later("novags.methods.enhancers.networks.naka:enhance"),
    Later("novags.methods.enhancers.networks.kind:no_params"),
    network=partial(loaded, "novags.methods.enhancers.networks.naka:NAKA_NET"),
    title="Naka-GS's tone mapping and its correction, a network with official weights",
)
METHOD = by_enhancer(
    NakaNetConfig(),
    "raise each picture by Naka and Rushton's response and correct it with a network, whose weights have to be given",
    "#5b3350",
    "Naka-GS (arXiv 2604.11142), of which the point densification is left out",
)
