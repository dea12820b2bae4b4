"""What networks are told of known cameras, and depths that are brought to them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from novags.cameras.networks.dense import Window, prepare
from novags.cameras.networks.depths import NetworkAnswer, estimate_of, told
from simscenes.rigs import Rig, orbit_rig

RIG = orbit_rig(5, 40, 30, 50.0, radius=2.0, elevation_deg=30.0)
WINDOW = Window(np.array([2.0, 1.5]), np.array([3.0, 0.0]), 74, 45)


def moved(rig: Rig, turn: np.ndarray, shift: np.ndarray, scale: float) -> Rig:
    """The same cameras in a world with X_new = scale * turn @ X + shift."""
    viewmats = rig.viewmats.copy()
    viewmats[:, :3, :3] = rig.viewmats[:, :3, :3] @ turn.T
    viewmats[:, :3, 3] = scale * rig.viewmats[:, :3, 3] - viewmats[:, :3, :3] @ shift
    return replace(rig, viewmats=viewmats)


def test_a_network_is_told_poses_of_no_world_and_no_unit_and_lenses_of_its_pictures():
    viewmats, Ks = told("da3", "cameras", RIG, WINDOW)
    np.testing.assert_allclose(viewmats[0], np.eye(4), atol=1e-15)
    distances = np.linalg.norm(np.linalg.inv(viewmats)[:, :3, 3], axis=1)
    assert np.median(distances) == pytest.approx(1, rel=1e-12)
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    other, _ = told("da3", "cameras", moved(RIG, turn, np.array([5e3, -2e3, 70.0]), 1e-3), WINDOW)
    np.testing.assert_allclose(other, viewmats, atol=1e-6)  # 5e3 / 1e-3 times rounding
    # A point of a picture, 2 and 1.5 times as large, three columns cut off, has the same ray.
    pixel = np.array([11.0, 7.0, 1.0])
    seen = np.linalg.inv(Ks) @ np.array([11.0 * 2 - 3, 7.0 * 1.5, 1.0])
    np.testing.assert_allclose(seen, np.linalg.inv(RIG.Ks) @ pixel, rtol=1e-12)
    np.testing.assert_allclose(WINDOW.original_Ks(Ks), RIG.Ks, rtol=1e-14)
    assert told("da3", "lenses", RIG, WINDOW)[0] is None
    assert told("da3", "nothing", RIG, WINDOW) == (None, None)


def test_two_cameras_are_one_apart_and_cameras_at_one_place_are_refused():
    two = replace(RIG, viewmats=RIG.viewmats[:2], Ks=RIG.Ks[:2])
    viewmats, _ = told("da3", "cameras", two, WINDOW)
    assert np.linalg.norm(viewmats[1, :3, 3]) == pytest.approx(1, rel=1e-12)
    turned = RIG.viewmats.copy()
    turned[:, :3, 3] = -turned[:, :3, :3] @ np.array([3.0, 2.0, 1e6])
    with pytest.raises(
        ValueError, match="da3 cannot scale its depths by known cameras that all stand at one place: take"
    ):
        told("da3", "cameras", replace(RIG, viewmats=turned), WINDOW)


def test_each_pixel_that_a_network_sees_leads_back_to_its_place_in_its_own_picture():
    """Three pictures, twice as wide and four times as high by repeated pixels, of which a part is kept."""
    pictures = np.random.default_rng(0).integers(0, 256, (3, 30, 40, 3), np.uint8)
    prepared, window = prepare(pictures, (80, 120), (74, 115), (3, 2), Image.Resampling.NEAREST)
    x, y = np.meshgrid(np.arange(74) + 0.5, np.arange(115) + 0.5)
    column, row = np.moveaxis(window.original(np.stack([x, y], -1)).astype(int), -1, 0)
    seen = (255 * prepared).round().byte().movedim(1, -1).numpy()
    np.testing.assert_array_equal(seen, pictures[:, row, column])


def test_the_seed_chooses_the_pixels_that_become_points(corner):
    scene = corner(2, 40, 30)
    found = NetworkAnswer(scene.rig.viewmats, scene.rig.Ks, scene.depths, np.ones(scene.depths.shape))
    window, dark = Window(np.ones(2), np.zeros(2), 40, 30), torch.zeros(2, 30, 40, 3)
    one, again, *others = (
        estimate_of("da3", found, window, dark, n_points=50, drop_percent=0.0, seed=seed).points
        for seed in (3, 3, 1, 0)
    )
    assert torch.equal(one, again)
    assert not any(torch.equal(one, other) for other in others)


@pytest.mark.parametrize("known", ["nothing", "lenses", "cameras"])
def test_points_come_from_depths_alone_whatever_lies_behind_a_masked_pixel(corner, known):
    """Expectation: half the pixels are without depth, in one of four ways; the others lie on the surface.

    A network that is wrong by half a degree about cameras that it was told leaves them and its depths as they are. One
    that was told the lenses alone has cameras of its own.
    """
    scene = corner(4, 40, 30)
    g = np.random.default_rng(0)
    none = g.choice([0.0, -1.0, np.nan, np.inf], scene.depths.shape)
    depths = np.where(g.random(scene.depths.shape) < 0.5, none, 3 * scene.depths)
    turns = Rotation.from_rotvec(np.radians(0.5) * g.standard_normal((4, 3)) * (known == "cameras")).as_matrix()
    viewmats = moved(scene.rig, np.eye(3), np.array([1.0, 2.0, 3.0]), 3.0).viewmats.copy()
    viewmats[:, :3] = turns @ viewmats[:, :3]
    found = NetworkAnswer(viewmats[:, :3], scene.rig.Ks, depths, np.ones(depths.shape))
    window = Window(np.ones(2), np.zeros(2), 40, 30)
    got = estimate_of("da3", found, window, torch.zeros(4, 30, 40, 3), n_points=500, drop_percent=0.0, seed=0,
                      known=known, cameras=scene.rig)  # fmt: skip
    np.testing.assert_array_equal(got.Ks.numpy(), scene.rig.Ks)
    if known != "cameras":
        np.testing.assert_array_equal(got.viewmats.numpy(), viewmats)
        assert scene.distance((got.points.double().numpy() - [1.0, 2.0, 3.0]) / 3).max() < 1e-6
        return
    np.testing.assert_array_equal(got.viewmats.numpy(), scene.rig.viewmats)
    off = np.median(scene.distance(got.points.double().numpy()))
    assert 0 < off < 0.05  # half a degree at a distance of 1.6, in the scale of six pairs of cameras
