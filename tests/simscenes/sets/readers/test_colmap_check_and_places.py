"""Claims about which COLMAP model of a folder is read, and about files of points that are damaged or not there."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest

from simscenes import SparsePoints, load_set, orbit_rig, write_cameras
from simscenes.rigs import Rig
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.colmap import find_colmap, read_points
from simscenes.sets.readers.colmap_check import check_model, count_images
from tests.miniatures import RIG, VIEWS, colmap, dark_picture

NAMES = [f"{i}.png" for i in range(VIEWS)]


def pictures(folder: Path) -> Path:
    for i, name in enumerate(NAMES):
        write_png(folder / "images" / name, dark_picture(i))
    return folder


def piece(folder: Path, count: int) -> Path:
    """A model of the first images."""
    rig = Rig(viewmats=RIG.viewmats[:count], Ks=RIG.Ks[:count], width=RIG.width, height=RIG.height)
    return colmap(folder, NAMES[:count], rig)


def as_text(model: Path) -> Path:
    """The same model in text."""
    found = pycolmap.Reconstruction(str(model))
    shutil.rmtree(model)
    model.mkdir()
    found.write_text(str(model))
    return model


def test_of_several_models_the_largest_is_read_and_said(tmp_path: Path) -> None:
    sparse = pictures(tmp_path) / "sparse"
    for name, count in (("0", 3), ("1", 9), ("2", 5), ("10", 9)):
        piece(sparse / name, count)
    as_text(sparse / "1")
    (sparse / "20").mkdir()
    (sparse / "20" / "cameras.bin").write_bytes(b"")
    assert [count_images(sparse / name) for name in ("0", "1", "2", "10", "20")] == [3, 9, 5, 9, 0]
    with pytest.warns(
        UserWarning,
        match="of 5 COLMAP models in .*/sparse, 1 is taken: 0 has 3 images, 1 has 9 images, 2 has 5 images, 10 has 9 "
        "images, 20 has 0 images; the others have no part",
    ) as caught:
        views = load_set(tmp_path)
    assert (len(views), len(caught)) == (VIEWS, 1)
    assert views.model() == (tmp_path / "images", sparse / "1")
    assert views.unregistered == ()


def test_an_absurd_count_makes_no_model_the_largest(tmp_path: Path) -> None:
    sparse = pictures(tmp_path) / "sparse"
    piece(sparse / "0", 3)
    broken = piece(sparse / "1", 5) / "images.bin"
    broken.write_bytes(b"\xff" * 8 + broken.read_bytes()[8:])
    assert find_colmap(tmp_path) == sparse / "0"


def test_one_model_is_read_without_a_word_whatever_its_number(tmp_path: Path) -> None:
    piece(pictures(tmp_path) / "sparse" / "3", VIEWS)
    assert len(load_set(tmp_path)) == VIEWS


def test_masks_beside_the_pictures_are_said_not_to_be_used(tmp_path: Path) -> None:
    piece(pictures(tmp_path) / "sparse" / "0", VIEWS)
    (tmp_path / "masks").mkdir()
    load_set(tmp_path)
    write_png(tmp_path / "masks" / "0.png", dark_picture(0))
    with pytest.warns(UserWarning, match="masks is not used: all pixels count"):
        load_set(tmp_path)


def test_the_model_in_the_place_of_nerfstudio_is_found_beside_pictures_alone(tmp_path: Path) -> None:
    model = piece(tmp_path / "colmap" / "sparse" / "0", VIEWS)
    assert find_colmap(tmp_path) is None
    views = load_set(pictures(tmp_path))
    assert abs(views.rig.viewmats - RIG.viewmats).max() < 1e-9
    assert views.model() == (tmp_path / "images", model)
    assert find_colmap(piece(tmp_path / "sparse" / "0", 3).parents[1]) == tmp_path / "sparse" / "0"


@pytest.mark.parametrize("kind", ["bin", "txt"])
def test_a_model_without_a_file_of_points_is_one_of_no_points(kind: str, tmp_path: Path) -> None:
    model = piece(pictures(tmp_path) / "sparse" / "0", VIEWS)
    if kind == "txt":
        as_text(model)
    (model / f"points3D.{kind}").unlink()
    before = sorted(path.name for path in model.iterdir())
    views = load_set(tmp_path)
    assert abs(views.rig.viewmats - RIG.viewmats).max() < 1e-9
    assert views.points() is None
    assert sorted(path.name for path in model.iterdir()) == before


def test_a_text_model_with_a_part_missing_says_which(tmp_path: Path) -> None:
    model = as_text(piece(tmp_path / "model", VIEWS))
    for part in ("images", "points3D"):
        (model / f"{part}.txt").unlink()
    with pytest.raises(ValueError, match=r"lacks images\.txt; download"):
        check_model(model)


def test_images_that_show_points_need_the_file_of_points(tmp_path: Path) -> None:
    rig, names = orbit_rig(2, 40, 30, 55, radius=2.0), ["a", "b"]
    points = SparsePoints.seen(rig, np.zeros((1, 3)), np.zeros((1, 3)), np.ones((2, 1), bool), exact=True)
    write_cameras(tmp_path, names, rig, points=points)
    model = as_text(tmp_path / "sparse" / "0")
    (model / "points3D.txt").unlink()
    with pytest.raises(ValueError, match=r"images.txt: shows point \[\d+\] .* that points3D does not have; download"):
        check_model(model)


def test_byte_order_marks_in_a_text_model_change_nothing(tmp_path: Path) -> None:
    model = as_text(piece(pictures(tmp_path) / "sparse" / "0", VIEWS))
    before, points = load_set(tmp_path).rig, load_set(tmp_path).points()
    for file in model.iterdir():
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    views = load_set(tmp_path)
    np.testing.assert_array_equal(views.rig.viewmats, before.viewmats)
    marked = views.points()
    assert points is not None
    assert marked is not None
    np.testing.assert_array_equal(marked.xyz, points.xyz)


def camera_of(folder: Path, line: str) -> Path:
    """The model with one camera for all images."""
    model = as_text(piece(pictures(folder) / "sparse" / "0", VIEWS))
    (model / "cameras.txt").write_text(f"{line}\n")
    return folder


PARAMS = {"SIMPLE_RADIAL_FISHEYE": "30 16 12 0.1", "RADIAL_FISHEYE": "30 16 12 0.1 0", "FOV": "30 30 16 12 0.9",
          "OPENCV_FISHEYE": "30 30 16 12 0.1 0 0 0", "FULL_OPENCV": "30 30 16 12 0 0 0 0 0 0.1 0 0",
          "THIN_PRISM_FISHEYE": "30 30 16 12 0 0 0 0 0 0 0 0", "RAD_TAN_THIN_PRISM_FISHEYE": "30 30 16 12" + " 0" * 12,
          "SIMPLE_DIVISION": "30 16 12 -0.1", "DIVISION": "30 30 16 12 -0.1", "SIMPLE_FISHEYE": "30 16 12",
          "FISHEYE": "30 30 16 12", "EUCM": "30 30 16 12 0.5 1", "EQUIRECTANGULAR": "32 24"}  # fmt: skip


@pytest.mark.parametrize("kind", PARAMS)
def test_a_lens_of_colmap_that_is_no_pinhole_is_refused_by_name(kind: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"has a {kind} camera.*undistorter"):
        load_set(camera_of(tmp_path, f"1 {kind} 32 24 {PARAMS[kind]}"))


def test_a_full_model_without_rational_terms_is_read_as_what_it_is(tmp_path: Path) -> None:
    lenses = load_set(camera_of(tmp_path, "1 FULL_OPENCV 32 24 30 30 16 12 0.1 0.02 0.003 0.004 0.05 0 0 0")).lenses
    assert lenses is not None
    assert {lens.distortion for lens in lenses} == {(0.1, 0.02, 0.003, 0.004, 0.05)}


def test_a_lens_of_colmap_that_folds_its_picture_is_refused_with_the_share(tmp_path: Path) -> None:
    with pytest.raises(
        ValueError, match=r"sparse/0: the distortion of a lens \(k1 = -0.3\) turns 11 px .*belongs to no"
    ):
        load_set(camera_of(tmp_path, "1 SIMPLE_RADIAL 32 24 16 16 12 -0.3"))


@pytest.mark.parametrize("name", ["{0}_mask.png", "{0}.png.png", "{0}.mask.jpg"])
def test_masks_among_the_pictures_are_said_and_are_no_photographs_without_a_camera(name: str, tmp_path: Path) -> None:
    piece(pictures(tmp_path) / "sparse" / "0", VIEWS)
    for i in range(3):
        write_png(tmp_path / "images" / name.format(i), dark_picture(i))
    with pytest.warns(UserWarning, match=r"3 masks beside the pictures of .* are not used \(0.*: all pixels count"):
        views = load_set(tmp_path)
    assert (len(views), views.unregistered) == (VIEWS, ())


XYZ = np.array([[0.1, 0.0, 0.0], [0.0, 0.2, 0.1], [-0.1, 0.0, 0.3]])
RGB = np.array([[50, 100, 150], [150, 200, 250], [250, 0, 50]], np.uint8)


def with_tracks(folder: Path) -> Path:
    """A model of two images and three points that both show."""
    rig = orbit_rig(2, 40, 30, 55, radius=2.0)
    for i in range(2):
        write_png(folder / "images" / f"{i}.png", np.full((30, 40, 3), 90, np.uint8))
    points = SparsePoints.seen(rig, XYZ, RGB, np.ones((2, 3), bool), exact=True)
    write_cameras(folder, ["0", "1"], rig, points=points)
    return folder / "sparse" / "0"


@pytest.mark.parametrize("text", [False, True])
def test_all_points_of_a_model_are_read_with_their_colours_and_tracks(text: bool, tmp_path: Path) -> None:
    model = with_tracks(tmp_path)
    if text:
        as_text(model)
    assert sorted(check_model(model).names.values()) == ["0.png", "1.png"]
    files = [tmp_path / "images" / f"{i}.png" for i in range(2)]
    found = read_points(tmp_path / "images", model, files, orbit_rig(2, 40, 30, 55, radius=2.0))
    assert found is not None
    np.testing.assert_allclose(found.xyz, XYZ)
    np.testing.assert_array_equal(found.rgb, RGB)
    assert (len(found.error), len(found.view)) == (3, 6)


@pytest.mark.parametrize("number", ["1", "2"])
@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda words: words[:-1], "incomplete line"),
        (lambda words: [*words[:8], "9", *words[9:]], "image"),
        (lambda words: [words[0], "nan", *words[2:]], "points3D"),
        (lambda words: ["77", *words[1:]], "does not have|shows point"),
    ],
    ids=["cut short", "a track of no image", "nowhere", "another number"],
)
def test_the_second_point_of_a_text_model_is_checked_as_well_as_the_first(
    wrong: Any, said: str, number: str, tmp_path: Path
) -> None:
    file = as_text(with_tracks(tmp_path)) / "points3D.txt"
    lines = file.read_text().splitlines()
    (place,) = (i for i, line in enumerate(lines) if line.startswith(f"{number} "))
    lines[place] = " ".join(wrong(lines[place].split()))
    file.write_text("\n".join([*(line for line in lines if line.startswith("#")),
                               *sorted(line for line in lines if not line.startswith("#"))]) + "\n")  # fmt: skip
    with pytest.raises(ValueError, match=said):
        check_model(file.parent)
