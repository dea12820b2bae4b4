"""The published constants of rivals are what they run with; figures of a wrong weight would still look plausible."""

import math
from typing import Any

import pytest

from novags.methods import METHODS
from novags.methods.enhanced.config import ORIGINAL_FIT
from novags.methods.rivals.gaussian_dk import ANCHOR
from novags.methods.rivals.rows.le3d import ColourRates

PUBLISHED: dict[str, dict[str, Any]] = {
    "luminance-gs": {
        "contrast": 0.5, "lit_weight": 0.5, "contrast_weight": 1.0, "histogram_weight": 10.0, "curve_rate": 1e-3,
        "attention_rate": 1e-5, "axes_rate": 2e-4,
    },
    "lita-gs": {"prior_weight": 0.01, "exposure": 0.49, "denoiser_rate": 5e-5, "tone_rate": 1e-4},
    "raw-gs": {"epsilon": 1e-3},
    "raw3dgs": {"epsilon": 1e-3, "noise_weight": None, "covariance_weight": 20.0, "extractor_rate": 1e-4},
    "le3d": {
        "epsilon": 1e-3, "opaque_weight": 0.01, "spread_weight": 0.1, "near_far_weight": 0.01, "scatter": 5.0,
        "init_opacity": 0.1, "network_rate": 1e-4,
    },
    "raw-nerf": {"epsilon": 1e-3},
    "aleth-nerf": {"target": 0.45, "contrast": 12.0, "control": 1e-3, "structure": 1e-3, "grey": 1e-8},
    "ll-nerf": {"mean": 0.55, "exposure": 0.1, "grey": 0.1, "smooth": 0.1, "gamma": 0.01},
    "i2-nerf": {
        "truth_statistics": False, "dark": 1.0, "structure": 1.0, "bright": 1e-3, "overlap": 1e-3, "variation": 0.1,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_rival_runs_with_its_published_constants(name: str) -> None:
    config = METHODS[name].config()
    assert {key: getattr(config, key) for key in PUBLISHED[name]} == PUBLISHED[name]


@pytest.mark.parametrize("name", ["luminance-gs", "lita-gs", "gaussian-dk", "ll-gaussian", "raw-gs", "raw3dgs"])
def test_gaussians_of_rivals_are_fitted_as_those_of_naive(name: str) -> None:
    """A fair fight: the same fit, with a share of 0.2 of SSIM, and features at Luminance-GS's rate of k and b."""
    config = METHODS[name].config()
    assert config.fit == ORIGINAL_FIT == METHODS["naive"].config().fit
    assert config.init_scale == METHODS["naive"].config().init_scale
    assert (config.fit.dssim_weight, config.fit.rates.features) == (0.2, 2.5e-3)


def test_features_of_i2_nerf_decay_as_published_and_those_of_no_other_field() -> None:
    decays = {name: METHODS[name].config().fit.table_decay for name in PUBLISHED if name.endswith("-nerf")}
    assert decays == {"raw-nerf": 0.0, "aleth-nerf": 0.0, "ll-nerf": 0.0, "i2-nerf": 10.0}


def test_the_unit_of_radiance_is_held_by_half_the_weight_of_a_picture() -> None:
    assert ANCHOR == 0.5


def test_rates_of_the_colours_of_le3d_fall_by_half_a_cosine_and_others_do_not() -> None:
    rates = ColourRates()
    for iteration, left in ((0, 1.0), (25, (1 + math.sqrt(0.5)) / 2), (50, 0.5), (100, 0.0)):
        now = rates.at(iteration, 100)
        assert now.sh_dc == pytest.approx(1e-5 + left * (2e-3 - 1e-5))
        assert now.features == pytest.approx(1e-5 + left * (1e-4 - 1e-5))
        assert (now.quats, now.log_scales, now.logit_opacities) == (1e-3, 5e-3, 5e-2)
    cooled = ColourRates(cool_to=0.1).at(100, 100)
    assert (cooled.quats, cooled.sh_dc) == (pytest.approx(1e-4), pytest.approx(1e-5))
