"""What holds for every rival: a stopped run ends as if it had not been, and refined cameras are given back."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from novags.methods import METHODS
from novags.methods.problem import Problem
from novags.settings import changed, has_setting
from novags.splats import CameraRefinement, FitConfig
from tests.novags.methods.rivals.short import SHORT

OF_RAW = ("raw-gs", "raw3dgs")
RIVALS = ("luminance-gs", "gaussian-dk", "ll-gaussian", "lita-gs", *OF_RAW)


def quick(name: str, fit: FitConfig = SHORT) -> Any:
    """The configuration of a rival that consists of a short fit."""
    config, settings = METHODS[name].config(), {"fit": fit, "init_scale": 0.7, "pretrain": None}
    return changed(config, {key: value for key, value in settings.items() if has_setting(config, key)}, what=name)


@pytest.mark.parametrize("name", RIVALS)
def test_a_stopped_run_ends_as_if_it_had_not_been(
    name: str, problem: Callable[..., Problem], dark: Callable[..., tuple[Problem, torch.Tensor]], tmp_path: Path
) -> None:
    inputs, path = dark()[0] if name in OF_RAW else problem(), tmp_path / "fit.safetensors"
    method, config = METHODS[name], quick(name)

    def train(**more: Any) -> Any:
        return method.train(inputs, config, **more)

    def stop(done: int, _: int, __: Any) -> None:
        if done == 40:
            raise KeyboardInterrupt

    whole = train()
    with pytest.raises(KeyboardInterrupt):
        train(progress=stop, checkpoint=path)
    resumed = train(checkpoint=path)
    assert torch.equal(whole.render(inputs.views)[0], resumed.render(inputs.views)[0])
    assert whole.found == resumed.found
    if whole.targets is not None:
        assert torch.equal(whole.targets, resumed.targets)


@pytest.mark.parametrize("name", RIVALS)
def test_refined_cameras_are_given_back_where_they_were_asked_for(
    name: str, problem: Callable[..., Problem], dark: Callable[..., tuple[Problem, torch.Tensor]]
) -> None:
    inputs = dark()[0] if name in OF_RAW else problem()
    method, refining = METHODS[name], replace(SHORT, refine_cameras=CameraRefinement(start=20))
    known, refined = (method.train(inputs, quick(name, fit)).viewmats for fit in (SHORT, refining))
    assert known is None
    assert refined is not None
    assert refined.shape == inputs.views.viewmats.shape
    assert not torch.equal(refined, inputs.views.viewmats)
    assert torch.allclose(refined, inputs.views.viewmats, atol=0.2)


def test_what_is_learned_beside_the_gaussians_starts_from_the_seed(problem: Callable[..., Problem]) -> None:
    inputs, method, config = problem(), METHODS["luminance-gs"], quick("luminance-gs")
    one, other = (method.train(replace(inputs, seed=seed), config).targets for seed in (0, 1))
    assert one is not None
    assert other is not None
    assert not torch.equal(one, other)
