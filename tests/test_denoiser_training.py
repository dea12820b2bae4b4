"""The training of the packaged denoiser: its pairs, its rate, and that it continues where it was interrupted."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from novags.methods.denoised.weights import load_weights, made_by

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"


@pytest.fixture(autouse=True)
def on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS))


def test_the_noise_of_a_pair_has_the_variance_that_the_network_is_told() -> None:
    from denoising.pairs import photograph, random_camera

    clean = np.full((64, 64, 3), 0.3, np.float32)
    for seed, bayer in enumerate((False, True, False, True)):
        camera = random_camera(np.random.default_rng(seed), bayer=bayer)
        found = photograph(clean, camera, 30.0, seed)
        off = (found.electrons - found.clean) * found.mask
        count = found.mask.sum((2, 3))
        stated = found.clean[:, :, 0, 0] + found.read_variance
        response = torch.tensor([camera.rgb_response])
        read = camera.sigma_d**2 + camera.sigma_row**2 + camera.dsnu**2 + 1 / 12 / camera.gain**2
        torch.testing.assert_close(found.read_variance, torch.full((1, 3), read), rtol=1e-4, atol=0)
        torch.testing.assert_close(found.clean[:, :, 0, 0], 30 * response, rtol=1e-4, atol=0)
        assert float(found.mask.mean()) == pytest.approx(1 / 3 if bayer else 1)
        # a fixed pattern and row noise of up to a fifth are on top; 5 standard errors of a variance, doubled for tails
        torch.testing.assert_close(off.square().sum((2, 3)) / count, stated, rtol=0.35, atol=0)


def test_a_picture_follows_from_its_number_and_the_stock_from_the_step() -> None:
    from denoising.pairs import RENEWED, Source
    from denoising.pictures import picture

    assert np.array_equal(picture(3, 32), picture(3, 32))
    assert not np.array_equal(picture(3, 32), picture(4, 32))
    assert all(np.isfinite(p := picture(i, 24)).all() and p.min() > 0 and p.shape == (24, 24, 3) for i in range(20))
    early, late = (Source([], size=24, stock=4, rendered_share=0.3) for _ in range(2))
    for step in range(0, 3 * RENEWED, RENEWED):  # one was there from the start, the other joins after an interruption
        early.draw(np.random.default_rng(step), step, 16)
    step = 9 * RENEWED
    draws = [source.draw(np.random.default_rng(7), step, 16) for source in (early, late)]
    assert np.array_equal(*draws)
    assert not np.array_equal(draws[0], late.draw(np.random.default_rng(7), step + 4 * RENEWED, 16))


def test_a_run_stopped_before_the_rate_falls_can_be_finished_in_fewer_steps() -> None:
    from denoising.training import Schedule

    long, short = Schedule(steps=10_000, rate=1e-3), Schedule(steps=2_000, rate=1e-3)
    assert [long.at(s) for s in range(1_400)] == [short.at(s) for s in range(1_400)]
    assert long.at(0) == pytest.approx(1e-5)
    assert long.at(100) == long.at(6_999) == 1e-3
    assert long.at(8_500) == pytest.approx(5e-4)
    assert long.at(9_999) < 1e-6


def test_the_loss_is_the_distance_from_the_noise_free_picture_in_units_of_the_noise() -> None:
    from denoising.pairs import Pairs
    from denoising.training import checked, loss_of

    electrons, clean = torch.tensor([9.0, 20.0]), torch.tensor([12.0, 25.0])
    variance = torch.tensor([[0.5, 1.0, 4.0]])
    pairs = Pairs(*(v.expand(1, 3, 2, 2) for v in (electrons, torch.ones(2))), variance, clean.expand(1, 3, 2, 2))
    root = variance.flatten()[:, None] + 3 / 8
    distance = 2 * ((clean + root).sqrt() - (electrons + root).sqrt())  # of T(e) = 2 sqrt(e + 3/8 + read variance)

    def same(values: torch.Tensor, mask: torch.Tensor, read: torch.Tensor) -> torch.Tensor:
        assert torch.equal(read, variance)
        return values

    assert float(loss_of(same, pairs, "l1")) == pytest.approx(float(distance.mean()), rel=1e-4)
    assert float(loss_of(same, pairs, "l2")) == pytest.approx(float(distance.square().mean()), rel=1e-4)
    mosaic = replace(pairs, mask=torch.tensor([1.0, 0.0]).expand(1, 3, 2, 2), clean=pairs.electrons)
    assert checked(same, [pairs, mosaic]) == pytest.approx((float(distance.square().mean()), 0.0), rel=1e-4)


def train(monkeypatch: pytest.MonkeyPatch, out: Path, *more: str) -> None:
    from train_denoiser import main

    small = "--widths 4 6 --blocks 1 1 --batch 1 --crop 16 --stock 2 --steps 4 --seed 5 --makers 0".split()
    monkeypatch.setattr(sys, "argv", ["train_denoiser.py", "--out", str(out), *small, *more])
    main()


def test_an_interrupted_training_ends_with_the_same_weights_whoever_makes_its_pairs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train(monkeypatch, tmp_path / "whole.safetensors")
    train(monkeypatch, tmp_path / "parts.safetensors", "--stop", "2")
    train(monkeypatch, tmp_path / "parts.safetensors", "--makers", "1")
    whole, parts = (load_weights(tmp_path / f"{name}.safetensors").state_dict() for name in ("whole", "parts"))
    assert all(torch.equal(whole[name], parts[name]) for name in whole)
    made = made_by(tmp_path / "whole.safetensors")
    assert (made["seed"], made["steps"]) == (5, 4)
    assert "--seed 5" in made["command"]
    assert str(tmp_path) not in made["command"]


def test_a_training_is_continued_with_the_same_settings_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for the number of steps, which may change before the rate falls."""
    train(monkeypatch, tmp_path / "x.safetensors", "--stop", "2", "--steps", "9")
    for more, message in (
        (
            "--seed 6",
            "seed must be as in the continued training, 5, got 6: restore it, or delete .*checkpoint",
        ),
        ("--crop 18", "crop must be .* 16, got 18"),
        ("--batch 2", "batch must be .* 1, got 2"),
        ("--widths 4 8", r"widths must be .* \[4, 6\], got \[4, 8\]"),
        ("--loss l2", "loss must be .* l1, got l2"),
        ("--rate 0.002", "the rate of the 2 steps that are done .* --rate 0.001, got --steps 4 --rate 0.002"),
        ("--steps 1", "had --steps 9 .* got --steps 1 "),
    ):
        with pytest.raises(ValueError, match=message) as error:
            train(monkeypatch, tmp_path / "x.safetensors", *more.split())
        assert "\n" not in str(error.value)
    train(monkeypatch, tmp_path / "x.safetensors", "--steps", "3")
    assert made_by(tmp_path / "x.safetensors")["steps"] == 3
