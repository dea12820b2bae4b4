"""What is compared. A new method needs a row of `METHODS` and nothing else; `variant/named.py` names settings."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

from novags.methods.averaging import trainer as averaging
from novags.methods.denoised import trainer as denoised
from novags.methods.enhanced import naive, oracle
from novags.methods.enhanced.config import fit_parts
from novags.methods.enhancers.rows import drago, equalise, gain, gamma, mbllen, retinexformer, sci, uretinex, zero_dce
from novags.methods.nerf import aleth, i2, llnerf
from novags.methods.nerf import clean as clean_nerf
from novags.methods.nerf import fitting as nerf
from novags.methods.nerf import plain as plain_nerf
from novags.methods.nerf import raw as raw_nerf
from novags.methods.nova import trainer as nova
from novags.methods.nova.knobs import KNOBS as NOVA_KNOBS
from novags.methods.nova_plus import trainer as nova_plus
from novags.methods.nova_plus.knobs import KNOBS as NOVA_PLUS_KNOBS
from novags.methods.rivals import gaussian_dk, lita_gs, ll_gaussian, luminance_gs, raw_gs
from novags.methods.variant import Method, Variant, spelled
from novags.methods.variant.named import VARIANTS as VARIANTS
from sensor_model.files.reading import brief


def _rival(config: Callable[[], Any], train: Any, *, title: str, color: str, source: str) -> Method:
    """Another group's method that consists of one fit of Gaussians."""
    return Method(title=title, family="3DGS", color=color, source=source, config=config, train=train, parts=fit_parts)


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
    "naive": naive.METHOD,
    "gamma-gs": gamma.METHOD,
    "gain-gs": gain.METHOD,
    "drago-gs": drago.METHOD,
    "equalise-gs": equalise.METHOD,
    "zero-dce-gs": zero_dce.METHOD,
    "sci-gs": sci.METHOD,
    "mbllen-gs": mbllen.METHOD,
    "uretinex-gs": uretinex.METHOD,
    "retinexformer-gs": retinexformer.METHOD,
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
    "oracle": oracle.METHOD,
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
