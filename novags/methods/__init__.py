"""What is compared. A new method needs a row of `METHODS` and nothing else; `VARIANTS` names settings."""

from collections import ChainMap
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from functools import partial
from typing import Any

from novags.methods import enhance_then_fit, oracle
from novags.methods.averaging import row as averaging_row
from novags.methods.denoised import row as denoised_row
from novags.methods.enhanced_fit import EnhancedFitConfig, fit_parts
from novags.methods.enhancers import tone_curves
from novags.methods.enhancers.mbllen import MbllenConfig
from novags.methods.enhancers.retinexformer import RetinexformerConfig
from novags.methods.enhancers.rows.guided import Enhancement
from novags.methods.enhancers.sci import SciConfig
from novags.methods.enhancers.uretinex import URetinexConfig
from novags.methods.enhancers.zero_dce import ZeroDceConfig
from novags.methods.nerf import aleth, i2, llnerf
from novags.methods.nerf import clean as clean_nerf
from novags.methods.nerf import fitting as nerf
from novags.methods.nerf import plain as plain_nerf
from novags.methods.nerf import raw as raw_nerf
from novags.methods.nova import row as nova_row
from novags.methods.nova_plus import row as nova_plus_row
from novags.methods.rivals import gaussian_dk, lita_gs, ll_gaussian, luminance_gs, raw_gs
from novags.methods.variant import Method, Variant, spelled
from sensor_model.files.reading import brief
from sensor_model.files.registry import Registry


def _enhanced(enhance: Enhancement, title: str, color: str, source: str) -> Method:
    """What "naive" is, with another enhancement."""
    return Method(
        title=f"{title}, then fit as naive does", family="2D + GS", color=color, source=source,
        config=partial(EnhancedFitConfig, enhance=enhance), train=enhance_then_fit.train,
        parts=enhance_then_fit.parts,
    )  # fmt: skip


def _rival(config: Callable[[], Any], train: Any, *, title: str, color: str, source: str) -> Method:
    """Another group's method that consists of one fit of Gaussians."""
    return Method(title=title, family="3DGS", color=color, source=source, config=config, train=train, parts=fit_parts)


METHODS: dict[str, Method] = {
    "nova": nova_row.METHOD,
    "nova-plus": nova_plus_row.METHOD,
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
    "denoise-gs": denoised_row.METHOD,
    "luminance-gs": _rival(
        luminance_gs.LuminanceGsConfig,
        luminance_gs.train,
        title="dark and lit colours for each Gaussian; the lit ones follow curves that are learned with them",
        color="#66a61e",
        source="Luminance-GS (Cui et al. 2025)",
    ),
    "lita-gs": _rival(
        lita_gs.LitaGsConfig,
        lita_gs.train,
        title="lit colours, illumination and noise of each Gaussian, held to a structure that light does not change; "
        "shown denoised",
        color="#d37295",
        source="LITA-GS (Zhou et al. 2025)",
    ),
    "gaussian-dk": _rival(
        gaussian_dk.GaussianDkConfig,
        gaussian_dk.train,
        title="radiance, and a camera response that is learned with it; shown at a larger exposure",
        color="#b07aa1",
        source="Gaussian-DK (Ye et al. 2024)",
    ),
    "ll-gaussian": _rival(
        ll_gaussian.LlGaussianConfig,
        ll_gaussian.train,
        title="reflectance, illumination and interference of each Gaussian; shown with the illumination raised",
        color="#9c755f",
        source="the decomposition of LL-Gaussian (Sun et al. 2025)",
    ),
    "raw-gs": _rival(
        raw_gs.RawGsConfig,
        raw_gs.train,
        title="the light of the scene, fitted to the raw data by the loss of RawNeRF",
        color="#a6761d",
        source="RawNeRF (Mildenhall et al. 2022) and LE3D (Jin et al. 2024)",
    ),
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
    "nerf": Method(
        title="enhance, then fit a radiance field on grids to the noisy pictures",
        family="NeRF",
        color="#4d7d1f",
        config=nerf.NerfConfig,
        train=plain_nerf.train,
        parts=nerf.fit_parts,
        source="NeRF (Mildenhall et al. 2020) with the encoding of Instant-NGP (Mueller et al. 2022)",
    ),
    "raw-nerf": Method(
        title="a radiance field of linear light, fitted to the raw data by the loss of RawNeRF",
        family="NeRF",
        color="#8a6d1d",
        config=raw_nerf.RawNerfConfig,
        train=raw_nerf.train,
        parts=nerf.fit_parts,
        source="RawNeRF (Mildenhall et al. 2022)",
    ),
    "aleth-nerf": Method(
        title="a radiance field whose dark views are seen through a learned concealing field, which is then removed",
        family="NeRF",
        color="#a0483c",
        config=aleth.AlethConfig,
        train=aleth.train,
        parts=nerf.fit_parts,
        source="Aleth-NeRF (Cui et al. 2024)",
    ),
    "ll-nerf": Method(
        title="a radiance field of reflectance times illumination; the illumination is then brightened",
        family="NeRF",
        color="#5a63b8",
        config=llnerf.LlnerfConfig,
        train=llnerf.train,
        parts=nerf.fit_parts,
        source="LLNeRF (Wang et al. 2023)",
    ),
    "i2-nerf": Method(
        title="a radiance field in a medium that absorbs light, which is then removed",
        family="NeRF",
        color="#2a8a8f",
        config=i2.I2Config,
        train=i2.train,
        parts=nerf.fit_parts,
        source="I2-NeRF (Liu et al. 2025)",
    ),
    "nerf-oracle": Method(
        title="enhance the noise-free exposures, then fit a radiance field: the ceiling of fields",
        family="bound",
        color="#2f6b5e",
        config=nerf.NerfConfig,
        train=clean_nerf.train,
        parts=nerf.fit_parts,
        source="NeRF (Mildenhall et al. 2020) on simulated exposures without noise",
        sees_clean=True,
    ),
    "averaging": averaging_row.METHOD,
}

VARIANTS: Registry[Variant] = Registry(
    {
        "nova-fast": "novags.methods.nova.variants:FAST",
        "nova-tuned": "novags.methods.nova.variants:TUNED",
        "nova-no-sh": "novags.methods.nova.variants:NO_SH",
        "nova-no-geo": "novags.methods.nova.variants:NO_GEO",
        "nova-no-n2v-sh": "novags.methods.nova.variants:NO_N2V_SH",
        "naive-l1": "novags.methods.variant.rows.enhanced:NAIVE_L1",
        "gamma-auto-gs": "novags.methods.variant.rows.enhanced:GAMMA_AUTO",
        "sci-plus-gs": "novags.methods.variant.rows.enhanced:SCI_PLUS",
        "oracle-demosaiced": "novags.methods.variant.rows.enhanced:ORACLE_DEMOSAICED",
        "naive-l1-fast-rates": "novags.methods.variant.rows.fast_rates:NAIVE_L1",
        "oracle-fast-rates": "novags.methods.variant.rows.fast_rates:ORACLE",
        "i2-nerf-truth": "novags.methods.variant.rows.others:I2_NERF_TRUTH",
        "denoise-gs-plain": "novags.methods.variant.rows.others:DENOISE_PLAIN",
        "averaging-clean": "novags.methods.variant.rows.others:AVERAGING_CLEAN",
    }
)


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
    variants = ChainMap[str, Variant](dict(more or {}), VARIANTS)  # which loads the row of this name alone
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
