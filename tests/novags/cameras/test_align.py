import math

import numpy as np
import pycolmap
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from novags.cameras.align import (
    Similarity,
    align,
    auc,
    depth_scale,
    left_apart,
    pair_errors,
    to_estimated,
    to_true,
    trajectory_error,
)
from novags.cameras.estimate import CameraEstimate, extent_of
from simscenes.rigs import Rig, orbit_rig

seeds = st.integers(0, 10_000)


def some(rng: np.random.Generator) -> Similarity:
    """A similarity, of a scale between a twentieth and twenty."""
    turn = torch.from_numpy(Rotation.random(random_state=rng).as_matrix())
    return Similarity(float(np.exp(rng.uniform(-3, 3))), turn, torch.from_numpy(rng.normal(0, 4, 3)))


def orbit(count: int) -> torch.Tensor:
    return torch.tensor(orbit_rig(count, 40, 40, 50.0, radius=3.0, sweep_deg=140.0).viewmats)


def scattered(count: int, rng: np.random.Generator) -> torch.Tensor:
    viewmats = torch.eye(4, dtype=torch.float64).repeat(count, 1, 1)
    viewmats[:, :3, :3] = torch.from_numpy(Rotation.random(count, random_state=rng).as_matrix())
    viewmats[:, :3, 3] = torch.from_numpy(rng.normal(0, 2, (count, 3)))
    return viewmats


def noisy(viewmats: torch.Tensor, degrees: float, distance: float, rng: np.random.Generator) -> torch.Tensor:
    result = viewmats.clone()
    turns = Rotation.from_rotvec(np.radians(degrees) / np.sqrt(3) * rng.standard_normal((len(result), 3))).as_matrix()
    result[:, :3, :3] = torch.from_numpy(turns) @ viewmats[:, :3, :3]
    moved = centres(viewmats) + distance / np.sqrt(3) * rng.standard_normal((len(result), 3))
    result[:, :3, 3] = -(result[:, :3, :3] @ torch.from_numpy(moved)[..., None])[..., 0]
    return result


def centres(viewmats: torch.Tensor) -> np.ndarray:
    return np.array([np.linalg.inv(v)[:3, 3] for v in viewmats.numpy()])


def umeyama(source: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Closed form of Umeyama (1991), equations 38 to 42."""
    mean_s, mean_t = source.mean(0), target.mean(0)
    covariance = (target - mean_t).T @ (source - mean_s) / len(source)
    U, D, Vt = np.linalg.svd(covariance)
    S = np.diag([1, 1, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    rotation = U @ S @ Vt
    scale = np.trace(np.diag(D) @ S) / ((source - mean_s) ** 2).sum(1).mean()
    return scale, rotation, mean_t - scale * rotation @ mean_s


def differ(a: Similarity, b: Similarity) -> float:
    """Largest difference, of the scale relative, of the translation relative to its length and 1."""
    shift = float((a.translation - b.translation).norm()) / (1 + float(b.translation.norm()))
    return max(abs(a.scale / b.scale - 1), float((a.rotation - b.rotation).abs().max()), shift)


@settings(deadline=None, derandomize=True, max_examples=25)
@given(seed=seeds, count=st.integers(2, 12))
def test_a_similarity_applied_to_cameras_is_recovered(seed, count):
    rng = np.random.default_rng(seed)
    true, similarity = scattered(count, rng), some(rng)
    found = align(to_estimated(similarity, true), true)
    assert differ(found.similarity, similarity) < 1e-9
    assert found.rotation_deg.max() < 1e-9
    assert found.centre_error.max() < 1e-9
    assert found.inliers.all()


@settings(deadline=None, derandomize=True, max_examples=25)
@given(seed=seeds)
def test_thirty_percent_of_grossly_wrong_cameras_are_found_and_change_nothing(seed):
    rng = np.random.default_rng(seed)
    true, similarity = orbit(20), some(rng)
    wrong = torch.from_numpy(rng.choice(20, 6, replace=False))
    estimated = true.clone()
    estimated[wrong] = scattered(6, rng)
    found = align(to_estimated(similarity, estimated), true)
    assert differ(found.similarity, similarity) < 1e-9
    assert set(torch.where(~found.inliers)[0].tolist()) == set(wrong.tolist())
    assert found.rotation_deg[found.inliers].max() < 1e-9


def test_noise_and_outliers_together_leave_the_error_of_the_noise():
    rng = np.random.default_rng(0)
    true, similarity = orbit(40), some(rng)
    extent = extent_of(true.numpy())
    estimated = noisy(true, 0.5, 0.01 * extent, rng)
    estimated[:12] = scattered(12, rng)
    found = align(to_estimated(similarity, estimated), true)
    assert not found.inliers[:12].any()
    # All of the 28 good ones are inliers but for the odd one beyond 3 sigma, and the fit is as good as one without the
    # outliers: 28 cameras give the frame to 1 / sqrt(28) of one camera's error.
    assert found.inliers[12:].sum() >= 26
    assert differ(found.similarity, similarity) < 5 * 0.01 / math.sqrt(28)
    assert float(found.rotation_deg[12:].square().mean().sqrt()) == pytest.approx(0.5, rel=0.4)
    assert float(found.centre_error[12:].square().mean().sqrt()) == pytest.approx(0.01, rel=0.4)


@settings(deadline=None, derandomize=True, max_examples=25)
@given(seed=seeds)
def test_exact_cameras_give_the_closed_form_for_their_centres_and_what_colmap_finds(seed):
    rng = np.random.default_rng(seed)
    true, similarity = scattered(30, rng), some(rng)
    found = align(to_estimated(similarity, true), true).similarity
    source, target = centres(to_estimated(similarity, true)), centres(true)
    scale, rotation, translation = umeyama(source, target)
    colmap = pycolmap.estimate_sim3d(source, target)
    assert found.scale == pytest.approx(scale, rel=1e-9) == pytest.approx(colmap.scale, rel=1e-9)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(found.rotation, colmap.rotation.matrix(), atol=1e-9)
    np.testing.assert_allclose(found.translation, translation, atol=1e-7)
    np.testing.assert_allclose(found.translation, colmap.translation, atol=1e-7)


def test_the_fit_is_least_squares_in_turns_and_centres():
    rng = np.random.default_rng(5)
    true = orbit(15)
    extent = extent_of(true.numpy())
    # Errors of one size, so that every camera is an inlier.
    estimated = noisy(true, 1.0, 0.02 * extent, rng)
    found = align(estimated, true)
    assert found.inliers.all()

    def cost(s: Similarity) -> float:
        aligned = to_true(s, estimated)
        turns = (aligned[:, :3, :3] - true[:, :3, :3]).square().sum() / 2
        return float(turns + np.square((centres(aligned) - centres(true)) / extent).sum())

    best = cost(found.similarity)
    for _ in range(300):
        turn = torch.from_numpy(Rotation.from_rotvec(2e-4 * rng.standard_normal(3)).as_matrix())
        nudge = Similarity(1 + 2e-4 * rng.standard_normal(), turn, torch.from_numpy(2e-4 * rng.standard_normal(3)))
        assert cost(nudge @ found.similarity) > best


def test_errors_are_those_of_the_one_wrong_camera():
    true = orbit(9)
    estimated = true.clone()
    turn = Rotation.from_rotvec(np.radians(3.0) * np.array([0.0, 0.6, 0.8])).as_matrix()
    estimated[4, :3, :3] = torch.from_numpy(turn) @ true[4, :3, :3]
    moved = torch.from_numpy(centres(true)[4] + [0.0, 0.3, 0.4])
    estimated[4, :3, 3] = -estimated[4, :3, :3] @ moved
    found = align(to_estimated(some(np.random.default_rng(1)), estimated), true)
    want = torch.zeros(9, dtype=torch.float64)
    want[4] = 3.0
    torch.testing.assert_close(found.rotation_deg, want, atol=1e-9, rtol=0)
    want[4] = 0.5 / extent_of(true.numpy())
    torch.testing.assert_close(found.centre_error, want, atol=1e-7, rtol=0)


def test_a_camera_that_is_estimated_twice_decides_nothing():
    """Two views with the very same estimate leave the scale between them open; the others have one."""
    true, similarity = orbit(9), some(np.random.default_rng(4))
    estimated = to_estimated(similarity, true)
    estimated[1] = estimated[0]
    found = align(estimated, true)
    assert found.inliers.tolist() == [True, False] + [True] * 7
    assert differ(found.similarity, similarity) < 1e-9


def test_of_six_cameras_the_spread_is_taken_for_wider_than_their_median_says():
    """Rousseeuw's factor for them is 1 + 5 / 4: one that is off by seven times the median still counts."""
    true = orbit(6)
    for off, counts in ((3.6, True), (12.0, False)):
        angles = np.radians([0.5, -0.5, 0.5, -0.5, 0.5, off])  # about each camera's own axis
        turns = Rotation.from_rotvec(angles[:, None] * [0.0, 0.0, 1.0]).as_matrix()
        estimated = true.clone()
        estimated[:, :3] = torch.from_numpy(turns) @ true[:, :3]
        assert align(estimated, true).inliers.tolist() == [True] * 5 + [counts]


def test_equal_cameras_give_the_exact_identity():
    true = orbit(7)
    found = align(true.clone(), true)
    assert found.similarity.scale == 1.0
    assert torch.equal(found.similarity.rotation, torch.eye(3, dtype=torch.float64))
    for zero in (found.similarity.translation, found.rotation_deg, found.centre_error):
        assert not zero.any()
    assert torch.equal(to_estimated(found.similarity, true), true)


def test_cameras_on_a_line_are_aligned_by_their_rotations():
    true = torch.eye(4, dtype=torch.float64).repeat(5, 1, 1)
    true[:, 0, 3] = torch.linspace(-1, 1, 5, dtype=torch.float64)
    similarity = some(np.random.default_rng(2))
    assert differ(align(to_estimated(similarity, true), true).similarity, similarity) < 1e-9


@settings(deadline=None, derandomize=True, max_examples=25)
@given(seed=seeds)
def test_a_similarity_keeps_what_a_camera_sees(seed):
    rng = np.random.default_rng(seed)
    true, similarity, points = scattered(3, rng), some(rng), torch.from_numpy(rng.normal(0, 3, (20, 3)))
    estimated = to_estimated(similarity, true)
    here = points @ estimated[0, :3, :3].T + estimated[0, :3, 3]
    there = similarity.apply(points) @ true[0, :3, :3].T + true[0, :3, 3]
    torch.testing.assert_close(there, similarity.scale * here, atol=1e-9, rtol=1e-9)
    rotations = estimated[:, :3, :3]
    torch.testing.assert_close(rotations @ rotations.mT, torch.eye(3, dtype=torch.float64).expand(3, 3, 3))
    torch.testing.assert_close(to_true(similarity, estimated), true, atol=1e-9, rtol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=25)
@given(seed=seeds)
def test_similarities_are_a_group(seed):
    rng = np.random.default_rng(seed)
    a, b, c = (some(rng) for _ in range(3))
    points = torch.from_numpy(rng.normal(0, 1, (5, 3)))
    torch.testing.assert_close((a @ b).apply(points), a.apply(b.apply(points)))
    assert differ((a @ b) @ c, a @ (b @ c)) < 1e-9
    identity = Similarity(1.0, torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))
    assert differ(a @ a.inverse(), identity) < 1e-9
    assert differ(a.inverse() @ a, identity) < 1e-9
    assert differ(a @ identity, a) == differ(identity @ a, a) == 0


def test_what_a_similarity_leaves_apart_is_what_colmaps_leaves():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(12, 3))
    turned = 0.3 * points @ Rotation.random(random_state=2).as_matrix().T + [1.0, 2.0, 3.0]
    assert left_apart(points, turned) < 1e-9
    noisy = turned + 0.05 * rng.normal(size=points.shape)
    theirs = pycolmap.estimate_sim3d(points, noisy)
    away = np.array([theirs * point for point in points]) - noisy
    assert left_apart(points, noisy) == pytest.approx(float(np.sqrt((away**2).sum(1).mean())), rel=1e-9)
    assert left_apart(points, points * [-1.0, 1.0, 1.0]) > 0.3  # a mirror is no turn
    assert left_apart(np.zeros((4, 3)), points[:4]) > 0  # all at one point


def test_errors_of_pairs_are_colmaps_of_their_relative_poses():
    rng = np.random.default_rng(3)
    true = orbit(5).numpy()
    similarity = some(rng)
    found = to_estimated(similarity, noisy(orbit(5), 4.0, 0.1, rng)).numpy()
    turns, directions = pair_errors(found, true, range(5))
    k = 0
    for i in range(5):
        for j in range(i + 1, 5):
            a, b = (pycolmap.Rigid3d(v[j, :3]) * pycolmap.Rigid3d(v[i, :3]).inverse() for v in (found, true))
            assert turns[k] == pytest.approx(math.degrees(a.rotation.angle_to(b.rotation)), abs=1e-6)
            cosine = a.translation @ b.translation / np.linalg.norm(a.translation) / np.linalg.norm(b.translation)
            assert directions[k] == pytest.approx(math.degrees(math.acos(cosine)), abs=1e-5)
            k += 1
    assert 0.5 < turns.mean() < 10


def test_pairs_without_a_camera_are_lost_and_a_mirrored_world_is_wrong():
    true = orbit(4).numpy()
    turns, directions = pair_errors(true[[0, 2, 3]], true, [0, 2, 3])
    lost = [True, False, False, True, True, False]  # 01 02 03 12 13 23
    assert np.isinf(turns).tolist() == np.isinf(directions).tolist() == lost
    np.testing.assert_allclose(turns[np.isfinite(turns)], 0, atol=1e-5)
    backwards = true.copy()
    backwards[:, :3, 3] *= -1
    assert np.allclose(pair_errors(backwards, true, range(4))[1], 180, atol=1e-4)
    same = true.copy()
    same[1, :3, 3] = -same[1, :3, :3] @ centres(torch.from_numpy(same))[0]
    turns, directions = pair_errors(true, same, range(4))
    assert (len(turns), len(directions)) == (6, 5)  # two true cameras at one place


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_the_scale_of_an_estimate_has_no_say_in_the_errors_of_its_pairs(scale):
    true, found = orbit(4).numpy(), noisy(orbit(4), 4.0, 0.1, np.random.default_rng(0)).numpy()
    wanted = pair_errors(found, true, range(4))
    found[:, :3, 3] *= scale
    for errors, want in zip(pair_errors(found, true, range(4)), wanted, strict=True):
        assert len(errors) == 6
        np.testing.assert_allclose(errors, want, rtol=1e-6)


@pytest.mark.parametrize(
    ("errors", "wanted"), [([0.0, 0.0], 1.0), ([5.0, 9.0], 0.0), ([1.0, 4.0, math.inf], (0.8 + 0.2) / 3), ([2.5], 0.5)]
)
def test_the_area_is_that_below_the_share_of_errors(errors, wanted):
    """Independent: the area by many thin bins."""
    found = auc(np.array(errors), 5.0)
    assert found == pytest.approx(wanted)
    edges = np.linspace(0, 5, 20001)
    assert found == pytest.approx(np.mean([np.mean(np.array(errors) <= t) for t in edges]), abs=1e-3)


def test_the_trajectory_error_is_in_extents_and_blind_to_the_frame():
    rng = np.random.default_rng(5)
    true = orbit(8).numpy()
    found = to_estimated(some(rng), torch.from_numpy(true)).numpy()
    assert trajectory_error(found, true) < 1e-9
    moved = noisy(orbit(8), 0.0, 0.3, rng).numpy()
    theirs = left_apart(centres(torch.from_numpy(moved)), centres(torch.from_numpy(true)))
    assert trajectory_error(moved, true) == pytest.approx(theirs / extent_of(true))
    assert math.isnan(auc(np.zeros(0), 5.0))


def test_points_twice_as_deep_have_a_depth_scale_of_two():
    """Cameras that look at a wall at z = 2, and points on it, moved away from each camera's plane by a factor."""
    viewmats = torch.eye(4, dtype=torch.float64).repeat(3, 1, 1)
    viewmats[:, 0, 3] = torch.tensor([-0.2, 0.0, 0.2])
    Ks = torch.tensor([[20.0, 0, 10], [0, 20, 10], [0, 0, 1]], dtype=torch.float64).repeat(3, 1, 1)
    depths = torch.full((3, 20, 20), 2.0)
    depths[:, :, 15:] = math.inf
    depths[:, 11:, :15] = 7.0  # where no point is seen, but where points would be with rows and columns exchanged
    similarity = some(np.random.default_rng(3))
    corner = torch.tensor([0.0, -0.5], dtype=torch.float64)  # right of the middle, and above it
    wall = torch.cat([torch.rand(400, 2, dtype=torch.float64) / 2 + corner, torch.ones(400, 1, dtype=torch.float64)], 1)
    for factor in (1.0, 2.0, 0.5):
        points = similarity.inverse().apply(wall * 2 * factor).float()
        rig = Rig(viewmats=to_estimated(similarity, viewmats).numpy(), Ks=Ks.numpy(), width=20, height=20)
        estimate = CameraEstimate(
            registered=(0, 1, 2), rig=rig, points=points,
            colors=torch.zeros(400, 3), extent=1.0,
        )  # fmt: skip
        assert depth_scale(estimate, similarity, viewmats, Ks, depths) == pytest.approx(factor, rel=1e-4)
        behind = torch.full((3, 20, 20), math.inf)
        assert math.isnan(depth_scale(estimate, similarity, viewmats, Ks, behind))


@pytest.mark.parametrize(
    ("estimated", "message"),
    [
        (orbit(3), "same 2 or more cameras"),
        (orbit(4)[:, :3], "same 2 or more cameras"),
        (orbit(4) * math.nan, "needs finite cameras"),
        (torch.eye(4, dtype=torch.float64).repeat(4, 1, 1), "the estimated cameras all stand at one point"),
    ],
)
def test_what_cannot_be_aligned_is_refused(estimated, message):
    with pytest.raises(ValueError, match=message):
        align(estimated, orbit(4))
    with pytest.raises(ValueError, match="same 2 or more cameras"):
        align(orbit(4)[:1], orbit(4)[:1])
    with pytest.raises(ValueError, match="the true cameras all stand at one point"):
        align(orbit(4), torch.eye(4, dtype=torch.float64).repeat(4, 1, 1))
