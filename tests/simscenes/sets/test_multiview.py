"""Set folders: what is written is what COLMAP and we read, and foreign folders are read right or refused."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from simscenes import load_set, orbit_rig, write_cameras
from simscenes.rigs import Rig, intrinsics, opencv_to_opengl
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.pictures.exr import write_exr


def make_images(folder: Path, names: list[str], width: int, height: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for k, name in enumerate(names):
        cv2.imwrite(str(folder / name), np.full((height, width, 3), 10 * k, np.uint8))


def small_rig(n_views: int = 10) -> Rig:
    return orbit_rig(n_views, 40, 30, 55, target=(0.1, 0.2, 0.3), radius=2.0)


def transforms(folder: Path, rig: Rig, names: list[str], **more: object) -> Path:
    frames = [
        {"file_path": n, "transform_matrix": m.tolist()}
        for n, m in zip(names, opencv_to_opengl(rig.viewmats), strict=True)
    ]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "transforms.json").write_text(json.dumps({"frames": frames, **more}))
    return folder


@pytest.fixture
def written(tmp_path: Path) -> tuple[Path, Rig, list[str], np.ndarray]:
    rig, names = small_rig(), [f"{k:04d}" for k in range(10)]
    rng = np.random.default_rng(0)
    xyz = rng.normal(0, 0.3, (50, 3)) + [0.1, 0.2, 0.3]
    visible = rng.random((10, 50)) < 0.5
    points = SparsePoints.seen(rig, xyz, rng.integers(0, 256, (50, 3), dtype=np.uint8), visible, exact=True)
    write_cameras(tmp_path, names, rig, points=points)
    make_images(tmp_path / "images", [f"{n}.png" for n in names], 40, 30)
    return tmp_path, rig, names, visible


def test_pycolmap_reads_the_folder_with_exact_reprojection(written: tuple) -> None:
    folder, rig, names, visible = written
    model = pycolmap.Reconstruction(str(folder / "sparse" / "0"))
    assert sorted(i.name for i in model.images.values()) == [f"{n}.png" for n in names]
    assert len(model.points3D) == 50
    errors = []
    for image in model.images.values():
        for point2d in image.points2D:
            projected = image.project_point(model.points3D[point2d.point3D_id].xyz)
            errors.append(np.abs(projected - point2d.xy).max())
    assert len(errors) > 200
    assert max(errors) < 1e-4
    tracks = {tuple(np.round(p.xyz, 9)): p.track.length() for p in model.points3D.values()}
    assert max(tracks.values()) <= visible.sum(0).max()


def test_every_view_that_has_another_name_than_its_file_is_told_with_the_file(written: tuple) -> None:
    views = load_set(written[0])
    files = [file if k in (1, 3) else file.with_stem(f"odd {k}") for k, file in enumerate(views.files)]
    found = replace(views, files=tuple(files)).renamed
    assert found == {name: f"images/odd {k}.png" for k, name in enumerate(views.names) if k not in (1, 3)}


def test_written_cameras_come_back_exactly(written: tuple) -> None:
    folder, rig, names, _ = written
    loaded = load_set(folder)
    assert loaded.names == tuple(names)
    assert (loaded.kind, loaded.meta) == ("photographs", {})
    assert np.allclose(loaded.rig.viewmats, rig.viewmats, rtol=0, atol=1e-12)
    assert np.array_equal(loaded.rig.Ks, rig.Ks)
    assert loaded.test_indices == [0, 8]
    assert loaded.train_indices == [1, 2, 3, 4, 5, 6, 7, 9]
    for split in ("test", "val"):  # nerfstudio's reader of COLMAP models fails where val is missing
        assert (folder / f"{split}_list.txt").read_text().split() == ["0000.png", "0008.png"]
    assert (folder / "train_list.txt").read_text().split() == [f"000{i}.png" for i in (1, 2, 3, 4, 5, 6, 7, 9)]
    points = loaded.points()
    assert points is not None
    assert (points.xyz.shape, points.rgb.dtype) == ((50, 3), np.uint8)
    assert loaded.geometry(0) is None
    assert (loaded.image(3) == 30).all()


def test_a_pure_colmap_folder_gives_the_same_rig(written: tuple) -> None:
    folder, rig, names, _ = written
    (folder / "transforms.json").unlink()
    loaded = load_set(folder)
    assert loaded.names == tuple(names)
    assert np.allclose(loaded.rig.viewmats, rig.viewmats, rtol=0, atol=1e-12)
    assert np.allclose(loaded.rig.Ks, rig.Ks)
    assert loaded.points() is not None


def test_writing_again_replaces_and_leaves_nothing_behind(written: tuple) -> None:
    folder, rig, names, _ = written
    before = sorted(p.relative_to(folder) for p in folder.rglob("*"))
    write_cameras(folder, names, rig)
    before.remove(Path("points3D.ply"))  # not written without points
    assert sorted(p.relative_to(folder) for p in folder.rglob("*")) == before
    assert load_set(folder).points() is None


def test_cameras_that_differ_keep_their_own_intrinsics(tmp_path: Path) -> None:
    rig = small_rig(3)
    Ks = rig.Ks * np.array([1.0, 1.1, 1.2])[:, None, None]
    Ks[:, 2, 2] = 1
    other = Rig(viewmats=rig.viewmats, Ks=Ks, width=40, height=30)
    write_cameras(tmp_path, ["a", "b", "c"], other)
    make_images(tmp_path / "images", ["a.png", "b.png", "c.png"], 40, 30)
    assert np.array_equal(load_set(tmp_path).rig.Ks, Ks)
    (tmp_path / "transforms.json").unlink()
    assert np.allclose(load_set(tmp_path).rig.Ks, Ks)


def test_unsorted_names_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="sorted"):
        write_cameras(tmp_path, ["b", "a"], small_rig(2))


def test_fox_photographs_load_undistorted_with_one_warning(fox: Path) -> None:
    with pytest.warns(UserWarning, match="17 of 67") as caught:
        views = load_set(fox)
    assert len(caught) == 1
    assert (len(views), views.kind, views.meta, views.points()) == (50, "photographs", {}, None)
    assert (views.rig.width, views.rig.height) == (270, 480)
    assert views.image(0).shape == (480, 270, 3)
    assert views.image(0).min(-1).max() > 100
    assert views.radiance(0).max() <= 1
    centre = views.rig.positions.mean(0)
    forward = views.rig.viewmats[:, 2, :3]
    assert (np.einsum("cj,cj->c", forward, views.rig.positions - centre) < 0).mean() > 0.5  # they look inwards


@pytest.mark.parametrize("listed", [False, True])
def test_distortion_is_removed_with_pixel_centres_at_one_half(tmp_path: Path, listed: bool) -> None:
    """Blobs painted where the distorted lens sees world points must appear where the pinhole projects them."""
    width, height = 120, 90
    K = np.array([[110.0, 0, 57.0], [0, 108.0, 47.0], [0, 0, 1]])
    k1, k2, p1, p2 = 0.12, -0.05, 0.004, -0.003
    rig = Rig(viewmats=np.eye(4)[None], Ks=K[None], width=width, height=height)
    points = np.array([[-0.3, -0.2, 1.0], [0.35, 0.25, 1.0], [0.02, 0.3, 1.0], [0.4, -0.3, 1.0]])
    seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array([k1, k2, p1, p2]))
    y, x = np.mgrid[:height, :width] + 0.5  # K counts pixel centres at +0.5
    canvas = sum(np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 1.5**2)) for u, v in seen[:, 0])
    cv2.imwrite(str(tmp_path / "a.png"), np.repeat(np.uint8(250 * canvas)[..., None], 3, -1))
    lens = {"fl_x": 110.0, "fl_y": 108.0, "cx": 57.0, "cy": 47.0, "w": width, "h": height}
    terms = {"distortion_params": [k1, k2, 0, 0, p1, p2]} if listed else {"k1": k1, "k2": k2, "p1": p1, "p2": p2}
    transforms(tmp_path, rig, ["a.png"], **lens, **terms, camera_model="opencv" if listed else "OPENCV")
    loaded = load_set(tmp_path)
    image = loaded.image(0)[..., 0].astype(float)
    expected, _ = loaded.rig.project(points)
    for u, v in expected[0]:
        near = image * (np.hypot(x - u, y - v) < 5)
        centroid = np.array([(x * near).sum(), (y * near).sum()]) / near.sum()
        assert np.abs(centroid - (u, v)).max() < 0.08  # half a pixel of confusion would be 0.5


def test_shrunken_images_bring_their_intrinsics_along(tmp_path: Path) -> None:
    rig = small_rig(2)
    transforms(tmp_path, rig, ["a.png", "b.png"], fl_x=80.0, cx=41.0, cy=29.0, w=80, h=60)
    make_images(tmp_path, ["a.png", "b.png"], 40, 30)
    assert np.allclose(load_set(tmp_path).rig.Ks[0], [[40, 0, 20.5], [0, 40, 14.5], [0, 0, 1]])


def test_blender_style_names_and_angles_are_understood(tmp_path: Path) -> None:
    transforms(tmp_path, small_rig(2), ["./train/r_0", "./train/r_1"], camera_angle_x=np.radians(55))
    make_images(tmp_path / "train", ["r_0.png", "r_1.png"], 40, 30)
    loaded = load_set(tmp_path)
    assert loaded.names == ("r_0", "r_1")
    assert np.allclose(loaded.rig.Ks[0], intrinsics(40, 30, 55))


def test_photographs_that_share_a_stem_are_named_alike_wherever_their_folder_is(tmp_path: Path) -> None:
    names = [f"cam{k % 2}/{k // 2}.png" for k in range(4)]
    folder = transforms(tmp_path / "here", small_rig(4), names, camera_angle_x=0.9)
    for part in ("cam0", "cam1"):
        (folder / part).mkdir()
    make_images(folder, names, 40, 30)
    first = load_set(folder).names
    assert first == ("cam0_0", "cam0_1", "cam1_0", "cam1_1")
    (tmp_path / "link").symlink_to(folder)
    assert load_set(tmp_path / "link").names == first
    folder.rename(tmp_path / "there")
    assert load_set(tmp_path / "there").names == first


def broken_json(folder: Path) -> None:
    (folder / "transforms.json").write_text('{"frames": [')


def no_frames(folder: Path) -> None:
    (folder / "transforms.json").write_text('{"fl_x": 3}')


def no_images(folder: Path) -> None:
    transforms(folder, small_rig(2), ["a.png", "b.png"], fl_x=30)


def two_sizes(folder: Path) -> None:
    no_images(folder)
    make_images(folder, ["a.png"], 40, 30)
    make_images(folder, ["b.png"], 41, 30)


def text_as_image(folder: Path) -> None:
    no_images(folder)
    for name in ("a.png", "b.png"):
        (folder / name).write_text("not an image")


def fisheye(folder: Path) -> None:
    transforms(folder, small_rig(1), ["a.png"], fl_x=30, camera_model="OPENCV_FISHEYE")
    make_images(folder, ["a.png"], 40, 30)


def listed_fisheye(folder: Path) -> None:
    transforms(folder, small_rig(1), ["a.png"], fl_x=30, distortion_params=[0.1, 0, 0, 0.2, 0, 0])
    make_images(folder, ["a.png"], 40, 30)


def short_list(folder: Path) -> None:
    transforms(folder, small_rig(1), ["a.png"], fl_x=30, distortion_params=[0.1, 0, 0, 0])
    make_images(folder, ["a.png"], 40, 30)


def no_focal(folder: Path) -> None:
    transforms(folder, small_rig(1), ["a.png"])
    make_images(folder, ["a.png"], 40, 30)


def other_shape(folder: Path) -> None:
    transforms(folder, small_rig(1), ["a.png"], fl_x=30, w=80, h=80)
    make_images(folder, ["a.png"], 40, 30)


def scaled_pose(folder: Path) -> None:
    no_images(folder)
    make_images(folder, ["a.png", "b.png"], 40, 30)
    text = json.loads((folder / "transforms.json").read_text())
    text["frames"][0]["transform_matrix"][0][0] = 7.0
    (folder / "transforms.json").write_text(json.dumps(text))


def unfinished(folder: Path) -> None:
    (folder / "gt").mkdir()


def empty(folder: Path) -> None:
    del folder


def cut_model(folder: Path) -> None:
    (folder / "sparse" / "0").mkdir(parents=True)
    (folder / "sparse" / "0" / "cameras.bin").write_bytes(b"\x01")


@pytest.mark.parametrize(
    ("breakage", "message"),
    [
        (broken_json, "not valid JSON"), (no_frames, "frames"), (no_images, "none of the 2 images"),
        (two_sizes, "one size"), (text_as_image, "not a readable image"), (fisheye, "FISHEYE"), (no_focal, "fl_x"),
        (other_shape, "another shape"), (scaled_pose, "rotation"), (unfinished, "unfinished"), (empty, "holds no"),
        (cut_model, "COLMAP"), (listed_fisheye, "k4 = 0.2"), (short_list, "distortion_params"),
    ],
)  # fmt: skip
def test_broken_folders_are_refused_with_the_reason(breakage, message: str, tmp_path: Path) -> None:
    breakage(tmp_path)
    with pytest.raises(ValueError, match=message):
        load_set(tmp_path)


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such folder"):
        load_set(tmp_path / "nothing")


def test_missing_views_are_skipped_and_counted_once(tmp_path: Path) -> None:
    rig = small_rig(3)
    transforms(tmp_path, rig, ["c.png", "a.png", "b.png"], fl_x=30)
    make_images(tmp_path, ["a.png", "c.png"], 40, 30)
    with pytest.warns(UserWarning, match="1 of 3") as caught:
        loaded = load_set(tmp_path)
    assert len(caught) == 1
    assert loaded.names == ("a", "c")
    assert np.allclose(loaded.rig.viewmats, rig.viewmats[[1, 0]])


@pytest.mark.parametrize("clear", ["a.png", "c.png"])
def test_one_photograph_that_can_be_transparent_and_one_lens_that_distorts_are_enough(
    clear: str, tmp_path: Path
) -> None:
    rig, names = small_rig(3), ["a.png", "b.png", "c.png"]
    make_images(tmp_path, names, 40, 30)
    transforms(tmp_path, rig, names, fl_x=30.0)
    plain = load_set(tmp_path)
    assert (plain.transparent, plain.lenses) == (False, None)
    cv2.imwrite(str(tmp_path / clear), np.full((30, 40, 4), 90, np.uint8))
    content = json.loads((tmp_path / "transforms.json").read_text())
    content["frames"][1]["k1"] = 0.02
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    views = load_set(tmp_path)
    assert views.transparent
    assert views.lenses is not None
    assert [lens.distortion[0] for lens in views.lenses] == [0, 0.02, 0]


def test_pictures_without_a_camera_are_found_beside_those_of_every_folder(tmp_path: Path) -> None:
    """Of each kind that some picture with a camera has."""
    rig, names = small_rig(2), ["one/a.png", "two/a.jpg"]
    for folder, own in (("one", "a.png"), ("two", "a.jpg")):
        make_images(tmp_path / folder, [own, f"left_{folder}.png", f"left_{folder}.jpg", f"{folder}.bmp"], 40, 30)
    transforms(tmp_path, rig, names, fl_x=30.0)
    left = [f"{folder}/left_{folder}.{kind}" for folder in ("one", "two") for kind in ("jpg", "png")]
    assert load_set(tmp_path).unregistered == tuple(left)


def test_light_of_a_rendered_view_has_all_its_colours(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    light = {name: rng.uniform(size=(30, 40)).astype(np.float32) for name in "RGB"}
    (tmp_path / "gt").mkdir()
    write_exr(tmp_path / "gt" / "a.exr", light)
    views = MultiviewSet(path=tmp_path, names=("a",), rig=small_rig(1), kind="rendered", meta={}, files=())
    np.testing.assert_array_equal(views.radiance(0), np.stack([light[name] for name in "RGB"], -1))
    write_exr(tmp_path / "gt" / "a.exr", {"R": light["R"], "B": light["B"]})
    with pytest.raises(ValueError, match="lacks the channels G: render the set again"):
        views.radiance(0)
