"""Enhancers by name: pictures enhanced once a view, the noise-free twin by the noisy one's parameters, records."""

from types import SimpleNamespace

import pytest
import torch

from novags.methods import enhancers
from novags.methods.enhancers import enhancement_record, recorded
from novags.methods.enhancers.applying import enhanced, enhanced_clean, enhanced_light
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.enhancer import Enhancer
from novags.methods.enhancers.guided import EnhanceParams, enhance, typical
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


def test_typical_parameters_are_the_mean_of_both():
    params = [
        EnhanceParams(gamma=torch.tensor(g), epsilon=torch.tensor(e), radius=4) for g, e in ((0.2, 0.01), (0.5, 0.04))
    ]
    middle = typical(params)
    assert (float(middle.gamma), float(middle.epsilon)) == pytest.approx((0.35, 0.025))
    assert middle.radius == 4


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


def test_a_record_says_enough_to_enhance_again():
    record = enhancement_record(CONFIG, "16bit")
    assert (record["enhancer"], record["pictures"], record["config"]["window"]) == ("guided", "16bit", 5)
    enhancer, config = recorded(record)
    assert enhancer is enhancers.ENHANCERS["guided"]
    assert config == CONFIG


@pytest.mark.parametrize(
    ("change", "match"), [({"enhancer": "none such"}, "unknown enhancer"), ({"config": {"sigma": 1}}, "run it again")]
)
def test_records_of_other_enhancers_or_versions_are_refused(change, match):
    with pytest.raises(ValueError, match=match):
        recorded({**enhancement_record(CONFIG, "8bit"), **change})


def test_a_configuration_of_no_enhancer_is_refused():
    with pytest.raises(ValueError, match="no enhancer has a configuration like SimpleNamespace"):
        enhancement_record(SimpleNamespace(), "8bit")
