"""A dark picture in, a bright one out: one file per enhancer, one row in `ENHANCERS`; networks also in `NETWORKS`."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from novags.methods.enhancers import guided, tone_curves
from novags.methods.enhancers.enhancer import Enhancer
from novags.methods.enhancers.mbllen import MBLLEN, MbllenConfig, typical
from novags.methods.enhancers.networks import Kind, no_params, stamps
from novags.methods.enhancers.retinexformer import RETINEXFORMER, RetinexformerConfig
from novags.methods.enhancers.rows.guided import EnhanceConfig, Enhancement
from novags.methods.enhancers.sci import SCI, SciConfig
from novags.methods.enhancers.uretinex import URETINEX, URetinexConfig
from novags.methods.enhancers.zero_dce import ZERO_DCE, ZeroDceConfig
from novags.methods.inputs import LacksInput, Pictures
from novags.methods.memo import Memo
from novags.methods.noise import Noise, Variance
from novags.methods.problem import Problem, encode
from novags.settings import changed
from sensor_model.files.reading import brief


def _unchanged(dark: Tensor, config: None, params: Any, noise: Variance | None) -> tuple[Tensor, None]:
    return dark, None


NETWORKS: dict[type, Kind] = {
    ZeroDceConfig: ZERO_DCE,
    SciConfig: SCI,
    MbllenConfig: MBLLEN,
    URetinexConfig: URETINEX,
    RetinexformerConfig: RETINEXFORMER,
}

ENHANCERS: dict[str, Enhancer] = {
    "guided": Enhancer(EnhanceConfig, guided.enhance, guided.typical),
    "gamma": Enhancer(tone_curves.GammaConfig, tone_curves.gamma, tone_curves.mean_params),
    "gain": Enhancer(tone_curves.GainConfig, tone_curves.gain, tone_curves.geometric_mean_params),
    "drago": Enhancer(tone_curves.DragoConfig, tone_curves.drago, tone_curves.geometric_mean_params),
    "equalise": Enhancer(tone_curves.EqualiseConfig, tone_curves.equalise, tone_curves.mean_curve),
    "zero-dce": Enhancer(ZeroDceConfig, ZERO_DCE.enhance, no_params),
    "sci": Enhancer(SciConfig, SCI.enhance, no_params),
    "mbllen": Enhancer(MbllenConfig, MBLLEN.enhance, typical),
    "uretinex": Enhancer(URetinexConfig, URETINEX.enhance, no_params),
    "retinexformer": Enhancer(RetinexformerConfig, RETINEXFORMER.enhance, no_params),
    "none": Enhancer(type(None), _unchanged, lambda params: None),
}


def refuse_without_weights(config: Any, name: str) -> None:
    """Refuse what is known to fail before any picture is taken: a network without weights that learns from no scene.

    Args:
        config: Of a method.
        name: Of the method or variant, for the message.

    Raises:
        LacksInput: If its enhancer is one.
    """
    enhance = getattr(config, "enhance", None)
    kind = NETWORKS.get(type(enhance))
    if kind is not None and kind.rehearsal is None:
        try:
            kind.refuse_without_weights(enhance)
        except LacksInput as error:
            raise LacksInput(f"{name}: {error}") from error


def enhancement_record(config: Enhancement, pictures: Pictures) -> dict[str, Any]:
    """What a run records about its enhancement.

    Raises:
        ValueError: If no enhancer has such a configuration.
    """
    for name, enhancer in ENHANCERS.items():
        if isinstance(config, enhancer.config):
            settings = {} if config is None else dataclasses.asdict(config)
            return {"enhancer": name, "pictures": pictures, "config": settings}
    raise ValueError(f"no enhancer has a configuration like {type(config).__name__}; available: {', '.join(ENHANCERS)}")


def recorded(enhancement: dict[str, Any]) -> tuple[Enhancer, Any]:
    """The enhancer of a record, and its configuration.

    Raises:
        ValueError: If there is no such enhancer, or it has other settings.
    """
    name = enhancement["enhancer"]
    if name not in ENHANCERS:
        raise ValueError(f"unknown enhancer {brief(repr(name), 100)}; available: {', '.join(ENHANCERS)}")
    config = ENHANCERS[name].config()
    if config is None:
        return ENHANCERS[name], None
    try:
        return ENHANCERS[name], changed(config, enhancement["config"])
    except ValueError as error:
        raise ValueError(f"the recorded settings of {name} do not fit this version ({error}): run it again") from error


def located(enhancement: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The enhancement that a run in a folder has recorded, with its files of weights where they are."""
    config = enhancement["config"]
    weights = config.get("weights")
    if not isinstance(weights, list):
        return enhancement
    return {**enhancement, "config": {**config, "weights": [str(folder / str(name)) for name in weights]}}


def enhanced(problem: Problem, config: Enhancement, pictures: Pictures) -> Tensor:
    """The enhanced pictures of a problem [C, H, W, 3]; made once for all methods that share them."""
    dark = problem.encoded(pictures)
    views = zip(problem.names, dark, strict=True)
    return torch.stack(
        [enhanced_view(problem.shared, name, view, config, pictures, problem.noise)[0] for name, view in views]
    )


def enhanced_clean(problem: Problem, config: Enhancement, pictures: Pictures, *, demosaiced: bool = False) -> Tensor:
    """The noise-free exposures, enhanced exactly as their noisy twins [C, H, W, 3].

    Args:
        problem: The problem.
        config: Of the enhancer.
        pictures: Which pictures the noisy twins are.
        demosaiced: Behind a colour filter array: the noise-free mosaics, interpolated as the pictures are.

    Raises:
        LacksInput: If the problem has no noise-free exposures.
    """
    if problem.clean is None:
        raise LacksInput("this method needs the noise-free exposures (Problem.clean), and this capture has none")
    demosaiced = demosaiced and problem.clean_demosaiced is not None  # three chips: no difference
    dark, clean = problem.encoded(pictures), problem.clean_demosaiced if demosaiced else problem.clean
    assert clean is not None
    views = zip(problem.names, dark, clean, strict=True)
    return torch.stack(
        [enhanced_twin(problem.shared, *view, config, pictures, problem.noise, demosaiced=demosaiced) for view in views]
    )


def enhanced_twin(
    shared: Memo, name: str, dark: Tensor, clean: Tensor, config: Enhancement, pictures: Pictures,
    noise: Noise | None, *, demosaiced: bool = False,
) -> Tensor:  # fmt: skip
    """The noise-free twin of one view through the enhancement that the view got, [H, W, 3].

    Args:
        shared: Where the results of a capture are kept.
        name: Of the view.
        dark: The picture, [H, W, 3], sRGB-encoded.
        clean: The same exposure without noise.
        config: Of the enhancer.
        pictures: Which pictures `dark` is one of.
        noise: Of the capture, where it is known.
        demosaiced: Whether `clean` was interpolated from a mosaic.
    """
    _, params = enhanced_view(shared, name, dark, config, pictures, noise)
    key = ("enhanced clean", name, pictures, config, stamps(config), demosaiced)
    return shared.once(key, lambda: _enhance(clean, config, params)[0])


def enhanced_view(
    shared: Memo, name: str, dark: Tensor, config: Enhancement, pictures: Pictures, noise: Noise | None
) -> tuple[Tensor, Any]:
    """One view enhanced [H, W, 3], and the parameters of its enhancement; arguments as for `enhanced_twin`."""
    key = ("enhanced", name, pictures, config, stamps(config))
    return shared.once(key, lambda: _enhance(dark, config, None, noise))


def enhanced_like(dark: Tensor, config: Enhancement, params: Any) -> Tensor:
    """A picture [H, W, 3], sRGB-encoded in 0..1, through the enhancement of another one with these parameters."""
    return _enhance(dark, config, params)[0]


def enhanced_light(problem: Problem, light: Iterable[Tensor], config: Enhancement, pictures: Pictures) -> Tensor:
    """Linear pictures [H, W, 3] of a problem's views, each through the enhancement that its view got, [C, H, W, 3]."""
    found = []
    for name, dark, view in zip(problem.names, problem.encoded(pictures), light, strict=True):
        _, params = enhanced_view(problem.shared, name, dark, config, pictures, problem.noise)
        code = torch.from_numpy(encode(view.cpu().numpy())).to(dark)
        found.append(enhanced_like(code, config, params))
    return torch.stack(found)


def _enhance(dark: Tensor, config: Enhancement, params: Any, noise: Noise | None = None) -> tuple[Tensor, Any]:
    enhancer = next(e for e in ENHANCERS.values() if isinstance(config, e.config))
    return enhancer.enhance(dark, config, params, None if noise is None else noise.linear16)
