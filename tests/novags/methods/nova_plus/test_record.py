"""What a run of the method records about itself."""

import importlib
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from novags.methods.nova_plus import trainer
from novags.methods.nova_plus.trainer import train
from tests.novags.methods.nova_plus.test_trainer import CONFIG

fitting = importlib.import_module("novags.splats.training.fit")  # the package has a function of that name


def test_a_run_that_goes_on_counts_what_it_does_between_the_fits(
    dark: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: averages and denoised data are made anew, and fits that were done before count as fits alone."""
    inputs, checkpoint, original = dark()[0], tmp_path / "checkpoint.safetensors", fitting._mcmc_step
    left = [65]

    def step(*args: Any) -> Any:
        time.sleep(0.05)
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return original(*args)

    def choose(*args: Any) -> Any:
        time.sleep(0.3)
        return chosen(*args)

    chosen = trainer.choose_bandwidth
    monkeypatch.setattr(trainer, "choose_bandwidth", choose)
    monkeypatch.setattr(fitting, "_mcmc_step", step)
    with pytest.raises(KeyboardInterrupt):
        train(inputs, CONFIG, checkpoint=checkpoint)
    monkeypatch.setattr(fitting, "_mcmc_step", original)
    seconds = train(inputs, CONFIG, checkpoint=checkpoint).seconds
    assert seconds["fit"] > 40 * 0.05
    assert seconds["averages"] >= 0.3


def test_checkpoints_of_a_run_of_other_pictures_or_settings_are_refused(dark: Any, tmp_path: Path) -> None:
    """Rationale: those of the fits say nothing of targets and losses, which would be those of the other run."""
    inputs, checkpoint = dark()[0], tmp_path / "checkpoint.safetensors"
    config = replace(CONFIG, stages="likelihood", seeds=1)
    train(inputs, config, checkpoint=checkpoint)
    for name, value in {"held_share": 0.3, "averaged_share": 1.0, "bandwidth": 0.3, "noise": "pictures"}.items():
        with pytest.raises(ValueError, match="checkpoints belongs to a run of other pictures or settings"):
            train(inputs, replace(config, **{name: value}), checkpoint=checkpoint)
    assert inputs.linear16 is not None
    for other in (replace(inputs, linear16=1.001 * inputs.linear16), replace(inputs, seed=1)):
        with pytest.raises(ValueError, match="checkpoints belongs to a run of other pictures or settings"):
            train(other, config, checkpoint=checkpoint)
    train(inputs, config, checkpoint=checkpoint)
    (tmp_path / trainer.CHECKPOINTS / "run").unlink()  # of nobody knows whom
    with pytest.raises(ValueError, match="delete it"):
        train(inputs, config, checkpoint=checkpoint)


def test_the_losses_of_all_fits_follow_each_other_in_the_iterations_of_the_run(dark: Any) -> None:
    """Expectation: every tenth iteration of each fit, and its last, after the iterations of the fits before."""
    config = replace(CONFIG, stages="likelihood", fit=replace(CONFIG.fit, iterations=60))
    each, joined = config.iterations("likelihood"), config.iterations("merged")
    assert each > 20
    ends = [(0, each), (each, 2 * each), (2 * each, 2 * each + joined)]
    wanted = [k for start, end in ends for k in range(start + 1, end + 1) if (k - start) % 10 == 0 or k == end]
    assert [entry["iteration"] for entry in train(dark()[0], config).losses] == wanted
