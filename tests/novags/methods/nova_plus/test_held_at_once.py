"""Pictures of all views are large: how many such stacks a method holds at once."""

import dataclasses
import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import torch

from novags.methods import METHODS
from novags.methods.denoised import denoiser, recorrupted
from novags.methods.denoised.config import AdaptConfig, DenoiseConfig
from novags.methods.nova import trainer as nova
from novags.methods.nova_plus import trainer as nova_plus
from novags.methods.nova_plus.config import NovaPlusConfig
from novags.settings import changed
from novags.splats.training.config import FitConfig

FIT = FitConfig(iterations=24)


def stacks(views: torch.Tensor) -> int:
    """Arrays of torch as large as these pictures of all views, each counted once however many look into it."""
    tensors = [found for found in gc.get_objects() if issubclass(type(found), torch.Tensor)]
    memory = [tensor.untyped_storage() for tensor in tensors]
    return len({each.data_ptr() for each in memory if each.nbytes() == views.untyped_storage().nbytes()})


def watched(monkeypatch: pytest.MonkeyPatch, places: list[tuple[Any, str]], views: torch.Tensor) -> dict[str, int]:
    """Of each function, how many stacks more than now there were when it was called."""
    gc.collect()
    before, most = stacks(views), dict.fromkeys((name for _, name in places), 0)

    def spy(name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def called(*given: Any, **more: Any) -> Any:
            most[name] = max(most[name], stacks(views) - before)
            return real(*given, **more)

        return called

    for module, name in places:
        monkeypatch.setattr(module, name, spy(name, getattr(module, name)))
    return most


def test_nova_plus_holds_no_picture_of_all_views_that_it_can_make_again(
    dark: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs, _ = dark()
    places = [(nova_plus, "fit"), (recorrupted, "recorrupted"), (denoiser, "estimate_all"), (nova_plus, "compare")]
    most = watched(monkeypatch, places, inputs.srgb8)
    denoise = DenoiseConfig(adapt=AdaptConfig(steps=2, crop=16, batch=1), turns=1)
    nova_plus.train(inputs, NovaPlusConfig(fit=FIT, denoise=denoise, seeds=2))
    assert most["fit"] == 2  # the data and the targets of stage 2
    assert most["recorrupted"] == 4  # the data, averages, the data in electrons, a first estimate
    assert most["estimate_all"] <= 4
    assert most["compare"] == 4  # the data, targets, what is compared with, its weights


def test_nova_holds_the_enhanced_pictures_and_the_denoised_ones(problem: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs = problem(with_clean=False)
    most = watched(monkeypatch, [(nova, "fit")], inputs.srgb8)
    small = {"warmup_steps": 1, "network.widths": (8,), "network.bottleneck": 8}
    config = changed(METHODS["nova"].config(), {f"denoiser.{name}": value for name, value in small.items()})
    config = dataclasses.replace(config, fit=dataclasses.replace(FIT, iterations=2))
    result = nova.train(inputs, config)
    assert most["fit"] == 2
    assert result.targets is not None


def test_between_the_fits_of_large_pictures_nova_plus_keeps_nothing_that_it_frees(
    dark: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs, _ = dark()
    inside: dict[str, set[bool]] = {}
    sparing: list[bool] = []

    @contextmanager
    def watched(wanted: bool) -> Iterator[None]:
        sparing.append(wanted)
        yield
        sparing.pop()

    monkeypatch.setattr(nova_plus, "sparing", watched)

    def asked(name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def called(*given: Any, **more: Any) -> Any:
            inside.setdefault(name, set()).add(any(sparing))
            return real(*given, **more)

        return called

    for name in ("fit", "choose_bandwidth", "denoised_light", "compare"):
        monkeypatch.setattr(nova_plus, name, asked(name, getattr(nova_plus, name)))
    denoise = DenoiseConfig(adapt=AdaptConfig(steps=2, crop=16, batch=1), turns=1)
    config = NovaPlusConfig(fit=FIT, denoise=denoise, seeds=2)
    _, height, width, _ = inputs.srgb8.shape
    for many, large in ((height * width, True), (height * width + 1, False)):
        monkeypatch.setattr(nova_plus, "MANY", many)
        inside.clear()
        nova_plus.train(inputs, config)
        assert inside == {"fit": {False}, "choose_bandwidth": {large}, "denoised_light": {large}, "compare": {large}}
