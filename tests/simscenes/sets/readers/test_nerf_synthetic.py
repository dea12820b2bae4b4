"""Claims about the layout of the NeRF-synthetic scenes as an input, our own exports read back included."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simscenes import load_set, orbit_rig
from simscenes.rigs import opencv_to_opengl
from simscenes.sets.pictures.png import write_png
from simscenes.sets.writers.camera_files import write_cameras
from simscenes.sets.writers.export import export_blender

WIDTH, HEIGHT, ANGLE = 24, 18, 0.6911112070083618  # of the original's cameras


def layout(folder: Path, parts: dict[str, int]) -> Path:
    """A folder as the original is: r_0, r_1, ... in every part, RGBA, without suffixes in the camera files."""
    poses = opencv_to_opengl(orbit_rig(sum(parts.values()), WIDTH, HEIGHT, 40.0, radius=4.0).viewmats)
    rng = np.random.default_rng(0)
    for part, count in parts.items():
        (folder / part).mkdir(parents=True)
        mine, poses = poses[:count], poses[count:]
        frames = [
            {"file_path": f"./{part}/r_{i}", "rotation": 0.01, "transform_matrix": pose.tolist()}
            for i, pose in enumerate(mine)
        ]
        for i in range(count):
            rgba = rng.integers(0, 255, (HEIGHT, WIDTH, 4), np.uint8)
            Image.fromarray(rgba).save(folder / part / f"r_{i}.png")
        Image.new("RGB", (WIDTH, HEIGHT)).save(folder / part / "r_0_depth_0001.png")
        content = {"camera_angle_x": ANGLE, "frames": frames}
        (folder / f"transforms_{part}.json").write_text(json.dumps(content))
    return folder


def test_the_split_of_the_folder_is_kept_and_validation_views_stay_out(tmp_path: Path) -> None:
    views = load_set(layout(tmp_path / "lego", {"train": 11, "val": 2, "test": 5}))
    assert len(views) == 16
    assert {views.files[i].parent.name for i in views.test_indices} == {"test"}
    assert {views.files[i].parent.name for i in views.train_indices} == {"train"}
    assert (len(views.test_indices), len(views.train_indices)) == (5, 11)
    assert views.names[views.test_indices[0]] == "test_r_0"
    assert views.unregistered == ()
    assert views.rig.Ks[3].diagonal()[:2] == pytest.approx(WIDTH / 2 / np.tan(ANGLE / 2))
    assert views.rig.Ks[3][:2, 2].tolist() == [WIDTH / 2, HEIGHT / 2]
    frame = json.loads((tmp_path / "lego" / "transforms_train.json").read_text())["frames"][10]
    place = views.names.index("train_r_10")
    centre = np.linalg.inv(views.rig.viewmats[place])[:3, 3]
    np.testing.assert_allclose(centre, np.array(frame["transform_matrix"])[:3, 3], atol=1e-9)


def test_without_test_views_the_validation_views_are_held_out_and_without_both_every_eighth(tmp_path: Path) -> None:
    views = load_set(layout(tmp_path / "a", {"train": 9, "val": 2}))
    assert {views.files[i].parent.name for i in views.test_indices} == {"val"}
    assert load_set(layout(tmp_path / "b", {"train": 9})).test_indices == [0, 8]


def test_transparent_pixels_are_before_white(tmp_path: Path) -> None:
    views = load_set(layout(tmp_path / "lego", {"train": 3, "test": 1}))
    assert views.transparent
    rgba = np.asarray(Image.open(views.files[0]), np.float64)
    alpha = rgba[..., 3:] / 255
    np.testing.assert_allclose(views.image(0), rgba[..., :3] * alpha + 255 * (1 - alpha), atol=0.51)


def test_a_file_of_both_parts_is_refused(tmp_path: Path) -> None:
    folder = layout(tmp_path / "lego", {"train": 3, "test": 1})
    content = json.loads((folder / "transforms_train.json").read_text())
    content["frames"][0]["file_path"] = "test/r_0"
    (folder / "transforms_train.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match="lists .*r_0.png 2 times"):
        load_set(folder)


def own_set(folder: Path, held_out: list[int] | None = None) -> Path:
    names, rng = [f"{i:04d}" for i in range(10)], np.random.default_rng(0)
    for name in names:
        write_png(folder / "images" / f"{name}.png", rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8))
    write_cameras(folder, names, orbit_rig(10, WIDTH, HEIGHT, 40.0, radius=4.0), held_out=held_out)
    return folder


def test_our_own_export_is_read_back(tmp_path: Path) -> None:
    before = load_set(own_set(tmp_path / "set", [1, 4]))
    with pytest.warns(UserWarning, match="keeps the world unchanged"):  # it has neither depth nor points
        after = load_set(export_blender(before, tmp_path / "blender"))
    assert after.names == before.names
    assert after.test_indices == before.test_indices == [1, 4]
    np.testing.assert_allclose(after.rig.Ks, before.rig.Ks, rtol=1e-9)
    # The layout may scale and move the scene: cameras are the same up to one factor and one shift.
    a, b = (np.linalg.inv(views.rig.viewmats) for views in (before, after))
    np.testing.assert_allclose(b[:, :3, :3], a[:, :3, :3], atol=1e-9)
    steps = [np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) for poses in (a, b)]
    np.testing.assert_allclose(steps[1] / steps[1][0], steps[0] / steps[0][0], rtol=1e-6)
    for i in range(10):
        np.testing.assert_array_equal(after.image(i), before.image(i))


def test_the_split_of_a_transforms_file_is_kept(tmp_path: Path) -> None:
    folder = own_set(tmp_path / "set", [2, 3, 9])
    assert load_set(folder).test_indices == [2, 3, 9]
    assert (folder / "test_list.txt").read_text().split() == ["0002.png", "0003.png", "0009.png"]
    content = json.loads((folder / "transforms.json").read_text())
    content["train_filenames"] = content["test_filenames"] = []
    content["val_filenames"] = ["images/0005.png"]
    (folder / "transforms.json").write_text(json.dumps(content))
    assert load_set(folder).test_indices == [5]
    content["val_filenames"] = [frame["file_path"] for frame in content["frames"]]
    (folder / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match="holds every image out for testing"):
        load_set(folder)


def test_pictures_without_cameras_are_counted_and_a_folder_of_them_says_what_to_do(tmp_path: Path) -> None:
    folder = own_set(tmp_path / "set")
    write_png(folder / "images" / "stray.png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    assert load_set(folder).unregistered == ("images/stray.png",)
    with pytest.raises(ValueError, match=r"images holds 11 pictures without camera poses: .*novags poses .* --out SET"):
        load_set(folder / "images")
