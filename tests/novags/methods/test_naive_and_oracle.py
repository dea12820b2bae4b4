from dataclasses import replace

import numpy as np
import pytest
import torch

from novags.methods.enhanced import clean_fit as oracle
from novags.methods.enhanced import enhance_then_fit as naive
from novags.methods.enhanced.config import EnhancedFitConfig
from novags.methods.enhanced.oracle import OracleConfig
from novags.methods.enhancers import recorded
from novags.methods.enhancers.applying import enhanced_like
from novags.methods.enhancers.curves.adaptive import statistics_of
from novags.methods.enhancers.guided import enhance
from novags.methods.enhancers.rows.adaptive import Ap3Config
from novags.methods.problem import Problem
from novags.splats import FitConfig, Gaussians, rasterize

CONFIG = EnhancedFitConfig(init_scale=0.7, fit=FitConfig(iterations=60, sh_degree=0, mcmc=None))
ORACLE = OracleConfig(init_scale=CONFIG.init_scale, fit=CONFIG.fit)


def error(gaussians: Gaussians, inputs: Problem) -> float:
    """Mean squared difference of the renderings to the enhanced noise-free views."""
    _, params = enhance(inputs.srgb8)
    truth, _ = enhance(inputs.clean, params=params)
    g, v = gaussians, inputs.views
    images, _, _ = rasterize(
        g.means, g.quats, g.scales, g.opacities, g.sh, v.viewmats, v.Ks, v.width, v.height, sh_degree=g.sh_degree
    )
    return float((images - truth).square().mean())


def test_naive_aims_at_the_enhanced_images(problem):
    inputs = problem()
    result = naive.train(inputs, CONFIG)
    enhanced, _ = enhance(inputs.srgb8)
    assert torch.equal(result.enhanced, enhanced)
    assert torch.equal(result.targets, enhanced)
    assert set(result.seconds) == {"enhance", "fit"}
    assert result.config.fit.extent == inputs.start.extent


def test_an_enhancement_of_the_whole_scene_is_the_same_for_all_views_and_stands_in_the_record(problem):
    """Rationale: references, reports and the viewer enhance by the record, and see one view at a time."""
    inputs = problem()
    config = replace(CONFIG, enhance=Ap3Config(scene_wide=True), fit=replace(CONFIG.fit, iterations=2))
    result = naive.train(inputs, config)
    dark = inputs.encoded("8bit")
    wanted = np.mean([statistics_of(view.double().numpy()) for view in dark], axis=0)
    _, found = recorded(result.enhancement)
    np.testing.assert_allclose(found.statistics, wanted)
    assert torch.equal(result.targets, torch.stack([enhanced_like(view, found, wanted) for view in dark]))


def test_oracle_aims_at_the_noise_free_images_under_the_noisy_ones_enhancement(problem):
    inputs = problem(sigma=0.02)
    result = oracle.train(inputs, ORACLE)
    _, params = enhance(inputs.srgb8)
    assert torch.equal(result.targets, enhance(inputs.clean, params=params)[0])


def test_of_a_mosaic_the_oracle_learns_from_three_channels_or_if_asked_from_what_was_interpolated(problem):
    """Rationale: one memo serves both, as in an experiment, and must not hand one the other's pictures."""
    inputs = problem(sigma=0.02)
    _, params = enhance(inputs.srgb8)
    mosaics = replace(inputs, clean_demosaiced=inputs.clean.roll(1, 2), shared=inputs.shared)
    targets = [
        oracle.train(made, replace(ORACLE, demosaiced=asked)).targets
        for made, asked in ((mosaics, False), (mosaics, True), (inputs, True))  # the last: three chips
    ]
    three, interpolated = (enhance(clean, params=params)[0] for clean in (mosaics.clean, mosaics.clean_demosaiced))
    assert torch.equal(targets[0], three)
    assert torch.equal(targets[1], interpolated)
    assert torch.equal(targets[2], three)
    assert not torch.equal(three, interpolated)


def test_noise_costs_naive_something_that_the_oracle_keeps(problem):
    inputs = problem(sigma=0.04)
    fit = FitConfig(iterations=200, sh_degree=0, mcmc=None)
    kept = error(oracle.train(inputs, replace(ORACLE, fit=fit)).scene.gaussians, inputs)
    spent = error(naive.train(inputs, replace(CONFIG, fit=fit)).scene.gaussians, inputs)
    assert kept < 0.8 * spent


def test_without_noise_naive_is_the_oracle(problem):
    inputs = problem(sigma=0)
    a, b = naive.train(inputs, CONFIG), oracle.train(inputs, ORACLE)
    assert torch.equal(a.scene.gaussians.means, b.scene.gaussians.means)
    assert torch.equal(a.scene.gaussians.sh, b.scene.gaussians.sh)


def test_a_capture_without_noise_free_exposures_has_no_oracle(problem):
    with pytest.raises(ValueError, match="noise-free exposures"):
        oracle.train(problem(with_clean=False), ORACLE)


def test_progress_and_checkpoint_reach_the_fit(problem, tmp_path):
    seen = []
    checkpoint = tmp_path / "checkpoint.safetensors"
    first = naive.train(problem(), CONFIG, progress=lambda *entry: seen.append(entry[:2]), checkpoint=checkpoint)
    assert seen[-1] == (60, 60)
    seen.clear()
    again = naive.train(problem(), CONFIG, progress=lambda *entry: seen.append(entry[:2]), checkpoint=checkpoint)
    assert not seen
    assert torch.equal(again.scene.gaussians.means, first.scene.gaussians.means)
