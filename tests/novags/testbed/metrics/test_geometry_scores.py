"""Claims about depth scores: answers of hand-made depth maps, and the bound on opacity in front of the surface."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from novags.testbed.metrics.geometry import geometry_scores, opacity_in_front
from novags.testbed.metrics.images import mean_scores

ONE = np.ones((1, 1))


def flat(value: float, shape: tuple[int, int] = (4, 5)) -> np.ndarray:
    return np.full(shape, value)


def test_hand_made_depths_score_what_was_worked_out() -> None:
    truth = np.array([[2.0, 2.0, 2.0, 2.0, 2.0, np.inf, 0.0, 2.0]])
    depth = np.array([[2.0, 2.08, 1.92, 2.4, 1.0, 1.0, 1.0, np.inf]])
    alpha = np.array([[1.0, 0.9, 0.8, 1.0, 0.4, 1.0, 1.0, 1.0]])
    scores = geometry_scores(depth, alpha, truth)
    assert scores["coverage"] == pytest.approx(4 / 6)  # the fifth is too transparent, the last has no depth
    assert scores["abs_rel"] == pytest.approx((0.0 + 0.04 + 0.04 + 0.2) / 4)
    assert scores["within_5_percent"] == pytest.approx(3 / 6)
    assert scores["floaters"] == pytest.approx(0.4 * (1 - 1.0 / 1.9) / 6)


def test_the_truth_itself_is_perfect() -> None:
    truth = np.random.default_rng(0).uniform(1, 9, (7, 8))
    expected = {"abs_rel": 0.0, "within_5_percent": 1.0, "coverage": 1.0, "floaters": 0.0}
    assert geometry_scores(truth, np.ones_like(truth), truth) == expected


def test_depth_errors_are_relative_to_the_truth_not_to_the_estimate() -> None:
    assert geometry_scores(flat(3.0), flat(1.0), flat(2.0))["abs_rel"] == pytest.approx(0.5)
    assert geometry_scores(flat(1.0), flat(1.0), flat(2.0))["abs_rel"] == pytest.approx(0.5)


def test_scores_do_not_depend_on_the_unit_of_length() -> None:
    rng = np.random.default_rng(1)
    depth, alpha, truth = rng.uniform(1, 3, (6, 6)), rng.uniform(0, 1, (6, 6)), rng.uniform(1, 3, (6, 6))
    assert geometry_scores(1000 * depth, alpha, 1000 * truth) == pytest.approx(geometry_scores(depth, alpha, truth))


rays = st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.01, 4.0)), min_size=1, max_size=6)


@settings(derandomize=True, deadline=None, max_examples=200)
@given(rays, st.floats(0.5, 3.0))
def test_floaters_never_exceed_the_opacity_that_is_in_front(ray: list[tuple[float, float]], truth: float) -> None:
    opacities, depths = np.array(sorted(ray, key=lambda splat: splat[1])).T
    weights = opacities * np.cumprod(np.concatenate([[1.0], 1 - opacities[:-1]]))
    alpha = weights.sum()
    if alpha == 0:
        return
    expected_depth = (weights * depths).sum() / alpha
    bound = opacity_in_front(expected_depth * ONE, np.minimum(alpha, 1.0) * ONE, truth * ONE)[0, 0]
    assert 0 <= bound <= weights[depths < 0.95 * truth].sum() + 1e-9


def test_opacity_at_the_camera_counts_in_full() -> None:
    front, rest, t = 0.3, 0.6, 0.95 * 4.0
    depth = (front * 1e-9 + rest * t) / (front + rest)
    assert opacity_in_front(depth * ONE, (front + rest) * ONE, 4.0 * ONE)[0, 0] == pytest.approx(front, abs=1e-6)


def test_a_sheet_half_way_counts_half_its_opacity() -> None:
    assert opacity_in_front(0.475 * 4.0 * ONE, 0.8 * ONE, 4.0 * ONE)[0, 0] == pytest.approx(0.4)


def test_what_lies_behind_the_surface_is_not_a_floater() -> None:
    assert not opacity_in_front(flat(3.0), flat(1.0), flat(2.0)).any()
    assert not opacity_in_front(flat(1.91), flat(1.0), flat(2.0)).any()  # nor what is within the tolerance


def test_a_pixel_without_rendered_depth_is_not_a_floater() -> None:
    for nothing in (0.0, np.nan, np.inf):
        assert opacity_in_front(nothing * ONE, 0.3 * ONE, 2.0 * ONE)[0, 0] == 0.0


def test_silhouettes_one_pixel_wide_do_not_float() -> None:
    truth = flat(4.0, (5, 6))
    truth[:, 3:] = 2.0
    depth = truth.copy()
    depth[:, 2] = 2.5  # the pixel beside the silhouette mixes both surfaces
    assert not opacity_in_front(depth, np.ones_like(truth), truth).any()
    depth[:, 1] = 2.5  # one farther has no surface within reach to mix with
    assert np.nonzero(opacity_in_front(depth, np.ones_like(truth), truth).any(0))[0].tolist() == [1]


def test_pixels_without_a_true_surface_are_not_judged() -> None:
    truth = flat(2.0)
    truth[0] = np.nan
    truth[1] = 0.0
    depth = flat(0.1)
    depth[2:] = 2.0
    expected = {"abs_rel": 0.0, "within_5_percent": 1.0, "coverage": 1.0, "floaters": 0.0}
    assert geometry_scores(depth, flat(1.0), truth) == expected


def test_a_view_with_nothing_to_judge_leaves_the_mean_to_the_others() -> None:
    empty = geometry_scores(flat(1.0), flat(1.0), flat(np.inf))
    assert empty == {"abs_rel": None, "within_5_percent": None, "coverage": None, "floaters": None}
    unseen = geometry_scores(flat(0.0), flat(0.0), flat(1.0))
    assert unseen == {"abs_rel": None, "within_5_percent": 0.0, "coverage": 0.0, "floaters": 0.0}
    half = geometry_scores(flat(1.5), flat(1.0), flat(1.0))
    assert mean_scores([empty, unseen, half])["abs_rel"] == pytest.approx(0.5)
    assert mean_scores([empty, unseen, half])["coverage"] == pytest.approx(0.5)


def test_depths_and_opacities_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\[h, w\] of one size"):
        geometry_scores(flat(1.0), flat(1.0), flat(1.0, (5, 4)))
    with pytest.raises(ValueError, match=r"true depth must be >= 0 .* got -1"):
        geometry_scores(flat(1.0), flat(1.0), flat(-1.0))
    with pytest.raises(ValueError, match=r"^depth must be >= 0 .* got -2"):
        geometry_scores(flat(-2.0), flat(1.0), flat(1.0))
    with pytest.raises(ValueError, match=r"alpha must lie in 0..1, got values from 1.5"):
        geometry_scores(flat(1.0), flat(1.5), flat(1.0))
