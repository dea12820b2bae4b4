"""Enhancers applied to pictures: once a view, the noise-free twin by the noisy one's parameters."""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from novags.methods import enhancers
from novags.methods.enhancers import applying
from novags.methods.enhancers.applying import enhanced, enhanced_clean, enhanced_light
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.enhancer import Enhancer
from novags.methods.enhancers.guided import enhance, typical
from novags.methods.memo import Memo
from novags.methods.problem import Problem
from novags.splats import Views
from sensor_model import linear_to_srgb, srgb_to_linear

CONFIG = EnhanceConfig(window=5)


def problem(**changes) -> Problem:
    g = torch.Generator().manual_seed(0)
    clean = 0.05 + 0.2 * torch.rand(3, 12, 14, 3, generator=g)
    dark = (clean + 0.03 * torch.randn(clean.shape, generator=g)).clamp(0, 1)
    views = Views(torch.eye(4).repeat(3, 1, 1), torch.eye(3).repeat(3, 1, 1), 14, 12)
    values = {"views": views, "srgb8": dark, "clean": clean, "start": SimpleNamespace(), "seed": 0}
    return Problem(**{**values, **changes})


def test_every_picture_is_enhanced_on_its_own():
    inputs = problem()
    expected = torch.stack([enhance(picture, CONFIG)[0] for picture in inputs.srgb8])
    assert torch.equal(enhanced(inputs, CONFIG, "8bit"), expected)


def test_the_noise_free_twin_goes_through_the_noisy_ones_enhancement():
    inputs = problem()
    pairs = zip(inputs.srgb8, inputs.clean, strict=True)
    expected = [enhance(clean, CONFIG, enhance(dark, CONFIG)[1])[0] for dark, clean in pairs]
    assert torch.equal(enhanced_clean(inputs, CONFIG, "8bit"), torch.stack(expected))
    with pytest.raises(ValueError, match="noise-free exposures"):
        enhanced_clean(problem(clean=None), CONFIG, "8bit")


def test_sixteen_bit_pictures_are_encoded_first():
    linear = problem().srgb8 ** 2.2 - 0.001
    inputs = problem(linear16=linear)
    expected = torch.stack([enhance(picture, CONFIG)[0] for picture in inputs.encoded("16bit")])
    assert torch.equal(enhanced(inputs, CONFIG, "16bit"), expected)
    assert not torch.equal(enhanced(inputs, CONFIG, "8bit"), expected)


def test_light_is_encoded_and_goes_through_the_enhancement_that_its_view_got():
    inputs = problem()
    light = [0.9 * srgb_to_linear(view.numpy()) - 0.01 for view in inputs.clean]  # below 0 where it is darkest
    found = enhanced_light(inputs, (torch.from_numpy(view) for view in light), CONFIG, "8bit")
    for dark, view, bright in zip(inputs.srgb8, light, found, strict=True):
        code = torch.from_numpy(linear_to_srgb(view.clip(0))).float()
        torch.testing.assert_close(bright, enhance(code, CONFIG, enhance(dark, CONFIG)[1])[0])


def test_a_picture_is_enhanced_once_for_all_who_ask_with_the_same_settings(monkeypatch):
    calls = []

    def counted(dark, config, params, noise):
        calls.append(config)
        return enhance(dark, config, params, noise)

    monkeypatch.setitem(enhancers.ENHANCERS, "guided", Enhancer(EnhanceConfig, counted, typical, title=""))
    inputs = problem()
    for _ in range(2):
        enhanced(inputs, CONFIG, "8bit")
    assert len(calls) == 3
    for _ in range(2):
        enhanced_clean(inputs, CONFIG, "8bit")
    assert len(calls) == 6
    enhanced(inputs, EnhanceConfig(window=7), "8bit")
    assert len(calls) == 9


@dataclass(frozen=True)
class Brighter:
    """The settings of an enhancer that multiplies, by the number in its file of weights too."""

    weights: tuple[Path, ...]
    times: float = 1.0


@pytest.mark.parametrize("change", ["nothing", "view", "pictures", "settings", "weights", "demosaiced"])
def test_what_was_enhanced_otherwise_is_not_taken_for_the_same(change, tmp_path, monkeypatch):
    file, shared, calls = tmp_path / "weights", Memo(), []
    file.write_text("2")

    def brighten(dark: torch.Tensor, config: Brighter, params: Any, noise: Any) -> tuple[torch.Tensor, Any]:
        calls.append(params)
        return dark * config.times * float(config.weights[0].read_text()), "params"

    monkeypatch.setattr(applying, "enhancer_of", lambda config: ("brighter", SimpleNamespace(enhance=brighten)))
    asked: dict[str, Any] = {"name": "a", "dark": torch.full((2, 2, 3), 0.1), "config": Brighter((file,)),
                             "pictures": "8bit", "noise": None}  # fmt: skip
    twin = {"clean": torch.full((2, 2, 3), 0.05), "demosaiced": False}
    applying.enhanced_view(shared, **asked)
    applying.enhanced_twin(shared, **asked, **twin)
    assert calls == [None, "params"]  # the twin is not taken for the view, nor the reverse
    others: dict[str, dict[str, Any]] = {
        "view": {"name": "b"}, "pictures": {"pictures": "16bit"}, "settings": {"config": Brighter((file,), times=3.0)},
    }  # fmt: skip
    if change == "weights":
        file.write_text("4")
        os.utime(file, ns=(1, 1))
    view = applying.enhanced_view(shared, **asked | others.get(change, {}))
    applying.enhanced_twin(shared, **asked | others.get(change, {}), **twin | {"demosaiced": change == "demosaiced"})
    again = {"nothing": [], "demosaiced": ["params"]}.get(change, [None, "params"])
    assert calls == [None, "params", *again]
    factor = {"settings": 6, "weights": 4}.get(change, 2)
    torch.testing.assert_close(view[0], asked["dark"] * factor)


@pytest.mark.parametrize("change", ["nothing", "views", "pictures", "settings", "weights"])
def test_parameters_are_those_of_these_views_pictures_settings_and_weights(change, tmp_path, monkeypatch):
    file, calls = tmp_path / "weights", []
    file.write_text("2")

    def counted(dark: torch.Tensor, config: Brighter, params: Any, noise: Any) -> tuple[torch.Tensor, Any]:
        calls.append(config)
        return dark, len(calls)

    monkeypatch.setattr(applying, "enhancer_of", lambda config: ("counted", SimpleNamespace(enhance=counted)))
    one = problem(linear16=problem().srgb8)
    config, pictures, other = Brighter((file,)), "8bit", one
    assert applying.parameters_of_all(one, config, pictures) == [1, 2, 3]
    match change:
        case "views":
            other = replace(one, names=("a", "b", "c"))
        case "pictures":
            pictures = "16bit"
        case "settings":
            config = replace(config, times=3.0)
        case "weights":
            os.utime(file, ns=(1, 1))
    again = [1, 2, 3] if change == "nothing" else [4, 5, 6]
    for name, dark, params in zip(other.names, other.encoded(pictures), again, strict=True):
        assert applying.parameters(other.shared, name, dark, config, pictures, None) == params
    assert applying.parameters_of_all(other, config, pictures) == again
