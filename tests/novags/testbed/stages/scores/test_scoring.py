"""Claims about merging scores."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.methods.problem import encode
from novags.testbed.folders.exposures import Exposures
from novags.testbed.metrics.images import psnr
from novags.testbed.stages.scores import scoring
from novags.testbed.stages.scores.scoring import gaussian_blur
from simscenes.sets.pictures.png import write_png


def test_light_without_an_enhancement_is_as_consistent_as_the_truth_that_it_is_at_another_exposure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    light = dict(enumerate(np.random.default_rng(0).uniform(0.01, 0.1, (2, 4, 4, 3))))
    still = SimpleNamespace(displacement=np.zeros((4, 4, 2)), visible=np.ones((4, 4), bool))
    monkeypatch.setattr(scoring, "flow", lambda *given: still)
    monkeypatch.setattr(scoring, "references", lambda run, capture, lit, i: {"linear": light[i]})
    run: Any = SimpleNamespace(space="linear", enhancement=None, shows_training_views=True,
                               rendering=lambda name: light[int(name)] / 7)  # fmt: skip
    capture: Any = SimpleNamespace(names=("0", "1"), cameras=SimpleNamespace(test_indices=(0,)))
    source: Any = SimpleNamespace(views=None, scanned={})
    found = scoring.view_consistency(run, capture, source, Exposures(dark=7.0, lit=None))
    assert found["excess"] == pytest.approx(0, abs=1e-6)
    assert found["reference"] == pytest.approx(np.abs(encode(light[1]) - encode(light[0])).mean(), rel=1e-5)


def test_depth_is_scored_in_the_scale_of_the_true_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    depth, alpha = np.full((4, 4), 1.5), np.ones((4, 4))
    stand_ins: dict[str, Any] = {
        "references": {"lit": None}, "image_scores": {"psnr": 30.0}, "as_compared": None, "true_depth": 3.0 * alpha,
        "missing_references": {}, "view_consistency": {}, "reference_halves": {}, "surface_of": {},
    }  # fmt: skip
    for name, value in stand_ins.items():
        monkeypatch.setattr(scoring, name, lambda *given, value=value: value)
    run: Any = SimpleNamespace(
        space="lit", has_depth=True, depth_scale=2.0, rendering=lambda name: None, depth=lambda name: (depth, alpha)
    )
    capture: Any = SimpleNamespace(names=("0000",), cameras=SimpleNamespace(test_indices=(0,)))
    nothing: Any = None
    found = scoring.score_test_views(run, capture, nothing, None, lambda *given: None)["geometry"]
    assert (found["abs_rel"], found["within_5_percent"]) == (0.0, 1.0)


@pytest.mark.parametrize(("trained", "views"), [(True, [0, 1, 2]), (False, [1])])
def test_the_surface_is_scored_by_all_rendered_views_in_the_scale_of_the_true_cameras(
    trained: bool, views: list[int], tmp_path: Path
) -> None:
    """Three cameras look along z at planes 2, 4 and 6 m away, of which the method has half the depth."""
    from simscenes.sets.writers.neighbours import write_points

    Ks, viewmats = np.tile(np.diag([4.0, 4.0, 1.0]), (3, 1, 1)), np.tile(np.eye(4), (3, 1, 1))
    at = {i: np.full((4, 4), i + 1.0) for i in range(3)}
    scan = np.concatenate([scoring.seen_points(2 * at[i], np.ones((4, 4)), Ks[i], viewmats[i]) for i in views])
    write_points(tmp_path / "scan.ply", scan, np.zeros((len(scan), 3), np.uint8))
    cameras = SimpleNamespace(rig=SimpleNamespace(Ks=Ks, viewmats=viewmats), test_indices=[1])
    run: Any = SimpleNamespace(shows_training_views=trained, depth_scale=2.0,
                               depth=lambda name: (at[int(name)], np.ones((4, 4))))  # fmt: skip
    capture: Any = SimpleNamespace(names=("0", "1", "2"), cameras=cameras)
    source: Any = SimpleNamespace(scan=tmp_path / "scan.ply")
    assert scoring.surface_of(run, capture, source) == {"accuracy": 0, "completeness": 0, "f1": 1}
    assert scoring.surface_of(run, capture, SimpleNamespace(scan=None)) == {}  # type: ignore[arg-type]


@pytest.mark.parametrize("shown", [(0, 2, 5), (0, 5), (2, 5)])
def test_every_held_out_view_counts_in_the_consistency_with_the_view_after_it(
    shown: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[tuple[int, int]]()
    monkeypatch.setattr(scoring, "flow", lambda views, i, j: asked.append((i, j)) or SimpleNamespace(
        displacement=np.zeros((4, 4, 2)), visible=np.ones((4, 4), bool)))  # fmt: skip
    reference = {k: np.full((4, 4, 3), 0.1 * k) for k in range(6)}
    monkeypatch.setattr(scoring, "references", lambda run, capture, lit, i: {"lit": reference[i]})
    monkeypatch.setattr(scoring, "as_compared", lambda rendered, *_: rendered)
    run: Any = SimpleNamespace(space="lit", enhancement=None, shows_training_views=True,
                               rendering=lambda name: reference[int(name)])  # fmt: skip
    capture: Any = SimpleNamespace(names=tuple("012345"), cameras=SimpleNamespace(test_indices=shown))
    scoring.view_consistency(run, capture, SimpleNamespace(views=None, scanned={}), None)  # type: ignore[arg-type]
    assert asked == [(i, i + 1 if i < 5 else 4) for i in shown]


@pytest.mark.parametrize("gain", [0.25, 4.0, None])
def test_light_is_compared_in_code_at_the_exposure_of_the_dark_pictures(
    gain: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    light = np.random.default_rng(0).uniform(0.01, 0.1, (4, 4, 3))
    monkeypatch.setattr(scoring, "references", lambda *_: {"linear": light})
    run: Any = SimpleNamespace(rendering=lambda name: 2 * light)
    capture: Any = SimpleNamespace(names=("0",))
    exposures = None if gain is None else Exposures(dark=gain, lit=None)
    shown, reference = scoring._in_code(run, capture, SimpleNamespace(), 0, exposures)  # type: ignore[arg-type]
    np.testing.assert_allclose(shown, encode((gain or 1.0) * 2 * light), atol=1e-6)
    np.testing.assert_allclose(reference, encode(light), atol=1e-6)


def test_every_reference_and_every_view_counts_in_the_mean_scores(monkeypatch: pytest.MonkeyPatch) -> None:
    """The light of view k is k / 10; a reference lies a tenth or a fifth beside it."""
    light = {k: np.full((4, 4, 3), 0.1 * k) for k in range(6)}
    known = {"enhanced": 0.1, "linear": 0.05, "lit": 0.2}
    monkeypatch.setattr(scoring, "references", lambda run, capture, lit, i: {
        kind: light[i] + off for kind, off in known.items()})  # fmt: skip
    monkeypatch.setattr(scoring, "as_compared", lambda rendered, *_: rendered)
    monkeypatch.setattr(scoring, "missing_references", lambda *_: {"gone": "why"})
    monkeypatch.setattr(scoring, "exposures_of", lambda *_: Exposures(dark=1.0, lit=None))
    monkeypatch.setattr(scoring, "image_scores", lambda a, b, *_: {"psnr": float((100 * a - b + b * 0).mean())})
    monkeypatch.setattr(scoring, "reference_halves", lambda *_: {})
    run: Any = SimpleNamespace(space="linear", has_depth=False, rendering=lambda name: light[int(name)])
    capture: Any = SimpleNamespace(names=tuple("012345"), cameras=SimpleNamespace(test_indices=(1, 4)))
    nothing: Any = None
    found = scoring.score_test_views(run, capture, nothing, ("psnr",), lambda *_: None)
    assert list(found["views"]) == ["1", "4"]
    assert found["mean"]["gone"] is None
    assert found["mean"]["enhanced"]["psnr"] == pytest.approx((10 - 0.2 + 40 - 0.5) / 2, abs=0.3)
    assert found["mean"]["lit"]["psnr"] != found["mean"]["enhanced"]["psnr"]
    assert found["mean"]["linear"]["linear_psnr"] == pytest.approx(-20 * np.log10(0.05), abs=1e-3)


def test_every_training_picture_counts_beside_its_own_truth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """View 1 is off by 0.1, view 3 by 0.2; view 2 has no camera."""
    truth = {k: np.random.default_rng(k).uniform(0.3, 0.6, (40, 40, 3)).astype(np.float32) for k in range(4)}
    for k, off in ((1, 0.1), (3, 0.2)):
        write_png(tmp_path / "enhanced" / f"{k}.png", truth[k] + off)
        write_png(tmp_path / "denoised" / f"{k}.png", truth[k] + off / 10)
    monkeypatch.setattr(scoring, "references", lambda run, capture, lit, i: {"enhanced": truth[i]})
    run: Any = SimpleNamespace(enhancement={}, path=tmp_path)
    capture: Any = SimpleNamespace(names=tuple("0123"), cameras=SimpleNamespace(train_indices=(1, 2, 3)),
                                   holds=lambda part: True)  # fmt: skip
    nothing: Any = None
    found = scoring.score_training_images(run, capture, nothing)
    assert found is not None
    assert found["enhanced"]["psnr"] == pytest.approx(-20 * (np.log10(0.1) + np.log10(0.2)) / 2, abs=0.05)
    assert found["denoised"]["psnr"] == pytest.approx(found["enhanced"]["psnr"] + 20, abs=0.5)
    each = [gaussian_blur(truth[k] + off, scoring.BLUR_SIGMA) for k, off in ((1, 0.1), (3, 0.2))]
    mean = np.mean([psnr(image, truth[k]) for image, k in zip(each, (1, 3), strict=True)])
    assert found["blur"]["psnr"] == pytest.approx(mean, abs=0.05)


def test_along_a_fit_every_held_out_view_counts_against_every_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        scoring,
        "view_scores",
        lambda run, capture, lit, i, *_: {kind: {"psnr": 10.0 * i + k} for k, kind in enumerate(("lit", "enhanced"))},
    )
    run: Any = SimpleNamespace(space="lit", at=20)
    capture: Any = SimpleNamespace(names=("0", "1", "2", "3"), cameras=SimpleNamespace(test_indices=(1, 3)))
    found = scoring.score_along(run, capture, capture)
    assert found["iterations"] == 20
    assert found["views"]["3"] == {"lit": {"psnr": 30.0}, "enhanced": {"psnr": 31.0}}
    assert list(found["views"]) == ["1", "3"]
    assert found["mean"] == {"lit": {"psnr": 20.0}, "enhanced": {"psnr": 21.0}}
