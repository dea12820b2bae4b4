"""Enhancers applied to the pictures of a problem and to their noise-free twins, once for all methods that ask."""

from collections.abc import Iterable, Iterator
from typing import Any

import torch
from torch import Tensor

from novags.methods.enhancers import enhancer_of
from novags.methods.enhancers.choice import Enhancement
from novags.methods.enhancers.enhancer import stamps
from novags.methods.inputs import LacksInput, Pictures
from novags.methods.memo import Memo
from novags.methods.noise import Noise
from novags.methods.problem import Problem, encode


def settled(problem: Problem, config: Enhancement, pictures: Pictures) -> Enhancement:
    """The configuration with the numbers that it takes from the whole scene; records state them too."""
    _, enhancer = enhancer_of(config)
    return config if enhancer.settled is None else enhancer.settled(problem.encoded(pictures), config)


def enhanced(problem: Problem, config: Enhancement, pictures: Pictures) -> Tensor:
    """The enhanced pictures of a problem [C, H, W, 3]; made once for all methods that share them."""
    dark = problem.encoded(pictures)
    found = torch.empty_like(dark)
    for view, name in enumerate(problem.names):
        noise = problem.noise_at(view)
        found[view] = enhanced_view(problem.shared, name, dark[view], config, pictures, noise)[0]
    return found


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
    found = torch.empty_like(clean)
    for k, view in enumerate(zip(problem.names, dark, clean, strict=True)):
        noise = problem.noise_at(k)
        found[k] = enhanced_twin(problem.shared, *view, config, pictures, noise, demosaiced=demosaiced)
    return found


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
        noise: Of the view, where it is known.
        demosaiced: Whether `clean` was interpolated from a mosaic.
    """
    params = parameters(shared, name, dark, config, pictures, noise)
    key = ("enhanced clean", name, pictures, config, stamps(config), demosaiced)
    return shared.once(key, lambda: _enhance(clean, config, params)[0])


def enhanced_view(
    shared: Memo, name: str, dark: Tensor, config: Enhancement, pictures: Pictures, noise: Noise | None
) -> tuple[Tensor, Any]:
    """One view enhanced [H, W, 3], and the parameters of its enhancement; arguments as for `enhanced_twin`."""
    key = ("enhanced", name, pictures, config, stamps(config))
    return shared.once(key, lambda: _enhance(dark, config, None, noise))


def parameters(
    shared: Memo, name: str, dark: Tensor, config: Enhancement, pictures: Pictures, noise: Noise | None
) -> Any:
    """The parameters of the enhancement of one view, kept for longer than its picture; arguments as `enhanced_view`."""
    key = ("parameters", name, pictures, config, stamps(config))
    return shared.once(key, lambda: enhanced_view(shared, name, dark, config, pictures, noise)[1])


def enhanced_like(dark: Tensor, config: Enhancement, params: Any) -> Tensor:
    """A picture [H, W, 3], sRGB-encoded in 0..1, through the enhancement of another one with these parameters."""
    return _enhance(dark, config, params)[0]


def enhanced_light(
    problem: Problem, light: Iterable[Tensor], config: Enhancement, pictures: Pictures
) -> Iterator[Tensor]:
    """Linear pictures [H, W, 3] of a problem's views, one by one through the enhancement that each view got."""
    for params, view in zip(parameters_of_all(problem, config, pictures), light, strict=True):
        yield enhanced_like(torch.from_numpy(encode(view.cpu().numpy())).to(view.device), config, params)


def parameters_of_all(problem: Problem, config: Enhancement, pictures: Pictures) -> list[Any]:
    """The parameters of the enhancement of every view; no pictures are read for them again."""

    def made() -> list[Any]:
        views = enumerate(zip(problem.names, problem.encoded(pictures), strict=True))
        return [parameters(problem.shared, *view, config, pictures, problem.noise_at(k)) for k, view in views]

    return problem.once(("parameters of all", problem.names, pictures, config, stamps(config)), made)


def _enhance(dark: Tensor, config: Enhancement, params: Any, noise: Noise | None = None) -> tuple[Tensor, Any]:
    _, enhancer = enhancer_of(config)
    found: tuple[Tensor, Any] = enhancer.enhance(dark, config, params, None if noise is None else noise.linear16)
    return found
