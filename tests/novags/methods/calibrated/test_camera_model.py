"""Claims about the camera model: what it computes, that a lit scene calibrates it, and which files are refused."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter, uniform_filter
from torch import Tensor

from novags.methods.calibrated.calibrate import calibrate
from novags.methods.calibrated.camera_model import (
    PACKAGED,
    Calibration,
    CameraModel,
    amplified,
    as_record,
    mean_of_nine,
    read_calibration,
    smoothed,
)


def model(seed: int) -> CameraModel:
    rng = np.random.default_rng(seed)
    parts = (np.eye(3) + rng.normal(0, 0.1, (3, 3)), rng.uniform(0.8, 1.2, 3), rng.normal(0, 0.05, 3),
             rng.normal(0, 0.5, (3, 16)))  # fmt: skip
    return CameraModel(*(torch.from_numpy(part) for part in parts))


def by_hand(known: CameraModel, pixel: np.ndarray) -> list[float]:
    """The model of one pixel, number by number; the curve by numpy's interpolation between its 17 points."""
    found = []
    for c in range(3):
        mixed = sum(float(known.matrix[c, k]) * pixel[k] for k in range(3))
        clipped = min(1.0, max(0.0, float(known.gain[c]) * mixed + float(known.offset[c])))
        rises = np.exp(known.slopes[c].numpy())
        found.append(float(np.interp(clipped, np.arange(17) / 16, [0, *np.cumsum(rises / rises.sum())])))
    return found


def test_it_is_a_matrix_a_gain_an_offset_and_a_curve_of_sixteen_pieces() -> None:
    known, picture = model(0), np.random.default_rng(1).uniform(-0.1, 1.2, (9, 11, 3))
    wanted = np.apply_along_axis(lambda pixel: by_hand(known, pixel), -1, picture)
    assert (wanted == 0).any()
    assert (wanted > 1 - 1e-12).any()
    np.testing.assert_allclose(known(torch.from_numpy(picture)).numpy(), wanted, atol=1e-12)
    same = torch.from_numpy(picture)
    torch.testing.assert_close(CameraModel.first()(same), same.clamp(0, 1))


def test_its_gradient_is_the_slope_of_what_it_shows() -> None:
    known, picture = model(2), torch.from_numpy(np.random.default_rng(3).uniform(0.05, 0.95, (4, 5, 3)))
    parts = [part.clone().requires_grad_() for part in (known.matrix, known.gain, known.offset, known.slopes)]
    assert torch.autograd.gradcheck(lambda *p: CameraModel(*p[1:])(p[0]), (picture.requires_grad_(), *parts))


def test_filters_are_those_of_scipy_with_repeated_edges() -> None:
    picture = np.random.default_rng(4).random((13, 8, 3))
    blurred = gaussian_filter(picture, (1, 1, 0), mode="nearest", truncate=3)
    np.testing.assert_allclose(smoothed(torch.from_numpy(picture), 1.0).numpy(), blurred, atol=1e-12)
    wanted = uniform_filter(picture, (3, 3, 1), mode="nearest")
    np.testing.assert_allclose(mean_of_nine(torch.from_numpy(picture)).numpy(), wanted, atol=1e-12)
    assert smoothed(same := torch.from_numpy(picture), 0) is same


def scene(seed: int, noise: float) -> tuple[Tensor, Tensor, CameraModel]:
    """Lit pictures of smooth colours, and dark ones by a camera that mixes colours and bends tones."""
    rng = np.random.default_rng(seed)
    lit = gaussian_filter(rng.random((4, 24, 24, 3)), (0, 3, 3, 0))
    lit = np.clip(0.5 + 2.5 * (lit - lit.mean((1, 2), keepdims=True)), 0, 1)
    mix = np.array([[0.9, 0.15, -0.05], [0.1, 0.8, 0.1], [0.0, 0.2, 0.75]])
    dark = 0.25 * np.clip(lit @ mix.T, 0, 1) ** 1.6 + rng.normal(0, noise, lit.shape)
    return torch.from_numpy(dark.clip(0, 1)), torch.from_numpy(lit), model(0)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    dark, lit, _ = scene(5, 0.004)
    return calibrate(dark, lit, {"lit": "smooth colours"}, lambda *_: None)


def test_a_lit_scene_calibrates_colours_of_another_scene(calibration: Calibration) -> None:
    """Judged on pictures that it never saw, with less noise: the power alone leaves the mixed colours."""
    dark, lit, _ = scene(6, 0.0005)
    shown = calibration.amplified(dark)
    rough = (shown * torch.tensor(calibration.balance)).clamp(0, 1)
    fine = calibration.to_lit(shown)
    error = [float((smoothed(a, 1.0) - b).square().mean().sqrt()) for a, b in ((rough[0], lit[0]), (fine[0], lit[0]))]
    assert error[1] < 0.03
    assert error[1] < 0.5 * error[0]
    assert float((calibration.to_dark(lit) - dark).square().mean().sqrt()) < 0.006  # of codes up to 0.25


def test_a_calibration_is_read_as_it_was_written(calibration: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(as_record(calibration)))
    found = read_calibration(path)
    assert found.made == {"lit": "smooth colours"}
    assert (found.gain, found.gamma) == pytest.approx((calibration.gain, calibration.gamma), abs=1e-5)
    picture = torch.from_numpy(np.random.default_rng(7).random((5, 5, 3)))
    for side in ("to_lit", "to_dark"):
        torch.testing.assert_close(
            getattr(found, side)(picture), getattr(calibration, side)(picture), rtol=0, atol=1e-4
        )
    torch.testing.assert_close(found.amplified(picture), amplified(picture, calibration.gain, calibration.gamma),
                               rtol=0, atol=1e-4)  # fmt: skip


def test_dark_codes_are_amplified_by_the_gain_after_the_power_and_clipped() -> None:
    codes = torch.tensor([-0.1, 0.04, 0.09, 0.16, 0.36, 1.0], dtype=torch.float64)
    assert amplified(codes, 2.0, 2.0).tolist() == pytest.approx([0.0, 0.4, 0.6, 0.8, 1.0, 1.0], abs=2e-3)
    assert amplified(codes, 0.5, 2.0).tolist() == pytest.approx([0.0, 0.1, 0.15, 0.2, 0.3, 0.5], abs=2e-3)


def test_pictures_of_other_shapes_calibrate_nothing() -> None:
    dark, lit, _ = scene(5, 0.0)
    with pytest.raises(ValueError, match=r"dark and lit must both be \[C, H, W, 3\], got \[4, 24, 24, 3\] and \[3, 24"):
        calibrate(dark, lit[:3], {}, lambda *_: None)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [("gamma", 0.0, "gain and gamma must be > 0"), ("balance", [1.0, 1.0], "balance"), ("to_lit", {}, "to_lit"),
     ("gain", "2", "gain")],
)  # fmt: skip
def test_a_file_that_is_no_calibration_is_refused(key: str, value: Any, said: str, tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps({**json.loads(PACKAGED.read_text()), key: value}))
    with pytest.raises(ValueError, match=f"{said}(?s:.)*calibrate again, by novags.methods.calibrated.calibrate"):
        read_calibration(path)


def test_the_packaged_one_says_which_scene_was_lit() -> None:
    found = read_calibration(None)
    assert found.made["lit"].startswith("tabletop, 20 electrons")
    dark = torch.linspace(0, 0.2, 12, dtype=torch.float64).view(2, 2, 3)
    assert (found.to_lit(found.amplified(dark)) >= found.to_lit(found.amplified(0 * dark))).all()
    assert replace(found, gain=2.0).amplified(dark).max() <= 1
