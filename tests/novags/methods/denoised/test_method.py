"""The method as a whole: its targets, its checkpoint, what it refuses."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from novags.methods.denoised import kept
from novags.methods.denoised.config import AdaptConfig, DenoiseConfig, DenoisedConfig, parts
from novags.methods.denoised.estimate import estimate_all
from novags.methods.denoised.measured import measured
from novags.methods.denoised.trainer import train
from novags.methods.denoised.weights import load_weights
from novags.methods.enhancers.applying import enhanced, enhanced_like, enhanced_view
from novags.methods.inputs import LacksInput
from novags.methods.noise import Variance
from novags.methods.problem import Problem, encode
from novags.splats import FitConfig

ADAPT = AdaptConfig(steps=3, batch=2, crop=16)
CONFIG = DenoisedConfig(denoise=DenoiseConfig(adapt=ADAPT, turns=2), fit=FitConfig(iterations=20, checkpoint_every=5))


def test_its_targets_are_the_denoised_data_through_the_enhancement_of_the_noisy_picture(problem: Problem) -> None:
    config = replace(CONFIG, denoise=DenoiseConfig(adapt=None, turns=2))
    found = train(problem, config)
    pictures = measured(problem)
    electrons = estimate_all(load_weights(), pictures.electrons, pictures.mask, pictures.read_variance, turns=2)
    light = torch.from_numpy(encode(pictures.linear(electrons).numpy()))
    assert found.targets is not None
    assert problem.clean is not None
    reference = []
    for i, name in enumerate(problem.names):
        _, params = enhanced_view(problem.shared, name, problem.srgb8[i], config.enhance, "8bit", problem.noise)
        torch.testing.assert_close(found.targets[i], enhanced_like(light[i], config.enhance, params))
        reference.append(enhanced_like(problem.clean[i], config.enhance, params))
    noisy = enhanced(problem, config.enhance, "8bit")
    assert found.enhanced is not None
    assert torch.equal(found.enhanced, noisy)
    errors = [float((x - torch.stack(reference)).square().mean()) for x in (found.targets, noisy)]
    assert errors[0] < 0.5 * errors[1]
    assert found.space == "enhanced"


def test_the_adaptation_changes_the_targets_and_counts_in_the_progress(problem: Problem) -> None:
    seen: list[tuple[int, int, tuple[str, ...]]] = []
    adapted = train(problem, CONFIG, progress=lambda done, total, losses: seen.append((done, total, tuple(losses))))
    plain = train(problem, replace(CONFIG, denoise=DenoiseConfig(adapt=None, turns=2)))
    assert adapted.targets is not None
    assert plain.targets is not None
    assert not torch.equal(adapted.targets, plain.targets)
    assert parts(CONFIG) == {"denoiser": 3, "fit": 20}
    assert [step[:2] for step in seen] == [(i, 23) for i in (1, 2, 3, 13, 23)]  # a fit reports every ten
    assert [step[2] for step in seen[:3]] == [("denoiser",)] * 3
    assert {"denoise", "enhance", "fit"} <= adapted.seconds.keys()


def test_another_seed_adapts_to_other_crops(problem: Problem) -> None:
    config = replace(CONFIG, fit=FitConfig(iterations=1))
    first, again, other = (train(replace(problem, seed=seed), config).targets for seed in (5, 5, 6))
    assert torch.equal(first, again)  # type: ignore[arg-type]
    assert not torch.equal(first, other)  # type: ignore[arg-type]


def test_an_interrupted_run_takes_its_denoised_pictures_up_again(problem: Problem, tmp_path: Path) -> None:
    class Interrupted(Exception):
        pass

    def stop(done: int, total: int, losses: dict[str, float]) -> None:
        if done == 13:
            raise Interrupted

    whole = train(problem, CONFIG)
    with pytest.raises(Interrupted):
        train(problem, CONFIG, progress=stop, checkpoint=tmp_path / "checkpoint.safetensors")
    spent = float(load_file(tmp_path / "checkpoint.denoiser.safetensors")["seconds"])
    seen: list[int] = []
    found = train(
        problem, CONFIG, progress=lambda done, *_: seen.append(done), checkpoint=tmp_path / "checkpoint.safetensors"
    )
    assert min(seen) > 3  # the adaptation is not done again
    assert 0 < spent <= found.seconds["denoise"]
    assert found.targets is not None
    assert whole.targets is not None
    assert torch.equal(found.targets, whole.targets)
    image = found.render(problem.views)[0]
    torch.testing.assert_close(image, whole.render(problem.views)[0])


def test_the_pictures_of_another_run_are_refused(problem: Problem, tmp_path: Path) -> None:
    checkpoint = tmp_path / "checkpoint.safetensors"
    kept = tmp_path / "checkpoint.denoiser.safetensors"
    train(problem, CONFIG, checkpoint=checkpoint)
    for other in (replace(problem, seed=6), replace(problem, raw=None)):
        with pytest.raises(ValueError, match="another run|other pictures"):
            train(other, CONFIG, checkpoint=checkpoint)
    tensors = load_file(kept)
    save_file({**tensors, "linear": tensors["linear"][:, :5].contiguous()}, kept)
    with pytest.raises(ValueError, match="damaged"):
        train(problem, CONFIG, checkpoint=checkpoint)


@pytest.mark.parametrize("what", ["electrons", "mask", "noise", "unit", "settings", "seed", "weights"])
def test_denoised_pictures_are_others_with_any_other_input(
    problem: Problem, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = measured(problem)
    curve = pictures.noise.curve
    changed = {
        "electrons": {"electrons": pictures.electrons + 1}, "mask": {"mask": 1 - pictures.mask},
        # Twice the electrons' unit, and the read noise in electrons stays what it is, to the last bit.
        "unit": {"unit": 2 * pictures.unit,
                 "noise": Variance(replace(curve, offset=tuple(4 * value for value in curve.offset)))},
        "noise": {"noise": Variance(replace(curve, offset=tuple(2 * value for value in curve.offset)))},
    }.get(what, {})  # fmt: skip
    own = kept._identity(pictures, CONFIG.denoise, 5)
    assert torch.equal(own, kept._identity(measured(problem), CONFIG.denoise, 5))
    if what == "weights":
        monkeypatch.setattr(kept, "read_bytes", lambda _: b"others")
    config = replace(CONFIG.denoise, turns=1) if what == "settings" else CONFIG.denoise
    other = kept._identity(replace(pictures, **changed), config, 6 if what == "seed" else 5)
    assert not torch.equal(own, other)


def test_without_known_noise_it_says_what_it_lacks(problem: Problem) -> None:
    with pytest.raises(LacksInput, match="noise"):
        train(replace(problem, noise=None), CONFIG)


@pytest.mark.parametrize("turns", [0, 9])
def test_there_are_one_to_eight_turns(turns: int) -> None:
    with pytest.raises(ValueError, match="turns"):
        DenoiseConfig(turns=turns)
