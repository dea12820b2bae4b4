"""Claims about view consistency: exact on linear pictures, on the truth, and under a wrong flow."""

import numpy as np
import pytest

from novags.testbed.metrics.consistency import color_change, consistency_scores
from simscenes import orbit_rig
from simscenes.sets.geometry.correspondence import flow_from_depth

H, W = 9, 14


def ramp(x0: float = 0.0, y0: float = 0.0) -> np.ndarray:
    """A picture linear in the pixel's centre, whose channels differ; bilinear interpolation is exact on it."""
    x, y = np.meshgrid(np.arange(W) + 0.5 + x0, np.arange(H) + 0.5 + y0)
    return np.stack([0.05 * x, 0.03 * y + 0.1, 0.02 * x + 0.04 * y], -1)


def inside(displacement: np.ndarray) -> np.ndarray:
    """Pixels whose counterpart has four neighbours to interpolate between."""
    x, y = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
    place = np.stack([x, y], -1) + displacement
    return ((place >= 0.5) & (place <= np.array([W, H]) - 0.5)).all(-1)


@pytest.mark.parametrize("move", [(0.0, 0.0), (2.0, 0.0), (0.0, -3.0), (1.25, 2.6), (-0.4, 0.3)])
def test_a_picture_that_moves_with_the_flow_does_not_change(move: tuple[float, float]) -> None:
    displacement = np.broadcast_to(np.array(move), (H, W, 2))
    change = color_change(ramp(), ramp(-move[0], -move[1]), displacement, inside(displacement))
    assert np.abs(change).max() < 1e-12


def test_the_change_is_the_second_view_minus_the_first_per_channel() -> None:
    displacement = np.zeros((H, W, 2))
    change = color_change(ramp(), ramp() + np.array((0.1, -0.2, 0.0)), displacement, inside(displacement))
    assert np.allclose(change, (0.1, -0.2, 0.0))


def test_a_flow_wrong_by_one_pixel_shows_as_the_slope_of_the_picture() -> None:
    displacement = np.broadcast_to(np.array((1.0, 0.0)), (H, W, 2))
    change = color_change(ramp(), ramp(), displacement, inside(displacement))
    assert np.allclose(change, (0.05, 0.0, 0.02))


def test_only_visible_pixels_count_and_others_may_have_no_flow() -> None:
    displacement = np.full((H, W, 2), np.nan)
    visible = np.zeros((H, W), bool)
    visible[2, 5], visible[4, 1] = True, True
    displacement[visible] = 0.0
    moved = ramp()
    moved[~visible] = 7.0
    scores = consistency_scores((ramp(), moved + 0.3), (ramp(), ramp()), displacement, visible)
    assert scores["rendered"] == pytest.approx(0.3)
    assert scores["reference"] == pytest.approx(0.0)


def test_the_truth_has_no_excess_although_its_gloss_moves() -> None:
    displacement = np.zeros((H, W, 2))
    pair = ramp(), ramp() + np.random.default_rng(0).normal(0, 0.1, (H, W, 3))
    scores = consistency_scores(pair, pair, displacement, inside(displacement))
    assert scores["rendered"] == scores["reference"] == pytest.approx(0.1 * np.sqrt(2 / np.pi), rel=0.2)
    assert scores["excess"] == 0.0


def test_a_picture_that_never_changes_pays_for_the_gloss_it_lacks() -> None:
    displacement = np.zeros((H, W, 2))
    gloss = np.random.default_rng(1).normal(0, 0.1, (H, W, 3))
    visible = inside(displacement)
    scores = consistency_scores((ramp(), ramp()), (ramp(), ramp() + gloss), displacement, visible)
    assert scores["rendered"] == pytest.approx(0.0, abs=1e-12)
    assert scores["excess"] == pytest.approx(scores["reference"]) == pytest.approx(np.abs(gloss[visible]).mean())


def test_gloss_that_moves_the_wrong_way_pays_twice() -> None:
    displacement = np.zeros((H, W, 2))
    gloss = np.random.default_rng(2).normal(0, 0.1, (H, W, 3))
    visible = inside(displacement)
    scores = consistency_scores((ramp(), ramp() - gloss), (ramp(), ramp() + gloss), displacement, visible)
    assert scores["excess"] == pytest.approx(2 * np.abs(gloss[visible]).mean())


def test_correspondences_of_a_textured_plane_keep_their_colour() -> None:
    rig = orbit_rig(8, 40, 30, 45, target=(0, 0, 0), radius=3.0, elevation_deg=60)
    centers = np.stack(np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5), -1)

    def plane(i: int) -> tuple[np.ndarray, np.ndarray]:
        local = np.concatenate([centers, np.ones((30, 40, 1))], -1) @ np.linalg.inv(rig.Ks[i]).T
        c2w = np.linalg.inv(rig.viewmats[i])
        depth = -c2w[2, 3] / (local @ c2w[2, :3])
        point = (local * depth[..., None]) @ c2w[:3, :3].T + c2w[:3, 3]
        return depth.astype(np.float32), 0.5 + 0.3 * np.sin(2 * point @ np.array([[1, 0, 1], [0, 1, -1], [0, 0, 0]]))

    (z_a, a), (z_b, b) = plane(0), plane(1)
    flow = flow_from_depth(rig, 0, 1, z_a, z_b)
    assert flow.visible.mean() > 0.5
    scores = consistency_scores((a, b), (a, b), flow.displacement, flow.visible)
    shifted = consistency_scores((a, np.roll(b, 1, 1)), (a, b), flow.displacement, flow.visible)
    # Bilinear interpolation of a wave of wave number 2: its error is an eighth of the squared step times curvature.
    assert scores["reference"] is not None
    assert shifted["excess"] is not None
    assert scores["reference"] < 2e-3
    assert shifted["excess"] > 10 * scores["reference"]


def test_views_that_share_no_point_have_no_score() -> None:
    scores = consistency_scores((ramp(), ramp()), (ramp(), ramp()), np.zeros((H, W, 2)), np.zeros((H, W), bool))
    assert scores == {"rendered": None, "reference": None, "excess": None}


def test_flows_that_leave_the_picture_or_do_not_fit_it_are_refused() -> None:
    displacement = np.zeros((H, W, 2))
    visible = np.ones((H, W), bool)
    with pytest.raises(ValueError, match="like the images"):
        color_change(ramp(), ramp(), displacement[:-1], visible)
    displacement[0, 0] = (-0.6, 0.0)
    with pytest.raises(ValueError, match=r"inside the second image, 0..14 by 0..9 px"):
        color_change(ramp(), ramp(), displacement, visible)
    displacement[0, 0] = np.nan
    with pytest.raises(ValueError, match="inside the second image"):
        color_change(ramp(), ramp(), displacement, visible)
