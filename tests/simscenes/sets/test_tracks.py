"""Claims about sparse points: what structure from motion measured stays, and nothing is invented beside it."""

from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from simscenes import Rig, SparsePoints, load_set, orbit_rig, write_cameras
from simscenes.sets.geometry.plausible import with_tested_tracks
from simscenes.sets.geometry.tracks import UNKNOWN

VIEWS, WIDTH, HEIGHT, NOISE = 6, 64, 48, 0.4
LENS = [50.0, 52.0, 32.5, 23.0, 0.05, -0.02, 0.001, -0.002]  # OPENCV: fx fy cx cy k1 k2 p1 p2


def measured(folder: Path, seed: int = 0) -> pycolmap.Reconstruction:
    """Photographs with a model as COLMAP leaves it: noisy features of a distorted lens, each point seen by a few views,
    2D points without a 3D one, numbers with gaps, and errors by COLMAP itself."""
    rng = np.random.default_rng(seed)
    rig = orbit_rig(VIEWS, WIDTH, HEIGHT, 60.0, radius=2.0)
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="OPENCV", width=WIDTH, height=HEIGHT, params=LENS, camera_id=3)
    model.add_camera_with_trivial_rig(camera)
    xyz = rng.uniform(-0.4, 0.4, (40, 3))
    sees = np.array([rng.permutation(VIEWS) < 2 + k % 3 for k in range(40)]).T
    tracks = [pycolmap.Track() for _ in xyz]
    (folder / "images").mkdir(parents=True)
    for c in range(VIEWS):
        at = xyz[sees[c]] @ rig.viewmats[c, :3, :3].T + rig.viewmats[c, :3, 3]
        pixels = camera.img_from_cam(at) + rng.normal(0, NOISE, (len(at), 2))
        stray = rng.uniform(5, 40, (3, 2))
        image = pycolmap.Image(
            name=f"p{c}.png", keypoints=np.concatenate([stray, pixels]), camera_id=3, image_id=10 + c
        )
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(rig.viewmats[c, :3]))
        for k, p in enumerate(np.flatnonzero(sees[c])):
            tracks[p].add_element(10 + c, 3 + k)
        cv2.imwrite(str(folder / "images" / f"p{c}.png"), np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    for place, track in zip(xyz, tracks, strict=True):
        model.add_point3D(place, track, np.array([10, 20, 30], np.uint8))
    model.update_point_3d_errors()
    (folder / "sparse/0").mkdir(parents=True)
    model.write_binary(str(folder / "sparse/0"))
    return model


def tracks_of(model: pycolmap.Reconstruction) -> dict[tuple[float, ...], list[str]]:
    """Names of the images that see each point, by its place."""
    return {
        tuple(np.round(p.xyz, 9)): sorted(model.images[e.image_id].name for e in p.track.elements)
        for p in model.points3D.values()
    }


def written(folder: Path, points: SparsePoints | None, rig: Rig, names: tuple[str, ...]) -> pycolmap.Reconstruction:
    write_cameras(folder, names, rig, points=points)
    return pycolmap.Reconstruction(str(folder / "sparse/0"))


def recomputed(model: pycolmap.Reconstruction) -> np.ndarray:
    """Errors of the points by pycolmap's own sums over their observations."""
    fresh = pycolmap.Reconstruction(model)
    fresh.update_point_3d_errors()
    return stated(fresh)


def stated(model: pycolmap.Reconstruction) -> np.ndarray:
    return np.array([p.error for _, p in sorted(model.points3D.items())])


def test_measured_tracks_and_errors_survive_reading_undistortion_and_writing(tmp_path: Path) -> None:
    before = measured(tmp_path / "photos")
    views = load_set(tmp_path / "photos")
    assert views.lenses is not None
    after = written(tmp_path / "set", views.points(), views.rig, views.names)
    assert tracks_of(after) == tracks_of(before)
    assert np.allclose(stated(after), recomputed(after), rtol=1e-9, atol=0)
    # The undistorted pinhole has about the same pixels, and errors with it.
    assert after.compute_mean_reprojection_error() == pytest.approx(before.compute_mean_reprojection_error(), rel=0.1)
    assert before.compute_mean_reprojection_error() > 0.2


def test_an_observation_moves_with_its_pixel_when_the_lens_is_straightened(tmp_path: Path) -> None:
    """Independent: OpenCV's undistortion of each single feature, at integer centres."""
    before = measured(tmp_path)
    views = load_set(tmp_path)
    points = views.points()
    assert points is not None
    shift = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    K = np.array([[LENS[0], 0, LENS[2]], [0, LENS[1], LENS[3]], [0, 0, 1]]) - shift
    for i, image in enumerate(sorted(before.images.values(), key=lambda image: image.name)):
        features = np.array([p.xy for p in image.points2D if p.has_point3D()])
        new = views.rig.Ks[i] - shift
        expected = cv2.undistortPoints(features[:, None] - 0.5, K, np.array(LENS[4:]), P=new)[:, 0] + 0.5
        assert np.abs(points.pixel[points.view == i] - expected).max() < 1e-4


def test_pictures_half_as_large_have_the_same_tracks_and_half_the_error(tmp_path: Path) -> None:
    measured(tmp_path / "photos")
    views = load_set(tmp_path / "photos")
    points = views.points()
    assert points is not None
    scale = np.array([0.5, 0.5, 1])[:, None]
    half = Rig(viewmats=views.rig.viewmats, Ks=views.rig.Ks * scale, width=WIDTH // 2, height=HEIGHT // 2)
    small = written(tmp_path / "half", points.at_size(views.rig, half), half, views.names)
    large = written(tmp_path / "full", points, views.rig, views.names)
    assert tracks_of(small) == tracks_of(large)
    assert np.allclose(stated(small), stated(large) / 2, rtol=1e-9, atol=0)
    assert np.allclose(stated(small), recomputed(small), rtol=1e-9, atol=0)


def test_observations_follow_each_side_of_a_picture_by_its_own_factor_and_those_outside_are_dropped() -> None:
    rig = orbit_rig(VIEWS, WIDTH, HEIGHT, 60.0, radius=2.0)
    everywhere = np.ones((VIEWS, 5), bool)
    points = SparsePoints.seen(rig, np.random.default_rng(0).uniform(-0.3, 0.3, (5, 3)), np.zeros((5, 3)), everywhere,
                               exact=True)  # fmt: skip
    scaled = Rig(viewmats=rig.viewmats, Ks=rig.Ks * np.array([0.5, 0.75, 1])[:, None], width=32, height=36)
    found = points.at_size(rig, scaled)
    np.testing.assert_allclose(found.pixel, points.pixel * [0.5, 0.75])
    np.testing.assert_allclose(found.error, 0, atol=1e-9)
    beside = points.pixel + [0.0, 20.0]  # over the lower border of some pictures, and off by 20 px in the others
    found = points.observed(rig, points.view, points.point, beside)
    kept = beside[:, 1] < HEIGHT
    assert 0 < kept.sum() < len(kept)
    np.testing.assert_array_equal(found.pixel, beside[kept])
    np.testing.assert_allclose(found.error[found.lengths > 0], 20.0)


def test_reading_what_was_written_changes_nothing(tmp_path: Path) -> None:
    measured(tmp_path / "photos")
    views = load_set(tmp_path / "photos")
    first = written(tmp_path / "one", views.points(), views.rig, views.names)
    (tmp_path / "one/images").mkdir()
    for name in views.names:
        cv2.imwrite(str(tmp_path / "one/images" / f"{name}.png"), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    again = load_set(tmp_path / "one")
    second = written(tmp_path / "two", again.points(), again.rig, again.names)
    assert tracks_of(second) == tracks_of(first)
    assert np.allclose(stated(second), stated(first), rtol=1e-9, atol=0)


def test_a_view_without_its_picture_takes_its_observations_along(tmp_path: Path) -> None:
    before = measured(tmp_path)
    (tmp_path / "images/p2.png").unlink()
    with pytest.warns(UserWarning, match="1 of 6"):
        views = load_set(tmp_path)
    after = written(tmp_path / "set", views.points(), views.rig, views.names)
    assert tracks_of(after) == {xyz: [n for n in seen if n != "p2.png"] for xyz, seen in tracks_of(before).items()}
    measured_still = np.array([p.track.length() > 0 for _, p in sorted(after.points3D.items())])
    assert np.allclose(stated(after)[measured_still], recomputed(after)[measured_still], rtol=1e-9, atol=0)
    assert (stated(after)[~measured_still] == UNKNOWN).all()


def test_a_world_moved_to_its_cameras_has_the_same_observations(tmp_path: Path) -> None:
    measured(tmp_path)
    views = load_set(tmp_path)
    here, there = views.points(), views.about((3.0, -2.0, 1.0)).points()
    assert here is not None
    assert there is not None
    assert np.allclose(there.xyz + [3.0, -2.0, 1.0], here.xyz)
    assert np.allclose(there.pixel, here.pixel)
    assert np.allclose(there.error, here.error)


def test_points_that_nobody_matched_have_an_unknown_error_and_pycolmap_counts_none(tmp_path: Path) -> None:
    rig = orbit_rig(VIEWS, WIDTH, HEIGHT, 60.0, radius=2.0)
    model = written(tmp_path, SparsePoints.untracked(np.eye(3), np.zeros((3, 3))), rig, tuple("abcdef"))
    assert [p.track.length() for p in model.points3D.values()] == [0, 0, 0]
    assert not any(p.has_error() for p in model.points3D.values())
    assert model.compute_mean_reprojection_error() == 0


@pytest.fixture
def two_walls(tmp_path: Path) -> tuple[Path, Rig, np.ndarray, np.ndarray]:
    """Photographs of a red wall before a blue one, from an arc; points on both, and which are the near."""
    rig = orbit_rig(8, 64, 48, 60.0, radius=3.0, elevation_deg=0.0, swing_deg=0.0, start_deg=-30.0, sweep_deg=60.0)
    grid = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 40), np.linspace(-0.5, 0.5, 40)), -1).reshape(-1, 2)
    near = np.stack([np.full(1600, 0.6), *grid.T], 1)
    far = np.stack([np.full(1600, -0.6), *(2.0 * grid).T], 1)
    xyz, front = np.concatenate([near, far]), np.repeat([True, False], 1600)
    pixels, depth = rig.project(xyz)
    (tmp_path / "images").mkdir()
    names = [f"{i:04d}" for i in range(8)]
    write_cameras(tmp_path, names, rig, points=SparsePoints.untracked(xyz, np.zeros((3200, 3))))
    for i, name in enumerate(names):
        picture = np.zeros((48, 64, 3), np.uint8)
        for k in np.argsort(-depth[i]):
            x, y = np.floor(pixels[i, k]).astype(int)
            cv2.rectangle(picture, (x - 1, y - 1), (x + 1, y + 1), (40, 40, 220) if front[k] else (220, 40, 40), -1)
        cv2.imwrite(str(tmp_path / "images" / f"{name}.png"), picture)
    return tmp_path, rig, xyz, front


def test_tested_tracks_of_photographs_leave_out_what_is_hidden(
    two_walls: tuple[Path, Rig, np.ndarray, np.ndarray],
) -> None:
    folder, rig, xyz, front = two_walls
    views = load_set(folder)
    points = views.points()
    assert points is not None
    assert len(points.view) == 0
    found = with_tested_tracks(views, points)
    visible = np.zeros((8, 3200), bool)
    visible[found.view, found.point] = True
    eyes = rig.positions[:, None]
    along = (0.6 - eyes[..., 0]) / (xyz[None, :, 0] - eyes[..., 0])  # where the line of sight meets the near wall
    hit = eyes + along[..., None] * (xyz[None] - eyes)
    hidden = ~front & (np.abs(hit[..., 1:]) < 0.5).all(-1)
    assert hidden.mean() > 0.1
    assert visible[hidden].mean() < 0.02  # by the frame alone it is all of them
    assert visible[~hidden].mean() > 0.8
    assert (found.error == UNKNOWN).all()


def test_a_point_in_the_air_is_seen_only_where_the_pictures_show_one_colour(
    two_walls: tuple[Path, Rig, np.ndarray, np.ndarray],
) -> None:
    """Three points hide nothing of each other: what tells these views apart is the wall behind, red or blue."""
    folder, _, _, _ = two_walls
    views = load_set(folder)
    floating = np.array([[1.4, 0.3, 0.0], [1.4, -0.3, 0.1], [1.4, 0.28, -0.1]])
    found = with_tested_tracks(views, SparsePoints.untracked(floating, np.zeros((3, 3))))
    inside = SparsePoints.seen(views.rig, floating, np.zeros((3, 3)), np.ones((8, 3), bool), exact=False)

    def reds(points: SparsePoints, k: int) -> set[bool]:
        at = zip(points.view[points.point == k], points.pixel[points.point == k].astype(int), strict=True)
        return {bool(views.image(i)[y, x, 0] > 120) for i, (x, y) in at}

    for k in range(3):
        assert reds(inside, k) == {True, False}
        assert len(reds(found, k)) == 1
