"""The plain fit beside the method: what it is, and that held-out data may choose it."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.nova_plus import trainer
from novags.methods.nova_plus.config import FIT, NovaPlusConfig, parts
from novags.methods.nova_plus.judge import Verdict
from novags.methods.nova_plus.plain import Distance, plain_config
from novags.methods.nova_plus.trainer import train
from novags.splats import McmcConfig
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted

MCMC = McmcConfig(refine_start=4, refine_every=4)
CONFIG = NovaPlusConfig(
    fit=dataclasses.replace(FIT, iterations=48, sh_every=5, checkpoint_every=7, mcmc=MCMC), gaussians=160,
    held_share=0.1, denoise=None, seeds=1, plain=True,
)  # fmt: skip


def test_the_distance_and_its_gradient_are_those_of_the_data_that_are_there() -> None:
    generator = torch.Generator().manual_seed(0)
    image, target = (torch.randn(5, 6, 3, generator=generator) for _ in range(2))
    target[0, 1, 2], target[3] = torch.nan, torch.nan
    leaf = image.clone().requires_grad_()
    loss = Distance()(SimpleNamespace(render=leaf), target)  # type: ignore[arg-type]
    loss.backward()
    value, gradient = Distance().compare(image.numpy(), target.numpy())
    there = ~target.isnan()
    assert float(loss.detach()) == pytest.approx(float((image - target)[there].abs().mean()))
    assert float(value) == pytest.approx(float(loss.detach()))
    assert gradient.dtype == np.float32
    np.testing.assert_allclose(gradient, leaf.grad.numpy(), rtol=1e-6)
    assert not gradient[3].any()


def test_a_picture_without_any_datum_has_no_distance() -> None:
    nothing = torch.full((2, 2, 3), torch.nan)
    value, gradient = Distance().compare(np.ones((2, 2, 3), np.float32), nothing.numpy())
    assert value == 0
    assert not gradient.any()
    assert float(Distance()(SimpleNamespace(render=torch.ones(2, 2, 3)), nothing)) == 0  # type: ignore[arg-type]


def test_it_is_the_fit_of_naive_l1_in_the_demo_but_for_when_gaussians_begin_to_move() -> None:
    demo = adapted(EXPERIMENTS["demo"], methods=("naive-l1", "nova-plus"))
    theirs, base = (demo.reconstruct(name).config.fit for name in ("naive-l1", "nova-plus"))
    ours = plain_config(base, theirs.iterations)
    assert dataclasses.replace(ours, mcmc=dataclasses.replace(ours.mcmc, refine_start=100)) == theirs
    assert plain_config(dataclasses.replace(base, sh_degree=2, eps2d=0.2, cap_max=9), 7).sh_degree == 2


@pytest.mark.parametrize("worse", [True, False])
def test_held_out_data_choose_between_both(worse: bool, dark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, _ = dark()
    assert parts(CONFIG) == {"likelihood": 20, "denoiser": 0, "structure": 20, "plain": 48}
    fitted, asked = list[Any](), list[Any]()
    fit = trainer.fit

    def watched(start: Any, views: Any, target: Any, config: Any, **more: Any) -> Any:
        result = fit(start, views, target, config, **more)
        fitted.append((result.gaussians, config, more["photometric"]))
        return result

    def verdict(tones: Any, other: Any, *rest: Any) -> Verdict:
        asked.append(([tone.clone() for tone in tones], other.clone()))
        return Verdict(3.0 if worse and len(asked) == 2 else 1.0, 1.0)

    monkeypatch.setattr(trainer, "fit", watched)
    monkeypatch.setattr(trainer, "compare", verdict)
    result = train(inputs, CONFIG)
    (first, _, _), (second, _, _), (plain, config, loss) = fitted
    assert (config.iterations, config.dssim_weight, config.cap_max) == (48, 0.0, 160)
    assert isinstance(loss, Distance)
    chosen = plain if worse else second
    assert torch.equal(result.scene.gaussians.means, chosen.means)  # type: ignore[attr-defined]
    assert result.found["plain"] == {"excess": 3.0 if worse else 1.0, "deviation": 1.0}
    assert not torch.equal(first.means, second.means)
    ours, theirs = asked[1]
    assert not torch.allclose(torch.stack(ours), theirs)


def test_it_sees_no_pixel_that_is_held_out(dark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, _ = dark()
    seen = list[torch.Tensor]()
    fit = trainer.fit

    def watched(start: Any, views: Any, target: Any, config: Any, **more: Any) -> Any:
        if isinstance(more["photometric"], Distance):
            seen.extend(target(i) for i in range(len(views)))
        return fit(start, views, target, config, **more)

    monkeypatch.setattr(trainer, "fit", watched)
    result = train(inputs, CONFIG)
    missing = torch.stack(seen).isnan()
    assert int(missing.all(-1).sum()) == result.found["held_out_pixels"] > 0
    assert torch.equal(missing.all(-1), missing.any(-1))
