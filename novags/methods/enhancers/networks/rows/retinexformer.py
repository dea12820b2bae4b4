"""Retinexformer as a row: see `retinexformer.py`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later, loaded


@dataclass(frozen=True, kw_only=True)
class RetinexformerConfig(EnhancerConfig):
    """Where the weights come from."""

    weights: tuple[Path, ...] | None = None  # the authors' LOL_v1.pth, say


ENHANCER = Enhancer(
    RetinexformerConfig,
    Later("novags.methods.enhancers.networks.retinexformer:enhance"),
    Later("novags.methods.enhancers.networks.kind:no_params"),
    network=partial(loaded, "novags.methods.enhancers.networks.retinexformer:RETINEXFORMER"),
    title="Retinexformer (ICCV 2023), a network with official weights",
)
METHOD = by_enhancer(
    RetinexformerConfig(),
    "enhance with Retinexformer, whose weights have to be given",
    "#8a5fa8",
    "Retinexformer: One-stage Retinex-based Transformer for Low-light Image Enhancement (Cai et al. 2023)",
)
