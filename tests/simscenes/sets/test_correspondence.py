"""Flow and exports of a rendered set."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simscenes import EXPORTS, MultiviewSet, Rig, export_blender, export_llff, flow, load_set, orbit_rig, write_cameras
from simscenes.sets.geometry.correspondence import flow_from_depth
from simscenes.sets.pictures.exr import write_exr
from simscenes.sets.pictures.png import write_png
from simscenes.sets.writers.camera_files import write_json


def plane_depth(rig: Rig, i: int) -> np.ndarray:
    """z-depth of the plane z = 0 at every pixel centre."""
    x, y = np.meshgrid(np.arange(rig.width) + 0.5, np.arange(rig.height) + 0.5)
    local = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(rig.Ks[i]).T
    c2w = np.linalg.inv(rig.viewmats[i])
    slope = (local @ c2w[:3, :3].T)[..., 2]
    return np.where(slope < 0, -c2w[2, 3] / np.where(slope < 0, slope, -1), np.inf).astype(np.float32)


@pytest.fixture
def views(tmp_path: Path) -> MultiviewSet:
    """A set of the plane z = 0, made without a renderer."""
    rig = orbit_rig(9, 24, 18, 50, target=(0, 0, 0), radius=3.0, elevation_deg=50)
    names = [f"{i:04d}" for i in range(9)]
    (tmp_path / "gt").mkdir()
    (tmp_path / "images").mkdir()
    for i, name in enumerate(names):
        z = plane_depth(rig, i)
        zero = np.zeros_like(z)
        channels = {c: zero for c in ("R", "G", "B", "N.X", "N.Y", "N.Z", "Ng.X", "Ng.Y", "Ng.Z")}
        channels |= {f"{k}.{c}": zero for k in ("albedo", "var") for c in "RGB"} | {"Z": z, "distance": z}
        write_exr(tmp_path / "gt" / f"{name}.exr", channels | {n: zero.astype(np.uint32) for n in ("id", "material")})
        write_png(tmp_path / "images" / f"{name}.png", np.full((18, 24, 3), 20 * i, np.uint8))
    write_cameras(tmp_path, names, rig)
    write_json(tmp_path / "set.json", {})
    return load_set(tmp_path)


def test_flow_of_a_plane_is_its_homography(views: MultiviewSet) -> None:
    found = flow(views, 2, 3)
    rig = views.rig
    H = [rig.Ks[i] @ rig.viewmats[i][:3, [0, 1, 3]] for i in (2, 3)]  # plane z = 0 -> image
    x, y = np.meshgrid(np.arange(24) + 0.5, np.arange(18) + 0.5)
    mapped = np.stack([x, y, np.ones_like(x)], -1) @ (H[1] @ np.linalg.inv(H[0])).T
    expected = mapped[..., :2] / mapped[..., 2:] - np.stack([x, y], -1)
    assert np.abs(found.displacement - expected).max() < 1e-3
    target = np.stack([x, y], -1) + expected
    inside = (target >= 0).all(-1) & (target < (24, 18)).all(-1)
    assert np.array_equal(found.visible, inside)
    assert inside.any()


def test_flow_projects_into_one_camera_alone(views: MultiviewSet, monkeypatch: pytest.MonkeyPatch) -> None:
    """All cameras of a large set at once would take gigabytes."""
    asked, project = [], Rig.project

    def spy(rig: Rig, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(len(rig))
        return project(rig, points)

    monkeypatch.setattr(Rig, "project", spy)
    flow(views, 2, 3)
    assert asked == [1]


def test_flow_to_itself_is_zero_and_hidden_points_are_hidden(views: MultiviewSet) -> None:
    same = flow(views, 4, 4)
    assert np.abs(same.displacement).max() < 1e-4
    assert same.visible.all()
    z = plane_depth(views.rig, 4)
    hidden = flow_from_depth(views.rig, 4, 4, z, 0.5 * z)  # something stands at half the distance
    assert not hidden.visible.any()
    assert not flow_from_depth(views.rig, 4, 4, z, 0.985 * z).visible.any()  # or one and a half hundredths before it
    assert flow_from_depth(views.rig, 4, 4, z, 0.995 * z).visible.all()  # half a hundredth is the same surface
    sky = flow_from_depth(views.rig, 4, 4, np.full_like(z, np.inf), z)
    assert np.isnan(sky.displacement).all()
    assert not sky.visible.any()


def test_flow_needs_depth(views: MultiviewSet) -> None:
    for path in (views.path / "gt").iterdir():
        path.unlink()
    (views.path / "gt").rmdir()
    with pytest.raises(ValueError, match="photographs"):
        flow(load_set(views.path), 0, 1)


def test_blender_folder_holds_the_same_cameras(views: MultiviewSet, tmp_path: Path) -> None:
    folder = export_blender(views, tmp_path / "blender")
    test = json.loads((folder / "transforms_test.json").read_text())
    assert [f["file_path"] for f in test["frames"]] == ["./test/0000", "./test/0008"]
    assert (folder / "test" / "0008.png").is_file()
    assert test["w"] == 24
    (folder / "transforms_train.json").rename(folder / "transforms.json")
    again = load_set(folder)  # our reader of camera_angle_x knows nothing of the writer
    poses = np.linalg.inv(again.rig.viewmats)
    poses[:, :3, 3] = poses[:, :3, 3] / test["scene_scale"] + test["scene_center"]
    assert np.allclose(poses, np.linalg.inv(views.rig.viewmats[views.train_indices]), atol=1e-12)
    assert np.allclose(again.rig.Ks, views.rig.Ks[views.train_indices])


def test_blender_layout_refuses_what_it_cannot_say(views: MultiviewSet, tmp_path: Path) -> None:
    Ks = views.rig.Ks.copy()
    Ks[:, 0, 2] += 2
    shifted = Rig(viewmats=views.rig.viewmats, Ks=Ks, width=24, height=18)
    write_cameras(views.path, views.names, shifted)
    with pytest.raises(ValueError, match="principal point"):
        export_blender(load_set(views.path), tmp_path / "blender")


@pytest.mark.parametrize("axis", [0, 1])
def test_llff_says_or_refuses_a_principal_point_that_it_cannot_hold(
    views: MultiviewSet, tmp_path: Path, axis: int
) -> None:
    """The longer side has 24 px, of which 2 % are 0.48."""
    for away, said in ((0.4, r"up to 0\.40 px wrong \(view 5\)"), (-0.6, r"in view 5 it is 0\.60 px away")):
        Ks = views.rig.Ks.copy()
        Ks[5, axis, 2] += away
        moved = replace(views, rig=replace(views.rig, Ks=Ks))
        if away > 0:
            with pytest.warns(UserWarning, match=said):
                export_llff(moved, tmp_path / "llff")
        else:
            with pytest.raises(ValueError, match=said):
                EXPORTS["llff"].check(moved.rig)


def test_llff_poses_are_down_right_back_with_bounds_that_hold(views: MultiviewSet, tmp_path: Path) -> None:
    rows = np.load(export_llff(views, tmp_path / "llff") / "poses_bounds.npy")
    assert rows.shape == (9, 17)
    for i, row in enumerate(rows):
        pose, (near, far) = row[:15].reshape(3, 5), row[15:]
        right, down, forward = views.rig.viewmats[i][:3, :3]
        assert np.allclose(pose[:, :3].T, [down, right, -forward])
        assert np.allclose(pose[:, 3], views.rig.positions[i])
        assert pose[:, 4].tolist() == [18, 24, views.rig.Ks[i, 0, 0]]
        z = plane_depth(views.rig, i)
        assert z.min() * 0.99 <= near < far <= z.max() * 1.01
    assert len(list((tmp_path / "llff" / "images").iterdir())) == 9
