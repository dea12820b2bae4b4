"""`denoise-gs-twice`: renders of a first fit teach the network beside the data."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from novags.methods.denoised import kept, recorrupted
from novags.methods.denoised.config import AdaptConfig, DenoiseConfig
from novags.methods.denoised.measured import MeasuredPictures, measured
from novags.methods.denoised.recorrupted import Adaptation, Teacher, adapt
from novags.methods.denoised.trainer import train as train_once
from novags.methods.denoised.weights import load_weights
from novags.methods.problem import Problem
from novags.methods.rivals import denoised_twice
from novags.methods.rivals.denoised_twice import electrons_of, train
from novags.methods.rivals.rows.denoised_twice import DenoisedTwiceConfig
from novags.splats import FitConfig

ADAPT = AdaptConfig(steps=3, batch=2, crop=16)
CONFIG = DenoisedTwiceConfig(
    denoise=DenoiseConfig(adapt=ADAPT, turns=2), fit=FitConfig(iterations=20, checkpoint_every=5)
)


def truth(pictures: MeasuredPictures) -> Tensor:
    """The means of `problem`, electrons [3, 3, H, W]: the formula of its fixture, in the pictures' own unit."""
    y, x = torch.meshgrid(torch.arange(24) / 8.0, torch.arange(32) / 8.0, indexing="ij")
    clean = torch.stack([12 + 6 * torch.sin(x), 20 + 9 * torch.sin(y), 14 + 5 * torch.cos(x + y)])
    return clean.expand(3, -1, -1, -1).to(pictures.electrons)


def test_the_joint_loss_adds_the_distance_from_the_renders_in_units_of_the_noise(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures, generator = measured(problem), torch.Generator().manual_seed(0)
    data, held, render, found = (10 + 5 * torch.rand(1, 3, 4, 4, generator=generator) for _ in range(4))
    render[0, 1, :2] = torch.nan
    monkeypatch.setattr(recorrupted, "recorrupted", lambda values, *_: (values, values))
    monkeypatch.setattr(recorrupted, "estimate", lambda *_: found / 1.25)  # of an exposure of 1 / 1.25 of the light
    losses = []
    for teacher in (None, Teacher(render.expand(3, 3, 4, 4), 0.25)):
        adaptation = Adaptation(load_weights(), pictures, ADAPT, seed=1, teacher=teacher)
        crops = [data, held, torch.ones_like(data), *([] if teacher is None else [render])]
        monkeypatch.setattr(adaptation, "_crops", lambda crops=crops: crops)
        losses.append(float(adaptation.loss()))
    variance, total = pictures.variance(held), 0.0
    for place in torch.ones(3, 4, 4).nonzero().tolist():
        at = (0, *place)
        if not render[at].isnan():
            total += float((found[at] - render[at]) ** 2 / variance[at])
    assert losses[1] - losses[0] == pytest.approx(0.25 * total / 48, rel=1e-4)


def test_crops_of_renders_lie_where_the_crops_of_the_data_lie(problem: Problem) -> None:
    pictures = measured(problem)
    adaptation = Adaptation(load_weights(), pictures, ADAPT, seed=1, teacher=Teacher(7 * pictures.electrons, 1.0))
    for _ in range(5):
        electrons, _, _, render = adaptation._crops()
        assert torch.equal(render, 7 * electrons)


@pytest.mark.parametrize("better", [True, False])
def test_renders_that_are_nearer_to_the_truth_bring_the_estimate_nearer_and_others_are_not_followed(
    problem: Problem, better: bool
) -> None:
    """The data decide: a teacher that is wrong by three standard deviations changes the estimate little."""
    pictures, config = measured(problem), replace(ADAPT, steps=40, crop=24)
    wanted = truth(pictures)
    shown = wanted if better else wanted + 3 * pictures.variance(wanted).sqrt()
    errors = [float((adapt(load_weights(), pictures, config, seed=2, teacher=teacher).estimate_all(pictures, turns=1)
                     - wanted).square().mean()) for teacher in (None, Teacher(shown, 1.0))]  # fmt: skip
    if better:
        assert errors[1] < 0.8 * errors[0]
    else:
        assert errors[1] < 1.5 * errors[0]


def test_denoised_pictures_are_others_with_other_renders(problem: Problem) -> None:
    pictures = measured(problem)
    renders = truth(pictures)
    made = [kept._identity(pictures, CONFIG.denoise, 5, teacher) for teacher in
            (None, Teacher(renders, 1.0), Teacher(renders, 2.0), Teacher(renders + 1, 1.0))]  # fmt: skip
    assert not any(torch.equal(one, other) for k, one in enumerate(made) for other in made[:k])


def test_the_first_round_is_denoise_gs_and_the_second_learns_from_its_renders(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    taught: list[Teacher] = []
    original = denoised_twice.denoised_pictures

    def watched(*arguments, **more):  # type: ignore[no-untyped-def]
        taught.extend(one for one in arguments if isinstance(one, Teacher))
        return original(*arguments, **more)

    monkeypatch.setattr(denoised_twice, "denoised_pictures", watched)
    seen: list[tuple[int, int]] = []
    found = train(problem, CONFIG, progress=lambda done, total, _: seen.append((done, total)))
    once = train_once(problem, CONFIG)
    (teacher,) = taught
    linear = kept.denoised_pictures(problem, CONFIG, None, None)[0]
    assert once.targets is not None
    assert found.targets is not None
    expected = electrons_of(once.render(problem.views)[0], linear, once.targets, measured(problem))
    torch.testing.assert_close(teacher.electrons, expected, equal_nan=True, rtol=1e-5, atol=1e-5)
    assert teacher.weight == 1.0
    assert not torch.equal(found.targets, once.targets)
    assert [step for step, _ in seen] == [1, 2, 3, 13, 23, 24, 25, 26, 36, 46]
    assert {total for _, total in seen} == {46}


def test_a_run_that_was_stopped_in_its_second_fit_goes_on_there_and_ends_the_same(
    problem: Problem, tmp_path: Path
) -> None:
    class Interrupted(Exception):
        pass

    def stop(done: int, *_: object) -> None:
        if done == 36:
            raise Interrupted

    checkpoint, seen = tmp_path / "checkpoint.safetensors", list[int]()
    whole = train(problem, CONFIG)
    with pytest.raises(Interrupted):
        train(problem, CONFIG, progress=stop, checkpoint=checkpoint)
    found = train(problem, CONFIG, progress=lambda done, *_: seen.append(done), checkpoint=checkpoint)
    assert min(done for done in seen if done > 3) >= 23  # neither denoiser nor the first fit is trained again
    assert 24 not in seen
    assert torch.equal(found.render(problem.views)[0], whole.render(problem.views)[0])
