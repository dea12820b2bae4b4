"""The training of enhancers on simulated pairs: the pairs, the loss, and weights that the methods can use."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from novags.methods.enhancers.files.weights import read_weights
from novags.methods.enhancers.networks.mbllen import MBLLEN
from novags.methods.enhancers.networks.rows.mbllen import MbllenConfig
from sensor_model import Sensor, linear_to_srgb, srgb_to_linear

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"


@pytest.fixture(autouse=True)
def on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS))


def test_a_pair_is_the_same_picture_dark_with_noise_and_well_exposed_without() -> None:
    from denoising.bright import WELL_EXPOSED, dark_and_bright

    camera = Sensor(cfa=None, gain=2.0, eta=0.6, mu_e_sat=10_000, black_level=256.0, bits=16, sigma_d=1.0,
                    rgb_response=(0.5, 1.0, 0.7))  # fmt: skip
    clean = np.ones((64, 64, 3), np.float32) * np.array([1.5, 1.0, 0.5], np.float32)
    pair = dark_and_bright(clean, camera, 0.05, seed=3)
    light = srgb_to_linear(pair.dark[0].double().numpy())
    np.testing.assert_allclose(light.mean((1, 2)), 0.05 * clean[0, 0], rtol=0.02)
    electrons = 0.05 * 10_000 * clean[0, 0] * np.array([0.5, 1.0, 0.7])
    wanted = np.sqrt(electrons + 1) / electrons  # relative noise: shot and read; 8 bits add a little
    np.testing.assert_allclose(light.std((1, 2)) / light.mean((1, 2)), wanted, rtol=0.1)
    np.testing.assert_allclose(pair.bright[0, :, 0, 0], linear_to_srgb(WELL_EXPOSED * clean[0, 0]), rtol=1e-5)
    assert float(pair.bright.std((2, 3)).max()) < 1e-6


def test_the_loss_is_l1_and_half_of_what_ssim_lacks() -> None:
    from dataclasses import replace

    from denoising.bright import BrightPairs
    from train_enhancer import loss_of

    generator = torch.Generator().manual_seed(0)
    dark, bright = (torch.rand(2, 3, 16, 16, generator=generator) for _ in range(2))
    kind = replace(MBLLEN, run=lambda network, picture, config: picture)
    same = loss_of(torch.nn.Identity(), BrightPairs(bright, bright), kind=kind, config=None)
    assert float(same) == pytest.approx(0, abs=1e-6)
    from novags.splats.training.losses import ssim

    alike = [float(ssim(a.movedim(0, -1), b.movedim(0, -1))) for a, b in zip(dark, bright, strict=True)]
    wanted = float((dark - bright).abs().mean()) + 0.5 * (1 - np.mean(alike))
    found = loss_of(torch.nn.Identity(), BrightPairs(dark, bright), kind=kind, config=None)
    assert float(found) == pytest.approx(wanted, rel=1e-5)


def test_a_name_that_no_method_would_read_is_refused_before_the_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import train_enhancer

    monkeypatch.setattr(sys, "argv", ["train_enhancer.py", "mbllen", "--out", str(tmp_path / "mbllen.pt")])
    with pytest.raises(SystemExit):
        train_enhancer.arguments()
    assert "--out must end in .safetensors, got" in capsys.readouterr().err


def test_weights_to_compare_with_are_read_before_the_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import train_enhancer

    out = tmp_path / "mbllen.safetensors"
    monkeypatch.setattr(sys, "argv", ["train_enhancer.py", "mbllen", "--out", str(out), "--beside", "gone.h5"])
    with pytest.raises(ValueError, match="there are no weights at gone.h5"):
        train_enhancer.main()
    assert not list(tmp_path.iterdir())


def test_a_crop_larger_than_a_picture_is_refused_by_size() -> None:
    from denoising.pairs import Source

    source = Source([], size=24, stock=1, rendered_share=0.0)
    assert source.draw(np.random.default_rng(0), 0, 24).shape == (24, 24, 3)
    with pytest.raises(ValueError, match="got 25 px and a picture of 24 x 24: choose a smaller --crop"):
        source.draw(np.random.default_rng(0), 0, 25)


@pytest.mark.parametrize(
    ("network", "more", "message"),
    [
        ("uretinex", "", "network must be as in the continued training, mbllen, got uretinex"),
        ("mbllen", "--seed 1", "seed must be .* 0, got 1: restore it, or delete .*checkpoint"),
        ("mbllen", "--crop 18", "crop must be .* 16, got 18"),
        ("mbllen", "--batch 2", "batch must be .* 1, got 2"),
        ("mbllen", "--rate 1e-3", "the rate of the 3 steps that are done must be this training's"),
    ],
)
def test_a_training_is_not_continued_with_other_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, network: str, more: str, message: str
) -> None:
    import train_enhancer
    from denoising.training import Schedule, Training

    settings = {"network": "mbllen", "seed": 0, "crop": 16, "batch": 1, "sets": []}
    before = Training(torch.nn.Linear(1, 1), Schedule(steps=20, rate=5e-4), torch.nn.Module, settings)
    before.step = 3
    before.save(tmp_path / "x.checkpoint.safetensors", 1.0)
    asked = ["train_enhancer.py", network, "--steps", "20", "--batch", "1", "--crop", "16", *more.split()]
    monkeypatch.setattr(sys, "argv", [*asked, "--out", str(tmp_path / "x.safetensors")])
    with pytest.raises(ValueError, match=message) as error:
        train_enhancer.main()
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_a_training_that_was_stopped_ends_with_the_same_weights_which_the_method_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import train_enhancer

    def train(out: Path, *more: str) -> None:
        size = ["--steps", "2", "--batch", "1", "--crop", "16", "--checks", "1"]
        monkeypatch.setattr(sys, "argv", ["train_enhancer.py", "mbllen", *size, "--out", str(out), *more])
        train_enhancer.main()

    train(tmp_path / "whole.safetensors")
    train(tmp_path / "cut.safetensors", "--stop", "1")
    before = (tmp_path / "cut.safetensors").rename(tmp_path / "halfway.safetensors")
    halfway = read_weights((before,))
    train(tmp_path / "cut.safetensors", "--beside", str(before))
    whole, cut = (read_weights((tmp_path / f"{name}.safetensors",)) for name in ("whole", "cut"))
    assert all(torch.equal(value, cut[name]) for name, value in whole.items())
    assert not all(torch.equal(value, halfway[name]) for name, value in whole.items())
    loaded = MBLLEN.load(MbllenConfig(weights=(tmp_path / "cut.safetensors",))).state_dict()
    assert all(torch.equal(value, cut[name]) for name, value in loaded.items())
    _, then, made = (json.loads(line) for line in capsys.readouterr().out.splitlines() if line.startswith("{"))
    assert (made["beside_psnr"], made["beside_ssim"]) == (then["psnr"], then["ssim"])
    assert len({made["psnr"], made["beside_psnr"], made["factor_psnr"]}) == 3
