"""Settings of methods that have a name of their own. A new one is a row here."""

from collections.abc import Mapping
from typing import Any

from novags.methods.enhanced.config import ORIGINAL_FIT
from novags.methods.nova.denoiser import FAST_DENOISER
from novags.methods.nova.knobs import TUNED
from novags.methods.nova.trainer import NovaConfig
from novags.methods.nova_plus.trainer import FIT as FIT_OF_PLUS
from novags.methods.variant import Variant
from novags.settings import flattened

_PUBLISHED = flattened(NovaConfig())
_FAST = {f"denoiser.{name}": value for name, value in flattened(FAST_DENOISER).items()} | {"consistency.every": 16}
_ORIGINAL = flattened(ORIGINAL_FIT)
_QUICK = {
    f"fit.{name}": value
    for name, value in flattened(FIT_OF_PLUS).items()
    if name.startswith(("rates.", "mcmc.")) and value != _ORIGINAL[name]
}


def _variant(name: str, method: str, title: str, settings: Mapping[str, Any]) -> Variant:
    return Variant(name=name, method=method, title=title, settings=settings)


VARIANTS: dict[str, Variant] = {
    variant.name: variant
    for variant in (
        _variant(
            "nova-fast",
            "nova",
            "NOVA-GS with a small denoiser that trains before the fit only, and a third of the noisy picture in its "
            "target: not the paper's network",
            {name: value for name, value in _FAST.items() if value != _PUBLISHED[name]},
        ),
        _variant("nova-tuned", "nova", "NOVA-GS with the best settings that were measured (docs/choices.md)", TUNED),
        _variant("nova-no-sh", "nova", "NOVA-GS without the penalty on view-dependent colour", {"sh_weight": None}),
        _variant("nova-no-geo", "nova", "NOVA-GS without geometric consistency", {"consistency": None}),
        _variant(
            "nova-no-n2v-sh",
            "nova",
            "NOVA-GS without the denoiser, and so without the penalty that its residual steers",
            {"denoiser": None, "sh_weight": None},
        ),
        _variant(
            "naive-l1",
            "naive",
            "enhance, then fit the noisy pictures with L1 alone, which averages noise over the views",
            {"fit.dssim_weight": 0.0},
        ),
        _variant(
            "gamma-auto-gs",
            "gamma-gs",
            "raise every code to the power that brings the mean of the picture to 0.5, then fit as naive does",
            {"enhance.gamma": None},
        ),
        _variant(
            "sci-plus-gs",
            "sci-gs",
            "SCI with this project's reading of the additivity condition of SCI++ (Ma et al. 2025), then fit as naive "
            "does",
            {"enhance.additivity": 1.0},
        ),
        _variant(
            "oracle-demosaiced",
            "oracle",
            "the same from noise-free mosaics, interpolated as the pictures are: what demosaicing costs by itself",
            {"demosaiced": True},
        ),
        _variant(
            "naive-l1-fast-rates",
            "naive",
            "as naive-l1, with the learning rates and the growth of nova-plus",
            {"fit.dssim_weight": 0.0, **_QUICK},
        ),
        _variant(
            "oracle-fast-rates",
            "oracle",
            "the ceiling with the learning rates and the growth of nova-plus",
            _QUICK,
        ),
        _variant(
            "i2-nerf-truth",
            "i2-nerf",
            "I2-NeRF as published: the brightness that it aims at comes from well-lit pictures of the scene",
            {"truth_statistics": True},
        ),
        _variant(
            "denoise-gs-plain",
            "denoise-gs",
            "the same network without being adapted to the capture",
            {"denoise.adapt": None},
        ),
        _variant(
            "averaging-clean",
            "averaging",
            "the same average of the noise-free exposures: what bringing them to the view costs by itself",
            {"exposures": "noise-free"},
        ),
    )
}
