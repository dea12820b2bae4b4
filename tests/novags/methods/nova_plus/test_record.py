"""What a run of the method records about itself."""

import importlib
import time
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
