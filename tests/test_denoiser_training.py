"""The training of the packaged denoiser: its pairs, its rate, and that it continues where it was interrupted."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.denoised.weights import load_weights, made_by
from sensor_model import PRESETS, DarkFrames, Exposure, Sensor

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


def test_given_cameras_take_turns_as_mosaics_and_three_chips_each_time_as_another_copy() -> None:
    from denoising.pairs import TheseCameras

    given = [PRESETS[name] for name in ("a7s2-iso6400", "imx900-hcg")]
    rng = np.random.default_rng(0)
    drawn = [TheseCameras(given)(rng) for _ in range(200)]
    assert all(dark is None for _, dark in drawn)
    kinds = [(given.index(replace(sensor, cfa="RGGB", serial=next(g.serial for g in given if g.gain == sensor.gain))),
              sensor.cfa) for sensor, _ in drawn]  # fmt: skip
    counts = {kind: kinds.count(kind) for kind in set(kinds)}
    assert counts.keys() == {(0, "RGGB"), (0, None), (1, "RGGB"), (1, None)}
    assert min(counts.values()) > 50 - 5 * 6.2  # five standard deviations of 200 draws of a quarter
    assert len({sensor.serial for sensor, _ in drawn}) == 200


def test_of_a_camera_with_dark_frames_the_noise_without_light_is_theirs_and_the_network_is_told_so() -> None:
    from denoising.pairs import TheseCameras, photograph

    camera = PRESETS["a7s2-iso6400"]
    signs = np.random.default_rng(1).integers(0, 2, (40, 40, 40)) * 2 - 1
    codes = np.round(camera.black_level + 7 + 60 * signs).astype(np.uint16)  # no distribution that a camera has
    cameras = TheseCameras([camera], DarkFrames(codes=codes, sensor=camera))
    rng, clean, variance = np.random.default_rng(2), np.full((32, 32, 3), 0.5, np.float32), (60 / camera.gain) ** 2
    for k in range(6):
        sensor, dark = cameras(rng)
        found = photograph(clean, sensor, 0.02, k, dark)
        of = found.electrons[found.mask == 1]
        fourth = float((of - of.mean()).pow(4).mean() / (of - of.mean()).square().mean() ** 2)
        assert fourth < 1.2  # two values; 3 of a normal distribution
        assert float(of.mean()) == pytest.approx(0.02, abs=5 * (variance / len(of)) ** 0.5)  # 7 DN over black are known
        torch.testing.assert_close(found.read_variance, torch.full((1, 3), variance), rtol=0.02, atol=0)
    with pytest.raises(ValueError, match="dark frames are of one camera, got 2 cameras"):
        TheseCameras([camera, camera], DarkFrames(codes=codes, sensor=camera))


def test_what_another_camera_changes_is_paired_and_its_error_is_over_scenes(tmp_path: Path) -> None:
    from denoising.another_camera import SIDE, dark_frames, shown

    gain = {"x": 1.0, "y": 2.0}
    rows = [
        {"trained_on": name, "seed": seed, "scene": scene, "sensor": "b", "electrons": level,
         "psnr": str(20 + hard + (gain[scene] if name == "a" else 0)), "squared_error": "0.5"}
        for name in "ba" for seed, hard in (("0", 0), ("1", 3)) for scene in "xy" for level in ("5", "20")
    ]  # fmt: skip
    assert "| b | 21.50 |  | 0.5000 |  |" in shown(rows, "b")
    assert "| a | 23.00 | +1.50 ± 0.50 | 0.5000 | +0.0000 |" in shown(rows, "b")
    dark_frames("d850-iso6400", tmp_path / "dark")
    frames = np.stack([np.load(file) for file in sorted((tmp_path / "dark").iterdir())])
    assert frames.shape[1:] == (SIDE, SIDE)
    camera = PRESETS["d850-iso6400"]
    assert frames.mean() == pytest.approx(camera.black_level, abs=0.5)
    assert not (frames[0] == frames[1]).all()


def test_each_picture_sees_another_part_of_the_dark_frames_from_an_even_pixel_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from denoising import pairs

    camera = PRESETS["a7s2-iso6400"]
    codes = np.random.default_rng(3).normal(camera.black_level, 9, (8, 41, 37)).astype(np.uint16)
    dark, taken, original = DarkFrames(codes=codes, sensor=camera), list[tuple[int, int]](), pairs.expose

    def watched(light: np.ndarray, sensor: Sensor, exposure: Exposure, **how: Any) -> Any:
        taken.append(exposure.origin)
        return original(light, sensor, exposure, **how)

    monkeypatch.setattr(pairs, "expose", watched)
    for seed in range(80):
        pairs.photograph(np.full((32, 30, 3), 0.5, np.float32), camera, 1.0, seed, dark)
    assert {y for y, _ in taken} == {0, 2, 4, 6, 8}
    assert {x for _, x in taken} == {0, 2, 4, 6}


def test_the_camera_that_is_tested_is_a_copy_that_no_training_had_and_no_score_is_made_twice(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from denoising import another_camera

    taken: list[tuple[str, str | None, float, int, int]] = []

    class Photographed:
        def __init__(self, folder: Path, camera: Sensor, level: float, views: int, seed: int) -> None:
            taken.append((folder.name, camera.cfa, level, camera.serial, seed))
            self.pictures = SimpleNamespace(electrons=1, mask=2, read_variance=3)

        def scores(self, electrons: object) -> tuple[float, float]:
            assert electrons == ("network", 1, 2, 3)
            return 20.0, 0.5

    monkeypatch.setattr(another_camera, "Pictures", Photographed)
    monkeypatch.setattr(another_camera, "load_weights", lambda path: path)
    monkeypatch.setattr(another_camera, "estimate_all", lambda *inputs, turns: inputs)
    asked = SimpleNamespace(sets=[tmp_path / "x", tmp_path / "y"], b="d850-iso6400", views=3)
    rows = another_camera.tested("both", "network", 7, asked, [])  # type: ignore[arg-type]
    levels = another_camera.LEVELS
    camera = PRESETS["d850-iso6400"]
    assert [place[:3] for place in taken] == [
        (scene, cfa, level) for scene in "xy" for cfa in (None, camera.cfa) for level in levels
    ]
    assert {place[3:] for place in taken} == {(another_camera.UNSEEN, 7)}
    assert camera.serial != another_camera.UNSEEN
    assert {(row["psnr"], row["squared_error"]) for row in rows} == {("20", "0.5")}
    assert another_camera.tested("both", "network", 7, asked, rows) == []  # type: ignore[arg-type]
    words = another_camera.trainings("a", "b", Path("frames"))
    assert words["dark frames of b"] == ["--cameras", "b", "--dark-frames", "frames"]
    assert words["both"] == ["--cameras", "a", "b"]


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
        ("--cameras d850-iso6400", r"cameras must be .* \[\], got \['d850-iso6400'\]"),
        ("--steps 1", "had --steps 9 .* got --steps 1 "),
    ):
        with pytest.raises(ValueError, match=message) as error:
            train(monkeypatch, tmp_path / "x.safetensors", *more.split())
        assert "\n" not in str(error.value)
    train(monkeypatch, tmp_path / "x.safetensors", "--steps", "3")
    assert made_by(tmp_path / "x.safetensors")["steps"] == 3
