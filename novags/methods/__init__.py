"""What is compared. A new method needs a row of `METHODS` and nothing else; `variant/named.py` names settings."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from functools import partial

from novags.methods.enhanced import enhance_then_fit, oracle
from novags.methods.averaging import trainer as averaging
from novags.methods.denoised import trainer as denoised
from novags.methods.enhanced.config import EnhancedFitConfig, fit_parts
from novags.methods.enhancers import tone_curves
from novags.methods.enhancers.rows.mbllen import MbllenConfig
from novags.methods.enhancers.rows.retinexformer import RetinexformerConfig
from novags.methods.enhancers.choice import Enhancement
from novags.methods.enhancers.rows.sci import SciConfig
from novags.methods.enhancers.rows.uretinex import URetinexConfig
from novags.methods.enhancers.rows.zero_dce import ZeroDceConfig
from novags.methods.nerf.rows import aleth_nerf as aleth_nerf_row
from novags.methods.nerf.rows import i2_nerf as i2_nerf_row
from novags.methods.nerf.rows import ll_nerf as ll_nerf_row
from novags.methods.nerf.rows import nerf as nerf_row
from novags.methods.nerf.rows import nerf_oracle as nerf_oracle_row
from novags.methods.nerf.rows import raw_nerf as raw_nerf_row
from novags.methods.nova import trainer as nova
from novags.methods.nova.knobs import KNOBS as NOVA_KNOBS
from novags.methods.nova_plus import trainer as nova_plus
from novags.methods.nova_plus.knobs import KNOBS as NOVA_PLUS_KNOBS
from novags.methods.rivals.rows import gaussian_dk as gaussian_dk_row
from novags.methods.rivals.rows import lita_gs as lita_gs_row
from novags.methods.rivals.rows import ll_gaussian as ll_gaussian_row
from novags.methods.rivals.rows import luminance_gs as luminance_gs_row
from novags.methods.rivals.rows import raw_gs as raw_gs_row
from novags.methods.variant import Method, Variant, spelled
from novags.methods.variant.named import VARIANTS as VARIANTS
from sensor_model.files.reading import brief


def _enhanced(enhance: Enhancement, title: str, color: str, source: str) -> Method:
    """What "naive" is, with another enhancement."""
    return Method(
        title=f"{title}, then fit as naive does", family="2D + GS", color=color, source=source,
        config=partial(EnhancedFitConfig, enhance=enhance), train=enhance_then_fit.train,
        parts=enhance_then_fit.parts,
    )  # fmt: skip


METHODS: dict[str, Method] = {
    "nova": Method(
        title="NOVA-GS as the paper states it: enhance, denoise with a network that learns from the noisy views alone, "
        "fit with geometric consistency and a penalty on view-dependent colour where noise is strong",
        family="ours",
        color="#0072b2",
        config=nova.NovaConfig,
        train=nova.train,
        parts=nova.parts,
        knobs=NOVA_KNOBS,
        source="NOVA-GS: Noise-Aware View-Consistent Gaussian Splatting for Low-Light Novel View Synthesis",
        cameras="vggt",
    ),
    "nova-plus": Method(
        title="the light of the scene, fitted to the raw data by their known noise, then to denoised data and to "
        "averages guided by the first fit; two seeds, merged",
        family="ours",
        color="#7a3fb0",
        config=nova_plus.NovaPlusConfig,
        train=nova_plus.train,
        parts=nova_plus.parts,
        knobs=NOVA_PLUS_KNOBS,
        source="docs/nova-plus.md",
    ),
    "naive": Method(
        title="enhance, then fit the noisy pictures with the same loss (L1 and D-SSIM)",
        family="2D + GS",
        color="#c8590a",
        config=EnhancedFitConfig,
        train=enhance_then_fit.train,
        parts=enhance_then_fit.parts,
        source="section 4.2 of the NOVA-GS paper and 3DGS-MCMC (Kheradmand et al. 2024)",
        bound="floor",
    ),
    "gamma-gs": _enhanced(
        tone_curves.GammaConfig(),
        "raise every code to the power 0.2",
        "#b8860b",
        "section 5 of the NOVA-GS paper, which names the exponent",
    ),
    "gain-gs": _enhanced(
        tone_curves.GainConfig(),
        "multiply the light of each picture until its mean code is 0.5",
        "#a0522d",
        "a longer exposure, as far as a factor can replace it",
    ),
    "drago-gs": _enhanced(
        tone_curves.DragoConfig(),
        "map the luminance of each picture by an adaptive logarithm",
        "#8b6f47",
        "Adaptive Logarithmic Mapping For Displaying High Contrast Scenes (Drago et al. 2003)",
    ),
    "equalise-gs": _enhanced(
        tone_curves.EqualiseConfig(),
        "equalise the histogram of each picture's luma",
        "#cd853f",
        "histogram equalisation (Gonzalez and Woods, Digital Image Processing)",
    ),
    "zero-dce-gs": _enhanced(
        ZeroDceConfig(),
        "enhance with the curves of Zero-DCE, learned from the scene without references, or from the authors' file",
        "#6b8e23",
        "Zero-Reference Deep Curve Estimation for Low-Light Image Enhancement (Guo et al. 2020)",
    ),
    "sci-gs": _enhanced(
        SciConfig(),
        "divide by the illumination that SCI estimates, learned from the scene without references, or from the "
        "authors' file",
        "#2e8b57",
        "Toward Fast, Flexible, and Robust Low-Light Image Enhancement (Ma et al. 2022)",
    ),
    "mbllen-gs": _enhanced(
        MbllenConfig(),
        "enhance with MBLLEN, whose weights have to be given",
        "#4682b4",
        "MBLLEN: Low-light Image/Video Enhancement Using CNNs (Lv et al. 2018)",
    ),
    "uretinex-gs": _enhanced(
        URetinexConfig(),
        "enhance with URetinex-Net, whose weights have to be given",
        "#5f6caf",
        "URetinex-Net: Retinex-Based Deep Unfolding Network for Low-Light Image Enhancement (Wu et al. 2022)",
    ),
    "retinexformer-gs": _enhanced(
        RetinexformerConfig(),
        "enhance with Retinexformer, whose weights have to be given",
        "#8a5fa8",
        "Retinexformer: One-stage Retinex-based Transformer for Low-light Image Enhancement (Cai et al. 2023)",
    ),
    "denoise-gs": Method(
        title="denoise the raw data with a network that was trained on simulated cameras and adapts to the capture, "
        "enhance, then fit as naive does",
        family="2D + GS",
        color="#7a5195",
        config=denoised.DenoisedConfig,
        train=denoised.train,
        parts=denoised.parts,
        source="recorrupted-to-recorrupted (Pang et al. 2021) in the generalised Anscombe domain (Murtagh et al. 1995)",
    ),
    "luminance-gs": luminance_gs_row.METHOD,
    "lita-gs": lita_gs_row.METHOD,
    "gaussian-dk": gaussian_dk_row.METHOD,
    "ll-gaussian": ll_gaussian_row.METHOD,
    "raw-gs": raw_gs_row.METHOD,
    "oracle": Method(
        title="enhance the noise-free exposures, then fit: what no real method can see, hence the ceiling",
        family="bound",
        color="#008560",
        config=oracle.OracleConfig,
        train=oracle.train,
        parts=fit_parts,
        source="3DGS-MCMC (Kheradmand et al. 2024) on simulated exposures without noise",
        sees_clean=True,
        bound="ceiling",
    ),
    "nerf": nerf_row.METHOD,
    "raw-nerf": raw_nerf_row.METHOD,
    "aleth-nerf": aleth_nerf_row.METHOD,
    "ll-nerf": ll_nerf_row.METHOD,
    "i2-nerf": i2_nerf_row.METHOD,
    "nerf-oracle": nerf_oracle_row.METHOD,
    "averaging": Method(
        title="bring the training exposures to the view by the true surface and average them by inverse variance: what "
        "counting statistics across views alone can give",
        family="bound",
        color="#6b6b6b",
        config=averaging.AveragingConfig,
        train=averaging.train,
        source="the Gauss-Markov theorem, and cubic convolution (Keys 1981)",
        sees_clean=True,
        sees_surface=True,
    ),
}


def names() -> tuple[str, ...]:
    """Every method and every named variant."""
    return (*METHODS, *VARIANTS)


def chosen(name: str, more: Mapping[str, Variant] | None = None) -> Variant:
    """A method or variant by name.

    Args:
        name: Of a method, of one of `VARIANTS`, or of one of `more`.
        more: The caller's own variants.

    Raises:
        ValueError: If the name is unknown, or it varies a method that does not exist.
    """
    variants = {**VARIANTS, **(more or {})}
    variant = variants.get(name, Variant(name=name, method=name))
    if variant.method in variants and variant.method not in (name, *METHODS):  # a variant of a variant
        base = chosen(variant.method, {other: v for other, v in (more or {}).items() if other != name})
        title = variant.title or f"{base.name} with {spelled(variant.settings)}"
        kept = {name: value for name, value in base.settings.items() if not variant.decides(name)}
        return replace(variant, method=base.method, settings={**kept, **variant.settings}, title=title)
    if variant.settings and not variant.title:
        variant = replace(variant, title=f"{variant.method} with {spelled(variant.settings)}")
    if variant.method not in METHODS:
        known = (*METHODS, *variants)
        near = get_close_matches(variant.method, known, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(f"unknown method {brief(repr(variant.method), 100)}; {hint}available: {', '.join(known)}")
    return variant


def with_variants(variants: Iterable[Variant]) -> dict[str, Variant]:
    """The caller's own variants by name.

    Raises:
        ValueError: If a name is taken or used twice, or is that of what it varies.
    """
    found: dict[str, Variant] = {}
    for variant in variants:
        if variant.name in (*METHODS, *found, variant.method):
            raise ValueError(f"the variant {variant.name!r} needs a name of its own, and this one is taken")
        found[variant.name] = variant
    for name in found:
        chosen(name, found)
    return found
