"""Camera conventions, checked against each other and against Mitsuba's own sensor."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from simscenes import backend, rigs
from simscenes.loading.load import build_scene
from simscenes.render.sensors import sensor_dict
from simscenes.rigs import Rig, forward_rig, look_at, orbit_rig
from simscenes.sets.writers.camera_files import write_cameras

finite = st.floats(-50, 50)


@st.composite
def poses(draw: st.DrawFn) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([draw(st.floats(-3, 3)) for _ in range(3)]).as_matrix()
    pose[:3, 3] = [draw(finite) for _ in range(3)]
    return pose


@given(poses())
@settings(derandomize=True, deadline=None)
def test_conversions_invert_each_other(viewmat: np.ndarray) -> None:
    assert np.allclose(rigs.mitsuba_to_opencv(rigs.opencv_to_mitsuba(viewmat)), viewmat, atol=1e-12)
    assert np.allclose(rigs.opengl_to_opencv(rigs.opencv_to_opengl(viewmat)), viewmat, atol=1e-12)
    assert np.allclose(rigs.invert_rigid(viewmat) @ viewmat, np.eye(4), atol=1e-12)


@given(poses())
@settings(derandomize=True, deadline=None)
def test_the_three_conventions_share_centre_and_name_the_same_axes(viewmat: np.ndarray) -> None:
    right, down, forward = viewmat[:3, :3]
    opengl, mitsuba = rigs.opencv_to_opengl(viewmat), rigs.opencv_to_mitsuba(viewmat)
    assert np.allclose(opengl[:3, 3], mitsuba[:3, 3])
    assert np.allclose(opengl[:3, :3], np.stack([right, -down, -forward], -1))
    assert np.allclose(mitsuba[:3, :3], np.stack([-right, -down, forward], -1))


@given(st.floats(5, 160), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
@settings(derandomize=True, deadline=None)
def test_intrinsics_survive_mitsubas_parameters(fov: float, ppx: float, ppy: float) -> None:
    K = rigs.mitsuba_to_intrinsics(fov, ppx, ppy, 64, 48)
    assert np.allclose(rigs.intrinsics_to_mitsuba(K, 64, 48), (fov, ppx, ppy), rtol=1e-12, atol=1e-12)


@pytest.mark.usefixtures("jit")
def test_projection_agrees_with_mitsubas_sensor_at_every_pixel_centre() -> None:
    mi = backend.activate()
    K = np.array([[70.0, 0, 25.0], [0, 70.0, 31.5], [0, 0, 1]])  # off-centre principal point
    viewmat = look_at((1.0, -2.0, 0.7), (0.1, 0.2, 0.3), up=(0.1, 0.0, 1.0))
    rig = Rig(viewmats=viewmat[None], Ks=K[None], width=61, height=43)
    loaded = build_scene({"type": "scene", "ball": {"type": "sphere"}}, mi)
    sensor = mi.load_dict(sensor_dict(mi, rig, 0, loaded))
    y, x = np.mgrid[:43, :61] + 0.5
    position = mi.Point2f(np.float32(x.ravel() / 61), np.float32(y.ravel() / 43))
    ray, _ = sensor.sample_ray(0.0, 0.5, position, mi.Point2f(0.5, 0.5))
    pixels, depths = rig.project(np.array(ray(3.0)).T.astype(np.float64))
    assert (depths > 0).all()
    assert np.abs(pixels[0] - np.stack([x.ravel(), y.ravel()], -1)).max() < 1e-4


def test_look_at_centres_the_target_and_keeps_up_up() -> None:
    viewmat = look_at((3, 1, 2), (0.5, 0.2, 0.1))
    rig = Rig(viewmats=viewmat[None], Ks=rigs.intrinsics(40, 30, 60)[None], width=40, height=30)
    pixels, depths = rig.project([[0.5, 0.2, 0.1], [0.5, 0.2, 0.4]])
    assert np.allclose(pixels[0, 0], (20, 15))
    assert pixels[0, 1, 1] < 15
    assert depths[0, 0] == pytest.approx(np.linalg.norm([2.5, 0.8, 1.9]))


def test_orbit_keeps_its_distance_and_does_not_repeat_a_camera() -> None:
    rig = orbit_rig(12, 32, 24, 50, target=(1, 2, 0.5), radius=2.0)
    distances = np.linalg.norm(rig.positions - [1, 2, 0.5], axis=1)
    assert np.allclose(distances, 2.0)
    gaps = np.linalg.norm(rig.positions[:, None] - rig.positions[None], axis=-1) + np.eye(12) * 9
    assert gaps.min() > 0.5
    pixels, _ = rig.project([[1, 2, 0.5]])
    assert np.allclose(pixels, (16, 12))


def test_partial_orbit_uses_both_ends() -> None:
    rig = orbit_rig(5, 8, 8, 50, radius=1.0, elevation_deg=0, swing_deg=0, start_deg=0, sweep_deg=90)
    azimuths = np.degrees(np.arctan2(rig.positions[:, 1], rig.positions[:, 0]))
    assert np.allclose(np.sort(azimuths), [0, 22.5, 45, 67.5, 90])


@pytest.mark.parametrize("n_views", range(3, 70))
def test_no_test_view_lies_at_an_end_of_an_arc(n_views: int) -> None:
    rig = orbit_rig(n_views, 8, 8, 50, radius=1.0, start_deg=0, sweep_deg=90, swing_deg=0)
    azimuths = np.degrees(np.arctan2(rig.positions[:, 1], rig.positions[:, 0]))
    tests = azimuths[::8]
    assert tests.min() > 1e-6
    assert tests.max() < 90 - 1e-6
    assert np.abs(np.diff(azimuths, append=azimuths[0])).max() < 2.01 * 90 / (n_views - 1)


@pytest.mark.parametrize("n_views", [4, 9, 12, 20, 41])
def test_the_first_view_of_an_arc_is_in_its_middle(n_views: int) -> None:
    rig = orbit_rig(n_views, 8, 8, 50, radius=1.0, start_deg=0, sweep_deg=90, swing_deg=0)
    first = np.degrees(np.arctan2(rig.positions[0, 1], rig.positions[0, 0]))
    step = 90 / (n_views - 1)
    assert abs(first - 45) <= 0.501 * step


def test_forward_rig_stays_in_its_window() -> None:
    rig = forward_rig(20, 8, 8, 50, position=(0, -4, 1), target=(0, 0, 1), extent=(0.5, 0.25))
    assert np.allclose(rig.positions[:, 1], -4)
    assert np.abs(rig.positions[:, 0]).max() == pytest.approx(0.5, rel=0.2)
    assert np.allclose([rig.positions[:, 2].min(), rig.positions[:, 2].max()], [0.75, 1.25])


def test_one_view_is_enough_for_either_rig() -> None:
    assert len(orbit_rig(1, 4, 4, 50, radius=1.0)) == 1
    one = forward_rig(1, 4, 4, 50, position=(0, -1, 0), target=(0, 0, 0), extent=(1, 1), rows=2)
    assert np.isfinite(one.viewmats).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"viewmats": np.eye(4)}, "must be"),
        ({"viewmats": 2 * np.eye(4)[None]}, "rotation"),
        ({"viewmats": np.diag([-1.0, 1, 1, 1])[None]}, "mirror"),
        ({"viewmats": np.full((1, 4, 4), np.nan)}, "finite"),
        ({"Ks": np.diag([-5.0, 5, 1])[None]}, "focal"),
        ({"width": 0}, "width"),
        ({"viewmats": np.eye(4)[None] + np.diag([0.0, 0.0, 3.0], -1)}, "0 0 0 1.*transposed"),
        ({"Ks": rigs.intrinsics(8, 8, 60).T[None]}, "transposed"),
        ({"Ks": rigs.intrinsics(8, 8, 60)[None] + np.diag([0.5, 0.0], 1)}, "without skew"),
    ],
)
def test_impossible_cameras_are_refused(change: dict, message: str) -> None:
    good = {"viewmats": np.eye(4)[None], "Ks": rigs.intrinsics(8, 8, 60)[None], "width": 8, "height": 8}
    with pytest.raises(ValueError, match=message):
        Rig(**{**good, **change})


def test_intrinsics_that_differ_by_the_sign_of_zero_are_one_camera(tmp_path: Path) -> None:
    Ks = np.stack([rigs.intrinsics(8, 8, 60)] * 2)
    Ks[1, 0, 1] = -0.0
    write_cameras(tmp_path, ["a", "b"], Rig(viewmats=np.stack([np.eye(4)] * 2), Ks=Ks, width=8, height=8))
    assert len(pycolmap.Reconstruction(str(tmp_path / "sparse" / "0")).cameras) == 1


def test_rig_arrays_cannot_be_changed_behind_its_back() -> None:
    viewmats = np.eye(4)[None]
    rig = Rig(viewmats=viewmats, Ks=rigs.intrinsics(8, 8, 60)[None], width=8, height=8)
    viewmats[0, 0, 3] = 9
    assert rig.viewmats[0, 0, 3] == 0
    with pytest.raises(ValueError, match="read-only"):
        rig.viewmats[0, 0, 3] = 1


@pytest.mark.parametrize(("position", "target"), [((1, 1, 1), (1, 1, 1)), ((0, 0, 1), (0, 0, 0))])
def test_look_at_refuses_an_undefined_direction(position: tuple, target: tuple) -> None:
    with pytest.raises(ValueError, match="look_at"):
        look_at(position, target)


def test_pixels_that_mitsuba_cannot_render_are_refused() -> None:
    with pytest.raises(ValueError, match="square pixels"):
        rigs.intrinsics_to_mitsuba([[50, 0, 10], [0, 55, 10], [0, 0, 1]], 20, 20)


def test_a_world_with_another_zero_is_seen_alike() -> None:
    rig, origin = orbit_rig(3, 40, 30, 50.0, radius=2.0), np.array([1.0, -2.0, 0.5])
    points = np.random.default_rng(0).normal(0, 0.3, (9, 3))
    for before, after in zip(rig.project(points), rig.about(origin).project(points - origin), strict=True):
        np.testing.assert_allclose(after, before, atol=1e-9)
