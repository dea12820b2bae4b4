"""Where the reference shows nothing, a blank picture equals it: what follows from that is said, and not scored."""

from pathlib import Path

import numpy as np
import pytest

from novags import cli
from novags.testbed.console.terminal import Console
from novags.testbed.ledger.contents import read_json
from novags.testbed.metrics.images import aligned_psnr, image_scores, psnr, ssim
from novags.testbed.metrics.linear import is_black
from novags.testbed.metrics.tone import CONTRAST, affine_aligned, tone_aligned, with_contrast
from novags.testbed.report.page import write_report
from novags.testbed.stages.scores.comparing import recovered_fractions
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.study.place import run

ALIGNED = ("aligned_psnr", "tone_aligned_psnr", "aligned_ssim", "tone_aligned_ssim")


def noise(seed: int = 0, size: int = 24) -> np.ndarray:
    return np.random.default_rng(seed).random((size, size, 3)).astype(np.float32)


def test_pure_noise_has_no_aligned_score_against_a_blank_reference() -> None:
    scores = image_scores(noise(), np.full((24, 24, 3), 0.5, np.float32))
    assert {name for name, score in scores.items() if score is None} == {*ALIGNED, "lpips", "st_lpips"}
    assert scores["psnr"] == pytest.approx(10 * np.log10(12), abs=0.1)  # the variance of uniform noise is 1/12
    assert psnr(affine_aligned(noise(), np.full((24, 24, 3), 0.5)), np.full((24, 24, 3), 0.5)) == 100


def test_a_channel_without_contrast_does_not_raise_the_scores_of_the_others() -> None:
    reference = noise(1)
    reference[..., 2] = 0.3
    image = reference + 0.2 * noise(2)
    toned, two = tone_aligned(image, reference), slice(0, 2)
    scores = image_scores(image, reference)
    residual = np.square(toned[..., two] - reference[..., two]).mean()
    assert scores["tone_aligned_psnr"] == pytest.approx(-10 * np.log10(residual), abs=1e-4)
    assert scores["aligned_psnr"] == aligned_psnr(image, reference)
    assert scores["aligned_psnr"] < psnr(affine_aligned(image, reference), reference) - 1.7  # 10 lg 1.5
    third = np.concatenate([reference[..., two], reference[..., :1]], -1)
    aligned = affine_aligned(np.concatenate([image[..., two], image[..., :1]], -1), third)
    parts = [ssim(np.repeat(aligned[..., c : c + 1], 3, -1), np.repeat(third[..., c : c + 1], 3, -1)) for c in (0, 1)]
    assert scores["aligned_ssim"] == pytest.approx(np.mean(parts), abs=1e-6)


def test_one_step_of_eight_bits_is_contrast_and_less_is_none() -> None:
    reference = np.zeros((12, 12, 3), np.float32)
    reference[3, 4] = (CONTRAST, 0.99 * CONTRAST, 0.0)
    assert with_contrast(reference).tolist() == [True, False, False]


def test_black_is_what_psnr_cannot_tell_from_black() -> None:
    assert is_black(np.full((4, 4, 3), 0.99e-5))
    assert not is_black(np.full((4, 4, 3), 1.01e-5))
    assert is_black(np.full((4, 4, 3), 0.99e-3), white=100.0)


def test_without_scores_at_its_ends_the_recovered_fraction_says_that_and_not_to_score_again() -> None:
    scores = {name: {"mean": {"enhanced": {"aligned_psnr": None}}} for name in ("nova", "naive", "oracle")}
    recovered, why = recovered_fractions(scores, {name: name for name in scores})
    assert recovered == {}
    assert "no aligned_psnr against enhanced" in (why or "")


@pytest.fixture(scope="module")
def darkness(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An experiment in which no camera sees anything."""
    preset = adapted(
        EXPERIMENTS["demo"], scene="cornell", n_views=9, width=24, height=24, spp=4, points=50, iterations=2,
        electrons=1e-6, methods=("naive",),
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("darkness")
    run(preset, folder, Console(quiet=True), report=write_report)
    return folder


def test_a_signal_of_a_millionth_electron_is_not_scored_and_said(
    darkness: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    metrics = read_json(darkness / "naive" / "metrics.json")
    naive = metrics["methods"]["naive"]
    assert [naive["mean"]["enhanced"][name] for name in ALIGNED] == [None] * 4
    assert naive["mean"]["lit"]["tone_aligned_psnr"] < 40
    assert "in 2 of 2 views" in metrics["unavailable"]["aligned scores against enhanced"]
    assert naive["training_2d"]["enhanced"]["aligned_psnr"] is None
    assert "best_blur" not in naive["training_2d"]
    cli.score((darkness,))
    assert "noise-free exposure not scored, because the reference shows nothing" in capsys.readouterr().out


def test_the_report_of_a_dark_experiment_says_what_has_no_score(darkness: Path) -> None:
    page = (darkness / "report.html").read_text(encoding="utf-8")
    assert "aligned scores against enhanced" in page
    assert "the reference is one colour to within 1/255 in every channel in 2 of 2 views" in page
    assert "<strong>naive</strong> tone-aligned PSNR" in page  # beneath the render: the score that it has
    assert "tone-aligned PSNR against the well-lit truth" in page
