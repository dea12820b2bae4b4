"""Claims about the split that a transforms.json states: it decides, and what is in none of its lists is left out."""

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import load_set, orbit_rig
from simscenes.rigs import opencv_to_opengl
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.photographs import names_for_testing, transforms_frames
from simscenes.sets.readers.split import places_of, split_of
from simscenes.sets.writers.camera_files import write_cameras

VIEWS, SIZE = 10, 16
RIG = orbit_rig(VIEWS, SIZE, SIZE, 50.0, radius=3.0)
NAMES = [f"images/{i}.png" for i in range(VIEWS)]


def folder_of(folder: Path, *, missing: tuple[int, ...] = (), **more: Any) -> Path:
    """Ten pictures whose camera file lists them by `NAMES`."""
    for i in set(range(VIEWS)) - set(missing):
        write_png(folder / NAMES[i], np.full((SIZE, SIZE, 3), 10 * i, np.uint8))
    poses = opencv_to_opengl(RIG.viewmats)
    frames = [{"file_path": n, "transform_matrix": p.tolist()} for n, p in zip(NAMES, poses, strict=True)]
    (folder / "transforms.json").write_text(json.dumps({"fl_x": 15.0, "frames": frames, **more}))
    return folder


def listed(*places: int) -> list[str]:
    return [NAMES[i] for i in places]


def opened(folder: Path) -> tuple[MultiviewSet, list[str]]:
    """The set, and what is warned of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        views = load_set(folder)
    return views, [str(warning.message).replace(f"{folder}/", "") for warning in caught]


def parts(views: MultiviewSet) -> tuple[list[str], list[str]]:
    """Names of the views for training and for testing."""
    return [views.names[i] for i in views.train_indices], [views.names[i] for i in views.test_indices]


def test_training_and_test_lists_decide_and_the_rest_is_left_out_by_name(tmp_path: Path) -> None:
    more = {"train_filenames": listed(0, 1, 2, 3, 4), "val_filenames": listed(5), "test_filenames": listed(6, 7)}
    views, said = opened(folder_of(tmp_path, **more))
    assert parts(views) == (["0", "1", "2", "3", "4"], ["6", "7"])
    assert said == [
        "load_set: 3 of 10 frames of transforms.json are left out, as neither train_filenames nor test_filenames names "
        "them: images/5.png, images/8.png, images/9.png"
    ]
    assert views.unregistered == ()  # they have cameras
    assert [int(views.image(i)[0, 0, 0]) for i in range(7)] == [0, 10, 20, 30, 40, 60, 70]
    assert np.abs(views.rig.viewmats - RIG.viewmats[[0, 1, 2, 3, 4, 6, 7]]).max() < 1e-12


def test_what_a_training_list_lacks_is_held_out_where_there_is_no_other_list(tmp_path: Path) -> None:
    views, said = opened(folder_of(tmp_path, train_filenames=listed(0, 1, 2, 3, 4, 5), test_filenames=[]))
    assert parts(views) == (["0", "1", "2", "3", "4", "5"], ["6", "7", "8", "9"])
    assert said == []


def test_a_validation_list_tests_only_where_there_is_no_test_list_and_is_never_trained_on(tmp_path: Path) -> None:
    views, said = opened(folder_of(tmp_path / "a", val_filenames=listed(2, 9)))
    assert parts(views) == (["0", "1", "3", "4", "5", "6", "7", "8"], ["2", "9"])
    assert said == []
    views, said = opened(folder_of(tmp_path / "b", val_filenames=listed(2, 3, 9), test_filenames=listed(9)))
    assert parts(views) == (["0", "1", "4", "5", "6", "7", "8"], ["9"])
    assert said == ["load_set: 2 of 10 frames of transforms.json are left out, as val_filenames alone names them: "
                    "images/2.png, images/3.png"]  # fmt: skip
    views, said = opened(folder_of(tmp_path / "c", train_filenames=listed(*range(8)), val_filenames=listed(8, 9)))
    assert parts(views) == ([str(i) for i in range(8)], ["8", "9"])
    assert said == []


def test_a_view_of_both_lists_is_held_out_and_said(tmp_path: Path) -> None:
    views, said = opened(folder_of(tmp_path, train_filenames=listed(*range(9)), test_filenames=listed(8, 9)))
    assert parts(views) == ([str(i) for i in range(8)], ["8", "9"])
    assert said == ["load_set: transforms.json lists 1 of 10 frames for training and for testing (images/8.png): they "
                    "are held out"]  # fmt: skip


def test_each_of_several_warnings_is_given(tmp_path: Path) -> None:
    lists = {"train_filenames": listed(*range(8)), "test_filenames": listed(7, 8)}
    folder = folder_of(tmp_path, **lists)
    content = json.loads((folder / "transforms.json").read_text())
    content["frames"][3]["mask_path"] = "mask.png"
    (folder / "transforms.json").write_text(json.dumps(content))
    said = opened(folder)[1]
    assert len(said) == 3
    for part in ("images/9.png", "are held out", "have a mask"):
        assert sum(part in line for line in said) == 1


def test_where_every_view_is_for_training_every_8th_is_held_out_and_said(tmp_path: Path) -> None:
    views, said = opened(folder_of(tmp_path, train_filenames=NAMES))
    assert views.test_indices == [0, 8]
    assert said == ["load_set: transforms.json lists every frame in train_filenames and none for testing: every 8th is "
                    "held out; name others in test_filenames"]  # fmt: skip


@pytest.mark.parametrize("key", ["train_filenames", "val_filenames", "test_filenames"])
def test_a_list_that_names_no_frame_is_refused_and_lost_entries_are_named(key: str, tmp_path: Path) -> None:
    lost = ["images/97.png", "3.png"]
    with pytest.raises(
        ValueError,
        match=rf"{key} must name its frames, and none of 2 entries \(images/97.png, 3.png\) does: write them like "
        r"file_path \(images/0.png, ",
    ):
        load_set(folder_of(tmp_path / "a", **{key: lost}))
    _, said = opened(folder_of(tmp_path / "b", **{key: listed(*range(1, 7)) + lost}))
    assert said == [f"load_set: 2 of 8 entries of {key} in transforms.json name no frame: images/97.png, 3.png"]


def test_test_images_that_are_all_missing_are_no_reason_to_test_others(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, missing=(8, 9), test_filenames=listed(8, 9))
    with (
        pytest.warns(UserWarning, match="2 of 10 views listed in .* skipped: images/8.png, images/9.png"),
        pytest.raises(
            ValueError, match=r"none of the 2 images that .* holds out .* exists \(images/8.png, images/9.png\)"
        ),
    ):
        load_set(folder)


def test_entries_are_understood_as_file_path_is(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, missing=(4,))
    names = ["./images/0", "images/1.png", "images/2.JPG", "images\\3.png", "images/4.png", "images/4.jpg"]
    entries = ["images/0.png", "./images/1", "images/2", "images/./3.png", "./images/4", "images/4.jpg", "images/5",
               str(folder / "images" / "1.png"), "IMAGES/1.PNG"]  # fmt: skip
    assert places_of(entries, names, folder) == [[0], [1], [2], [3], [4], [5], [], [1], [1]]


def test_frames_that_are_left_out_are_no_frames_to_other_readers(tmp_path: Path) -> None:
    """Rationale: raw files beside a transforms.json are read by a reader of their own."""
    source = folder_of(tmp_path, train_filenames=listed(1, 2), test_filenames=["./images/7"]) / "transforms.json"
    with pytest.warns(UserWarning, match="7 of 10 frames"):
        assert [frame.file_path for frame in transforms_frames(source)[0]] == listed(1, 2, 7)
    assert names_for_testing(source) == listed(7)


def test_our_own_sets_are_read_without_a_word(tmp_path: Path) -> None:
    for held_out, expected in ((None, [0, 8]), ([2, 3, 9], [2, 3, 9])):
        folder = folder_of(tmp_path / str(held_out))
        write_cameras(folder, [str(i) for i in range(VIEWS)], RIG, held_out=held_out)
        views, said = opened(folder)
        assert (views.test_indices, len(views), said) == (expected, VIEWS, [])


def test_the_same_text_counts_before_the_same_path_and_that_before_another_suffix(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        write_png(tmp_path / name, np.zeros((SIZE, SIZE, 3), np.uint8))
    assert places_of(["./a.png", "a.png"], ["a.png", "./a.png"], tmp_path) == [[1], [0]]
    assert places_of(["./b.png"], ["b", "b.png"], tmp_path) == [[1]]
    assert places_of(["./lost.jpg"], ["b.png", "lost"], tmp_path) == [[1]]


def test_a_list_means_every_frame_of_the_name_that_it_has() -> None:
    content = {"frames": [{"file_path": name} for name in ("a.png", "b.png", "a.png", "c.png")],
               "train_filenames": ["b.png"], "test_filenames": ["a.png", "c.png"]}  # fmt: skip
    found = split_of(content, Path("transforms.json"))
    assert found is not None
    assert (found.train, found.test) == ({1}, {0, 2, 3})
