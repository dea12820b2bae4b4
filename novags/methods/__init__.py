"""The tables of methods and of variants to compare. A new row is a file of its own and a line of text here."""

from collections import ChainMap
from collections.abc import Iterable, Mapping
from dataclasses import replace

from novags.methods.variant import MOST_FITS, SEVERAL, Method, Variant, spelled, spelled_out
from sensor_model.files.reading import brief, meant
from sensor_model.files.registry import Registry

METHODS: Registry[Method] = Registry(
    {
        "nova": "novags.methods.nova.row:METHOD",
        "nova-plus": "novags.methods.nova_plus.row:METHOD",
        "naive": "novags.methods.enhanced.naive:METHOD",
        "gamma-gs": "novags.methods.enhancers.rows.gamma:METHOD",
        "gain-gs": "novags.methods.enhancers.rows.gain:METHOD",
        "drago-gs": "novags.methods.enhancers.rows.drago:METHOD",
        "equalise-gs": "novags.methods.enhancers.rows.equalise:METHOD",
        "ase-gs": "novags.methods.enhancers.rows.adaptive:ASE_METHOD",
        "ap3-gs": "novags.methods.enhancers.rows.adaptive:AP3_METHOD",
        "naka-gs": "novags.methods.enhancers.rows.naka:METHOD",
        "zero-dce-gs": "novags.methods.enhancers.networks.rows.zero_dce:METHOD",
        "sci-gs": "novags.methods.enhancers.networks.rows.sci:METHOD",
        "mbllen-gs": "novags.methods.enhancers.networks.rows.mbllen:METHOD",
        "uretinex-gs": "novags.methods.enhancers.networks.rows.uretinex:METHOD",
        "retinexformer-gs": "novags.methods.enhancers.networks.rows.retinexformer:METHOD",
        "naka-net-gs": "novags.methods.enhancers.networks.rows.naka_net:METHOD",
        "denoise-gs": "novags.methods.denoised.row:METHOD",
        "denoise-gs-twice": "novags.methods.rivals.rows.denoised_twice:METHOD",
        "luminance-gs": "novags.methods.rivals.rows.luminance_gs:METHOD",
        "lita-gs": "novags.methods.rivals.rows.lita_gs:METHOD",
        "gaussian-dk": "novags.methods.rivals.rows.gaussian_dk:METHOD",
        "ll-gaussian": "novags.methods.rivals.rows.ll_gaussian:METHOD",
        "raw-gs": "novags.methods.rivals.rows.raw_gs:METHOD",
        "3dgs4ll": "novags.methods.calibrated.row:METHOD",
        "3dgs4ll-luma": "novags.methods.calibrated.luma_row:METHOD",
        "hdrsplat": "novags.methods.rivals.rows.hdrsplat:METHOD",
        "le3d": "novags.methods.rivals.rows.le3d:METHOD",
        "raw3dgs": "novags.methods.rivals.rows.raw3dgs:METHOD",
        "oracle": "novags.methods.enhanced.oracle:METHOD",
        "nerf": "novags.methods.nerf.rows.nerf:METHOD",
        "raw-nerf": "novags.methods.nerf.rows.raw_nerf:METHOD",
        "aleth-nerf": "novags.methods.nerf.rows.aleth_nerf:METHOD",
        "ll-nerf": "novags.methods.nerf.rows.ll_nerf:METHOD",
        "i2-nerf": "novags.methods.nerf.rows.i2_nerf:METHOD",
        "nerf-oracle": "novags.methods.nerf.rows.nerf_oracle:METHOD",
        "averaging": "novags.methods.averaging.row:METHOD",
    },
    "novags.methods",
    Method,
)

VARIANTS: Registry[Variant] = Registry(
    {
        "nova-fast": "novags.methods.nova.variants:FAST",
        "nova-tuned": "novags.methods.nova.variants:TUNED",
        "nova-no-sh": "novags.methods.nova.variants:NO_SH",
        "nova-no-geo": "novags.methods.nova.variants:NO_GEO",
        "nova-no-n2v-sh": "novags.methods.nova.variants:NO_N2V_SH",
        "naive-l1": "novags.methods.variant.rows.enhanced:NAIVE_L1",
        "gamma-auto-gs": "novags.methods.variant.rows.enhanced:GAMMA_AUTO",
        "ase-scene-gs": "novags.methods.variant.rows.enhanced:ASE_SCENE",
        "ap3-scene-gs": "novags.methods.variant.rows.enhanced:AP3_SCENE",
        "sci-plus-gs": "novags.methods.variant.rows.enhanced:SCI_PLUS",
        "oracle-demosaiced": "novags.methods.variant.rows.enhanced:ORACLE_DEMOSAICED",
        "naive-l1-fast-rates": "novags.methods.variant.rows.fast_rates:NAIVE_L1",
        "oracle-fast-rates": "novags.methods.variant.rows.fast_rates:ORACLE",
        "i2-nerf-truth": "novags.methods.variant.rows.others:I2_NERF_TRUTH",
        "denoise-gs-plain": "novags.methods.variant.rows.others:DENOISE_PLAIN",
        "raw3dgs-no-cov": "novags.methods.rivals.rows.raw3dgs:NO_COVARIANCE",
        "averaging-clean": "novags.methods.variant.rows.others:AVERAGING_CLEAN",
    }
)


def names() -> tuple[str, ...]:
    """Every method and every named variant."""
    return (*METHODS, *VARIANTS)


def title_of(method: str, title: str = "") -> str:
    """The work of a method, or the `title` of a variant of it, with its package or file if that is not novags."""
    origin, said = METHODS.origin_of(method), title or METHODS[method].title
    return said if origin is None else f"{said} (from {origin})"


def chosen(name: str, more: Mapping[str, Variant] | None = None) -> Variant:
    """A method or variant by name.

    Args:
        name: Of a method, of one of `VARIANTS`, or of one of `more`; NAME*3 for the mean of three fits.
        more: The caller's own variants.

    Raises:
        ValueError: If the name is unknown, or it varies a method that does not exist.
    """
    variants = ChainMap[str, Variant](dict(more or {}), VARIANTS)  # which loads the row of this name alone
    if (several := SEVERAL.fullmatch(name)) and name not in variants and name not in METHODS:
        one, fits = chosen(several[1], more), int(several[2])
        if not (one.fits == 1 and 2 <= fits <= MOST_FITS):
            raise ValueError(f"NAME*3 is the mean of three fits, of 2 to {MOST_FITS}, got {brief(repr(name), 100)}")
        title = f"{title_of(one.method, one.title)}; the mean of {fits} fits"
        return replace(one, name=spelled_out(name), title=title, fits=fits)
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
        hint = meant(variant.method, known)
        raise ValueError(f"unknown method {brief(repr(variant.method), 100)}; {hint}available: {', '.join(known)}")
    return variant


def with_variants(variants: Iterable[Variant]) -> dict[str, Variant]:
    """The caller's own variants by name.

    Raises:
        ValueError: If a name is taken or used twice, or a variant has the name of its method.
    """
    found: dict[str, Variant] = {}
    for variant in variants:
        if variant.name in (*METHODS, *found, variant.method):
            raise ValueError(f"the variant {variant.name!r} needs a name of its own, and this one is taken")
        found[variant.name] = variant
    for name in found:
        chosen(name, found)
    return found
