from types import SimpleNamespace
from typing import Any

import numpy as np
import pycolmap
import pytest
import torch

from novags.cameras.align import align
from novags.cameras.estimate import CameraEstimate
from novags.cameras.motion.mapping import from_reconstruction
from novags.cameras.motion.sfm import structure_from_motion
from novags.cameras.points import fill, project
from novags.cameras.sources.sfm import SfmConfig


def as_dark(pictures: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(pictures.astype(np.float32) / 2550)


@pytest.fixture(scope="module")
def scene(corner):
    return corner(6, 128, 112)


@pytest.fixture(scope="module")
def estimate(scene):
    return structure_from_motion(scene.pictures, scene.rig.Ks, as_dark(scene.pictures), n_points=2000)


def test_cameras_points_and_colours_of_clean_pictures_are_the_true_ones(scene, estimate):
    assert estimate.registered == tuple(range(6))
    np.testing.assert_array_equal(estimate.Ks.numpy(), scene.rig.Ks)
    found = align(estimate.viewmats, torch.tensor(scene.rig.viewmats))
    assert found.rotation_deg.max() < 0.5
    assert found.centre_error.max() < 0.02
    # 1.1 of the largest distance from the mean camera, in the frame of the reconstruction
    centres = np.array([np.linalg.inv(v)[:3, 3] for v in estimate.viewmats.numpy()])
    reach = np.linalg.norm(centres - centres.mean(0), axis=1).max()
    assert estimate.extent == pytest.approx(1.1 * reach, rel=1e-5)
    assert len(estimate.points) == len(estimate.colors) == 2000
    off = scene.distance(found.similarity.apply(estimate.points).numpy())
    # Points of the reconstruction are on the planes up to the noise of their matches, those between them up to the
    # curvature of what is interpolated; the cameras are 1.6 away.
    assert np.median(off) < 0.02
    assert np.quantile(off, 0.9) < 0.08
    shown = as_dark(scene.pictures).mean((0, 1, 2))
    torch.testing.assert_close(estimate.colors.mean(0), shown, atol=0.005, rtol=0)


def test_the_same_seed_gives_the_same_cameras_and_points(scene, estimate):
    again = structure_from_motion(scene.pictures, scene.rig.Ks, as_dark(scene.pictures), n_points=2000)
    assert torch.equal(again.viewmats, estimate.viewmats)
    assert torch.equal(again.points, estimate.points)


def test_the_seed_reaches_matches_cameras_and_the_choice_of_points(scene, estimate, monkeypatch):
    """COLMAP itself finds the same cameras of clean pictures with most seeds: it is asked which seed it was given."""
    match, build, given = pycolmap.match_exhaustive, pycolmap.incremental_mapping, list[int]()

    def matched(*args, verification_options, **rest):
        given.append(verification_options.ransac.random_seed)
        return match(*args, verification_options=verification_options, **rest)

    def built(database, pictures, out, options, **rest):
        given.append(options.random_seed)
        return build(database, pictures, out, options, **rest)

    monkeypatch.setattr(pycolmap, "match_exhaustive", matched)
    monkeypatch.setattr(pycolmap, "incremental_mapping", built)
    other = structure_from_motion(scene.pictures, scene.rig.Ks, as_dark(scene.pictures), n_points=2000, seed=7)
    assert given == [7, 7]
    between = slice(1500, None)  # beyond the points of the reconstruction, of random pixels
    here, there = (align(e.viewmats, torch.tensor(scene.rig.viewmats)).similarity for e in (estimate, other))
    apart = (here.apply(estimate.points[between]) - there.apply(other.points[between])).norm(dim=1)
    assert apart.median() > 0.1  # the same pixels would give the same points within 0.02


def test_the_seed_reaches_the_global_mapper(monkeypatch):
    given = list[int]()

    def mapped(database, pictures, out, options):
        given.append(options.random_seed)
        return {}

    monkeypatch.setattr(pycolmap, "global_mapping", mapped)
    blank, Ks = np.zeros((2, 64, 64, 3), np.uint8), np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]])[None].repeat(2, 0)
    for seed in (7, 8):
        with pytest.raises(ValueError, match="registered 0 of 2 views"):
            structure_from_motion(blank, Ks, as_dark(blank), n_points=50, config=SfmConfig(mapper="global"), seed=seed)
    assert given == [7, 8]


def test_each_view_has_its_own_intrinsics(scene):
    """The third picture is cut out of a larger one: its principal point lies 12 px to the left and 8 px lower."""
    pictures, Ks = scene.pictures.copy(), scene.rig.Ks.copy()
    pictures[2] = np.roll(pictures[2], (8, -12), (0, 1))
    pictures[2, :8], pictures[2, :, -12:] = 0, 0
    Ks[2, :2, 2] += [-12, 8]
    estimate = structure_from_motion(pictures, Ks, as_dark(pictures), n_points=300)
    found = align(estimate.viewmats, torch.tensor(scene.rig.viewmats)[list(estimate.registered)])
    assert 2 in estimate.registered
    assert found.rotation_deg.max() < 0.5
    assert found.centre_error.max() < 0.02


def test_the_global_mapper_finds_the_true_cameras(scene):
    config = SfmConfig(mapper="global")
    estimate = structure_from_motion(scene.pictures, scene.rig.Ks, as_dark(scene.pictures), n_points=100, config=config)
    found = align(estimate.viewmats, torch.tensor(scene.rig.viewmats)[list(estimate.registered)])
    assert len(estimate.registered) >= 5
    assert found.rotation_deg.max() < 0.5
    assert len(estimate.points) == 100  # the reconstruction has more


def test_a_view_that_shows_nothing_is_not_registered(scene):
    pictures = scene.pictures.copy()
    pictures[1] = 7
    steps: list[tuple[int, int]] = []
    estimate = structure_from_motion(
        pictures,
        scene.rig.Ks,
        as_dark(pictures),
        n_points=50,
        progress=lambda done, total, what: steps.append((done, total)),
    )
    assert estimate.registered == (0, 2, 3, 4, 5)
    np.testing.assert_array_equal(estimate.Ks.numpy(), scene.rig.Ks[[0, 2, 3, 4, 5]])
    found = align(estimate.viewmats, torch.tensor(scene.rig.viewmats)[[0, 2, 3, 4, 5]])
    assert found.rotation_deg.max() < 0.5
    assert steps == sorted(steps)
    assert steps[0] == (0, 13)
    assert steps[-1] == (13, 13)


@pytest.mark.parametrize("mapper", ["incremental", "global"])
def test_pictures_that_show_nothing_are_refused_with_what_to_do(mapper):
    blank = np.full((3, 64, 64, 3), 9, np.uint8)
    Ks = np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]])[None].repeat(3, 0)
    with pytest.raises(
        ValueError, match=r"of 3 views of the raw pictures.*try pictures=enhanced or pictures=denoised, "
    ):
        structure_from_motion(blank, Ks, as_dark(blank), n_points=50, config=SfmConfig(mapper=mapper))


def test_points_between_the_observed_ones_have_their_depths_and_their_own_pixels_colour():
    rng = np.random.default_rng(0)
    viewmats = np.eye(4)[None].repeat(2, 0)
    viewmats[1, :3, :3] = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])  # looks along +x
    viewmats[:, :3, 3] = [[0, 0, 0], [0.3, -0.2, 0.5]]
    Ks = np.array([[30.0, 0, 16], [0, 25, 12], [0, 0, 1]])[None].repeat(2, 0)
    # View 0 observes a wall 2 in front of it, view 1 one point at depth 5.
    wall = np.concatenate([rng.uniform(-0.7, 0.7, (40, 2)), np.full((40, 1), 2.0)], 1)
    one = np.linalg.inv(viewmats[1]) @ [0.1, 0.1, 5.0, 1.0]
    dark = rng.random((2, 24, 32, 3), np.float32)
    points, colors = fill([wall, one[None, :3]], dark, viewmats, Ks, 101, rng)
    assert points.shape == colors.shape == (101, 3)
    for view, part, depth in ((0, slice(0, 50), 2.0), (1, slice(50, 101), 5.0)):
        pixels, z = project(points[part], viewmats[view], Ks[view])
        np.testing.assert_allclose(z, depth, rtol=1e-12)
        x, y = pixels.astype(int).T
        np.testing.assert_array_equal(colors[part], dark[view, y, x])
        assert np.ptp(pixels, axis=0).min() > 20  # all over the picture of 32 x 24


def test_inverse_depths_are_weighted_by_inverse_distance():
    """Against a loop over pixels and their four nearest observed points."""
    rng = np.random.default_rng(1)
    K = np.array([[30.0, 0, 16], [0, 30, 16], [0, 0, 1]])
    observed = rng.uniform([-1, -1, 2], [1, 1, 4], (9, 3))
    points, _ = fill([observed], np.zeros((1, 32, 32, 3), np.float32), np.eye(4)[None], K[None], 20, rng)
    at, depth = (observed @ K.T)[:, :2] / observed[:, 2:], observed[:, 2]
    for point in points:
        pixel = (K @ point)[:2] / point[2]
        distances = np.hypot(*(at - pixel).T)
        near = np.argsort(distances)[:4]
        weights = 1 / distances[near]
        assert 1 / point[2] == pytest.approx((weights / depth[near]).sum() / weights.sum(), rel=1e-9)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"pictures": "bright"}, "pictures of sfm must be one of raw, enhanced, denoised"),
        ({"mapper": "local"}, "mapper of sfm must be one of incremental, global"),
        ({"min_matches": 4}, "min_matches >= 8"),
        ({"max_features": 2}, "max_features >= 8"),
        ({"peak_threshold": 0.0}, "peak_threshold of sfm must be > 0"),
        ({"max_error": -1.0}, "max_error of sfm must be > 0"),
        ({"first_octave": -2}, "first_octave of sfm must be -1..2"),
        ({"threads": 0}, "threads >= 1"),
    ],
)
def test_impossible_settings_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        SfmConfig(**wrong)


def test_pictures_and_cameras_that_do_not_fit_are_refused(scene):
    dark = as_dark(scene.pictures)
    with pytest.raises(ValueError, match="pictures must be uint8"):
        structure_from_motion(scene.pictures / 255.0, scene.rig.Ks, dark, n_points=50)
    with pytest.raises(ValueError, match="Ks must be"):
        structure_from_motion(scene.pictures, scene.rig.Ks[:3], dark, n_points=50)
    with pytest.raises(ValueError, match="colors_from"):
        structure_from_motion(scene.pictures, scene.rig.Ks, dark[:, :5], n_points=50)
    with pytest.raises(ValueError, match="n_points must be >= 2"):
        structure_from_motion(scene.pictures, scene.rig.Ks, dark, n_points=1)


def test_a_pycolmap_without_global_mapper_says_so(scene, monkeypatch):
    import pycolmap

    monkeypatch.delattr(pycolmap, "global_mapping")
    with pytest.raises(ValueError, match="has no global mapper: pip install 'pycolmap>=4'"):
        structure_from_motion(
            scene.pictures, scene.rig.Ks, as_dark(scene.pictures), n_points=50, config=SfmConfig(mapper="global")
        )


def fake_image(name: str, center: float, lens: str, points: range) -> Any:
    """A picture of a model in the classes of pycolmap, from (center, 0, 0) along z."""
    pose = np.hstack([np.eye(3), [[-center], [0.0], [0.0]]])
    camera = SimpleNamespace(model=SimpleNamespace(name=lens),
                             calibration_matrix=lambda: np.array([[20.0, 0, 16], [0, 20, 12], [0, 0, 1]]))  # fmt: skip
    return SimpleNamespace(
        name=name, has_pose=True, camera=camera, cam_from_world=lambda: SimpleNamespace(matrix=lambda: pose),
        points2D=[SimpleNamespace(point3D_id=i, has_point3D=lambda: True) for i in points],
    )  # fmt: skip


@pytest.mark.parametrize("lenses", [("PINHOLE", "SIMPLE_PINHOLE"), ("PINHOLE", "OPENCV"), ("OPENCV", "PINHOLE")])
def test_points_are_added_in_every_view_and_every_lens_is_looked_at(lenses: tuple[str, str]) -> None:
    """One picture shows a wall 2 away, the other one, from 40 beside, a wall 5 away."""
    corners = [(x, y) for x in (-0.5, 0.5) for y in (-0.4, 0.4)]
    walls = [(40 * k + x * z, y * z, z) for k, z in enumerate((2.0, 5.0)) for x, y in corners]
    pictures = (fake_image(f"{k:06d}.png", 40.0 * k, lens, range(4 * k, 4 * k + 4)) for k, lens in enumerate(lenses))
    model = SimpleNamespace(
        images=dict(enumerate(pictures)),
        points3D={i: SimpleNamespace(xyz=xyz) for i, xyz in enumerate(walls)}, num_points3D=lambda: 8,
    )  # fmt: skip

    def found() -> CameraEstimate:
        return from_reconstruction(model, torch.rand(2, 24, 32, 3), 28, 0, what="COLMAP", kind="dark", advice="more")

    if "OPENCV" in lenses:
        with pytest.raises(ValueError, match="lenses must be pinholes, got OPENCV"):
            found()
        return
    depths = found().points[:, 2]
    assert [int((abs(depths - z) < 1e-3).sum()) for z in (2, 5)] == [14, 14]
