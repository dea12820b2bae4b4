"""Claims about LLFF scenes: cameras from poses_bounds.npy, pictures by order, in images/ or shrunk in images_N/."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from simscenes import load_set
from simscenes.sets.pictures.png import write_png
from tests.miniatures import HEIGHT, RIG, VIEWS, WIDTH, colmap, dark_picture, poses_bounds


def scene(folder: Path, pictures: str = "images", *, scale: float = 1.0) -> Path:
    for i in range(VIEWS):
        write_png(folder / pictures / f"b{i}.png", dark_picture(i))
    poses_bounds(folder / "poses_bounds.npy", RIG, scale)
    return folder


def test_cameras_are_the_true_ones_in_opencv_axes(tmp_path: Path) -> None:
    views = load_set(scene(tmp_path))
    assert np.abs(views.rig.viewmats - RIG.viewmats).max() < 1e-12
    assert np.abs(views.rig.Ks - RIG.Ks).max() < 1e-12
    np.testing.assert_array_equal(views.image(4), dark_picture(4))
    assert views.test_indices == [0, 8]


def test_intrinsics_follow_pictures_that_were_shrunk_and_the_largest_are_taken(tmp_path: Path) -> None:
    """Rationale: the file states the cameras of pictures four times as large, of which only images_4/ is left."""
    folder = scene(tmp_path, "images_4", scale=4.0)
    write_png(folder / "images_8" / "b0.png", dark_picture(0)[::2, ::2])
    views = load_set(folder)
    assert (views.rig.width, views.rig.height) == (WIDTH, HEIGHT)
    assert np.abs(views.rig.Ks - RIG.Ks).max() < 1e-12


def test_a_colmap_model_finds_its_shrunk_and_renumbered_pictures_by_order(tmp_path: Path) -> None:
    """Rationale: LLFF calls what it shrinks image000.png and so on. A model's own order is not that of its names."""
    names = [f"DSC{90 + i}.png" for i in range(VIEWS)]
    colmap(tmp_path / "sparse" / "0", names, RIG)
    for i in range(VIEWS):
        write_png(tmp_path / "images_2" / f"image{i:03d}.png", dark_picture(i)[::2, ::2])
    with pytest.warns(UserWarning, match="other names than the images of .* order, DSC90.png with image000.png and so"):
        views = load_set(tmp_path)
    np.testing.assert_array_equal(views.image(5), dark_picture(5)[::2, ::2])
    assert np.abs(views.rig.viewmats - RIG.viewmats).max() < 1e-9
    assert np.abs(views.rig.Ks[:, :2] - RIG.Ks[:, :2] / 2).max() < 1e-9
    points = views.points()
    assert points is not None
    np.testing.assert_allclose(np.sort(points.xyz, 0), np.sort(np.eye(3) / 10, 0), atol=1e-12)
    (tmp_path / "images_2" / "image008.png").unlink()
    with pytest.raises(ValueError, match="none of the 9 images listed in .* exists"):
        load_set(tmp_path)
    shutil.move(tmp_path / "images_2", tmp_path / "images")
    write_png(tmp_path / "images" / "image008.png", dark_picture(8))
    with pytest.raises(ValueError, match="none of the 9 images listed in .* exists"):
        load_set(tmp_path)  # in images/ names are what the model says


def test_shrunk_pictures_are_not_paired_by_order_where_names_have_two(tmp_path: Path) -> None:
    """Rationale: numbered in the order of taking, 0000.png is of IMG_4, and by letters of IMG_10."""
    colmap(tmp_path / "sparse" / "0", sorted(f"IMG_{4 + i}.png" for i in range(VIEWS)), RIG)
    for i in range(VIEWS):
        write_png(tmp_path / "images_2" / f"{i:04d}.png", dark_picture(i)[::2, ::2])
    with pytest.raises(
        ValueError, match=r"images_2: .* the image IMG_10.png: 0000.png by their letters, 0006.png by the"
    ):
        load_set(tmp_path)


def spoilt(rows: np.ndarray, at: tuple[int, int], value: float) -> np.ndarray:
    rows[at] = value
    return rows


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda rows: rows[:-1], "has 8 cameras and .*images 9 pictures .b0.png, .* one picture for each camera"),
        (lambda rows: rows[:, :15], r"must hold 17 numbers for each camera, got float64 \[9, 15\]"),
        (lambda rows: spoilt(rows, (3, 0), 7.0), "the pose of camera 3 must be a rotation"),
        (lambda rows: spoilt(rows, (2, 3), np.nan), "the pose of camera 2 must be finite"),
        (lambda rows: spoilt(rows, (1, 14), 0.0), "focal length of camera 1 must lie between 0 and 1e7 px"),
        (lambda rows: spoilt(rows, (1, 9), 2 * WIDTH), "another shape; they do not belong together"),
    ],
)
def test_what_cannot_be_cameras_of_these_pictures_is_refused(spoil, message: str, tmp_path: Path) -> None:
    path = scene(tmp_path) / "poses_bounds.npy"
    np.save(path, spoil(np.load(path)))
    with pytest.raises(ValueError, match=message):
        load_set(tmp_path)


def test_a_damaged_file_is_refused_by_name(tmp_path: Path) -> None:
    path = scene(tmp_path) / "poses_bounds.npy"
    whole = path.read_bytes()
    absurd = whole.replace(b"(9, 17), }" + 9 * b" ", b"(9000000000, 17), }")
    assert len(absurd) == len(whole)
    assert absurd != whole
    for content in (b"", whole[:40], whole[:-100], b"no array", absurd):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="poses_bounds.npy"):
            load_set(tmp_path)
