"""Claims about the assertions for other people's tests: what is right passes, and each kind of mistake does not."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.testing import DarkCapture, assert_depth, assert_noise, assert_poses, assert_scores
from sensor_model import Exposure, expose, to_srgb8
from simscenes.sets.pictures.png import write_png

Make = Callable[..., DarkCapture]
BAYER = "imx900-hcg"


@pytest.fixture(scope="module")
def dark(dark_capture: Make) -> DarkCapture:
    return dark_capture("cornell", 20)


def test_scores_are_means_over_the_views_by_the_formula(dark: DarkCapture) -> None:
    shown = np.clip(dark.test.lit + 0.05, 0, 1)
    expected = np.mean([-10 * np.log10(np.mean((a - b) ** 2.0)) for a, b in zip(shown, dark.test.lit, strict=True)])
    found = assert_scores(dark.test, shown, psnr=float(expected) - 1e-3, flip=0.5)
    assert found["psnr"] == pytest.approx(expected, abs=1e-3)
    with pytest.raises(AssertionError, match=r"psnr against lit is .* must be at least .*; worst view 000[08]: "):
        assert_scores(dark.test, shown, psnr=float(expected) + 1e-2)
    with pytest.raises(AssertionError, match="flip against lit is .* must be at most 1e-05"):
        assert_scores(dark.test, shown, flip=1e-5)


def test_pictures_may_be_codes_floats_tensors_or_files(dark: DarkCapture, tmp_path: Path) -> None:
    eight = np.round(dark.test.clean * 255).astype(np.uint8)
    for name, picture in zip(dark.test.names, eight, strict=True):
        write_png(tmp_path / f"{name}.png", picture)
    forms = [eight, eight.astype(np.uint16) * 257, eight / 255, torch.from_numpy(eight / 255), tmp_path, str(tmp_path)]
    found = {assert_scores(dark.test, form, "clean", psnr=50)["psnr"] for form in forms}  # type: ignore[arg-type]
    assert max(found) - min(found) < 1e-4
    with pytest.raises(AssertionError, match="psnr against lit"):
        assert_scores(dark.test, eight, "lit", psnr=50)


def test_linear_light_is_compared_after_one_gain_for_all_views(dark: DarkCapture) -> None:
    assert_scores(dark.test, 7.0 * dark.test.clean_linear, "linear", linear_psnr=80)
    wavering = dark.test.clean_linear * np.array([1.0, 2.0])[:, None, None, None]
    with pytest.raises(AssertionError, match="linear_psnr"):
        assert_scores(dark.test, wavering, "linear", linear_psnr=40)


def test_files_of_8_bits_are_srgb_in_linear_light_too(dark: DarkCapture, tmp_path: Path) -> None:
    """Rationale: their codes were compared as light, where `novags score --renders` decodes them."""
    light = np.clip(dark.test.clean_linear / np.quantile(dark.test.clean_linear, 0.97), 0, 1)
    for name, picture in zip(dark.test.names, light, strict=True):
        write_png(tmp_path / f"{name}.png", to_srgb8(picture))
    assert_scores(dark.test, tmp_path, "linear", linear_psnr=40)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda light: np.ones_like(light),
        lambda light: light[:, :, ::-1],
        lambda light: light[..., ::-1],
        lambda light: np.random.default_rng(0).random(light.shape),
    ],
    ids=["constant", "mirrored", "blue first", "random"],
)
def test_in_the_dark_linear_light_of_another_picture_is_no_good_score(dark_capture: Make, wrong: Callable) -> None:
    """As codes of the sensor, whose white is hundreds of times as bright, all of it is nearly black."""
    darkest = dark_capture("cornell", 5).test
    with pytest.raises(AssertionError, match="linear_psnr"):
        assert_scores(darkest, wrong(darkest.clean_linear), "linear", linear_psnr=28)
    shown = darkest.clean_linear / np.quantile(darkest.clean_linear, 0.97)
    noisy = np.clip(shown, 0, 1) + 0.01 * np.random.default_rng(1).standard_normal(shown.shape)
    assert assert_scores(darkest, noisy, "linear", linear_psnr=38)["linear_psnr"] == pytest.approx(40, abs=0.5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda p: p[:1], r"pictures must be \[2, 48, 48, 3\], got \[1, 48, 48, 3\]"),
        (lambda p: np.where(p > 0.5, np.nan, p), "pictures must be finite"),
        (lambda p: (255 * p).astype(np.int64), "pictures must be floats in 0..1, uint8 or uint16, got int64"),
    ],
)
def test_wrong_pictures_fail_the_test_with_the_reason(dark: DarkCapture, change: Callable, said: str) -> None:
    with pytest.raises(AssertionError, match=said):
        assert_scores(dark.test, change(dark.test.lit))


def test_forms_of_numbers_that_frameworks_have_are_taken_and_others_are_wrong_results(dark: DarkCapture) -> None:
    lit, depth = torch.from_numpy(dark.test.lit), dark.test.depth
    forms = [[view.clone().requires_grad_() for view in lit], lit.bfloat16(), [lit[0].numpy(), lit[1]], lit.tolist()]
    assert all((assert_scores(dark.test, form)["psnr"] or 0) > 45 for form in forms)
    poses, own = dark.train.viewmats, dark.train.viewmats.copy()
    own[:, 3, 3] = 2
    wrong: list[Callable[[], object]] = [
        lambda: assert_scores(dark.test, dark.test.lit + 1j),
        lambda: assert_scores(dark.test, [dark.test.lit[0], dark.test.lit[1, 1:]]),
        lambda: assert_scores(dark.test, 0 * dark.test.lit, "linear"),
        lambda: assert_depth(dark.test, -depth),
        lambda: assert_depth(dark.test, depth, 255 * np.ones_like(depth)),
        lambda: assert_depth(dark.test, depth, np.full_like(depth, np.nan)),
        lambda: assert_poses(dark.train, own, rotation_deg=1, centre_error=1),
        lambda: assert_poses(dark.train, np.swapaxes(poses, 1, 2), rotation_deg=1, centre_error=1),
        lambda: assert_poses(dark.train, np.tile(np.eye(4), (len(poses), 1, 1)), rotation_deg=1, centre_error=1),
        lambda: assert_poses(dark.train, np.full_like(poses, np.nan), rotation_deg=1, centre_error=1, registered=0),
    ]
    for each in wrong:
        with pytest.raises(AssertionError, match=r"must|least|depth|pictures|viewmats"):
            each()


def test_a_view_without_any_depth_is_named_where_depth_is_wanted(dark: DarkCapture) -> None:
    depth = dark.test.depth.copy()
    depth[1] = np.nan
    for bounds in ({"abs_rel": 0.01}, {"coverage": 0.1, "abs_rel": 0.01}, {"abs_rel": 0.01, "coverage": 0.1}):
        with pytest.raises(AssertionError, match="view 0008 has no depth where the scene has surfaces"):
            assert_depth(dark.test, depth, **bounds)


def test_a_bound_on_what_there_is_not_is_a_mistake_of_the_test(dark: DarkCapture) -> None:
    with pytest.raises(ValueError, match="unknown score 'psnrr' against lit: choose one of aligned_psnr"):
        assert_scores(dark.test, dark.test.lit, psnrr=3)
    with pytest.raises(ValueError, match="the bound of psnr must be a number, got '20'"):
        assert_scores(dark.test, dark.test.lit, psnr="20")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="against must be lit, clean or linear, got 'light'"):
        assert_scores(dark.test, dark.test.lit, "light")  # type: ignore[arg-type]


def test_depth_is_held_to_the_true_depth(dark: DarkCapture) -> None:
    truth = dark.test.depth
    assert assert_depth(dark.test, truth, abs_rel=0, within_5_percent=1, coverage=1)["floaters"] == pytest.approx(0)
    assert assert_depth(dark.test, 1.1 * truth)["abs_rel"] == pytest.approx(0.1, rel=1e-5)
    with pytest.raises(AssertionError, match="abs_rel of the depth is 0.1, must be at most 0.09"):
        assert_depth(dark.test, 1.1 * truth, abs_rel=0.09)
    half = truth.copy()
    half[:, :, ::2] = 0
    with pytest.raises(AssertionError, match="coverage of the depth"):
        assert_depth(dark.test, half, coverage=0.9)
    with pytest.raises(AssertionError, match="coverage of the depth"):
        assert_depth(dark.test, truth, np.full_like(truth, 0.1), coverage=0.9)


def turned(viewmats: np.ndarray, degrees: float) -> np.ndarray:
    """Cameras turned about their own vertical axis."""
    a = np.radians(degrees)
    turn = np.eye(4)
    turn[:3, :3] = [[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]
    return np.asarray(turn @ viewmats)


def test_poses_are_compared_in_whatever_world_they_are(dark: DarkCapture) -> None:
    world = np.eye(4)
    world[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    other = dark.train.viewmats @ world
    other[:, :3, 3] = 3.0 * other[:, :3, 3] + other[:, :3, :3] @ [1.0, -2.0, 0.5]
    assert_poses(dark.train, other, rotation_deg=1e-5, centre_error=1e-6)
    some = other.copy()
    some[0] = turned(some[0], 7.0)
    found = assert_poses(dark.train, some, rotation_deg=1.01, centre_error=0.01)
    assert found["rotation_deg"] == pytest.approx(7.0 / len(dark.train), rel=1e-3)
    with pytest.raises(AssertionError, match=r"rotation_deg of the cameras is 1, .* worst view 0001: 7"):
        assert_poses(dark.train, some, rotation_deg=0.99, centre_error=0.01)
    some[2] = np.nan
    assert assert_poses(dark.train, some, rotation_deg=2, centre_error=0.01, registered=0.8)["registered"] == 6 / 7
    with pytest.raises(AssertionError, match="86% of the views have a camera, at least 100% must; none: 0003"):
        assert_poses(dark.train, some, rotation_deg=2, centre_error=0.01)


@pytest.mark.parametrize("sensor", ["a7s2-iso6400-3chip", BAYER])
def test_exposures_of_the_camera_have_its_noise(dark_capture: Make, sensor: str) -> None:
    first, again = (dark_capture("cornell", 20, sensor=sensor, seed=seed) for seed in (0, 1))
    assert not np.array_equal(first.train.raw, again.train.raw)
    assert_noise(first.train, first.train.raw)
    assert_noise(first.test, first.test.raw)


FAULTS: dict[str, Callable[[DarkCapture, np.random.Generator], np.ndarray]] = {
    "a little too much noise": lambda d, g: 1.05 * (d.train.raw - d.train.mean_dn) + d.train.mean_dn,
    "no noise": lambda d, g: d.train.mean_dn,
    "black level off by a tenth of the noise": lambda d, g: d.train.raw + 0.1 * np.sqrt(d.train.variance_dn.min()),
    "the same noise everywhere": lambda d, g: (
        d.train.mean_dn + np.sqrt(d.train.variance_dn.mean()) * g.standard_normal(d.train.raw.shape)
    ),
    "the pattern of another view": lambda d, g: d.train.raw[::-1],
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_camera_model_with_a_fault_is_found_out(dark: DarkCapture, fault: str) -> None:
    frames = FAULTS[fault](dark, np.random.default_rng(0))
    with pytest.raises(AssertionError, match=r"of \(frame - mean\) / sd is"):
        assert_noise(dark.train, frames)


def test_pixels_without_noise_must_be_what_they_are() -> None:
    mean, variance = np.full((2, 8, 8), 100.0), np.full((2, 8, 8), 4.0)
    mean[:, 0], variance[:, 0] = 4095.0, 0.0
    raw = np.rint(mean + np.sqrt(variance) * np.random.default_rng(0).standard_normal(mean.shape))
    views: Any = SimpleNamespace(raw=raw, mean_dn=mean, variance_dn=variance)
    assert_noise(views, raw)
    raw = raw.copy()
    raw[1, 0, 3] = 4092
    with pytest.raises(AssertionError, match="pixels without noise .* are up to 3 DN off their mean"):
        assert_noise(views, raw)


def test_rows_of_a_camera_that_have_noise_in_common_are_not_taken_for_independent_pixels(
    dark_capture: Make, tmp_path: Path
) -> None:
    (tmp_path / "rows.toml").write_text("gain = 2.0\neta = 0.6\nmu_e_sat = 5000\nblack_level = 64\nbits = 12\n"
                                        "sigma_d = 1.0\nsigma_row = 6.0\n")  # fmt: skip
    settings = {"sensor": str(tmp_path / "rows.toml"), "capture.tolerance": "none"}
    for seed in range(2):
        dark = dark_capture("cornell", 20, seed=seed, **settings)
        assert_noise(dark.train, dark.train.raw)
    z = (dark.train.raw - dark.train.mean_dn) / np.sqrt(dark.train.variance_dn)
    assert z.mean((2, 3) if z.ndim == 4 else 2).std() > 0.5  # of independent pixels: 0.14


def test_an_own_exposure_of_the_same_light_passes(dark_capture: Make) -> None:
    """The sensor model by itself, as a stranger would hold his own to it: photons from the noise-free numbers."""
    from novags.testbed.folders.capture import open_capture

    known = dark_capture("cornell", 20, sensor="ideal", **{"capture.tolerance": "none"})
    sensor = open_capture(known.folder).sensor
    assert sensor is not None
    electrons = (known.train.mean_dn - sensor.black_level) / sensor.gain
    frames = [
        expose(np.maximum(mean, 0) / sensor.eta, sensor, Exposure(time=1 / 30), seed=5, view=i).dn
        for i, mean in enumerate(electrons)
    ]
    assert_noise(known.train, np.stack(frames))
