"""Claims about published data sets: which folder is which, and that pictures, cameras and splits are right."""

import io
import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.importing.published.datasets import DATASETS, dataset_of, expected, scenes_below
from novags.testbed.importing.published.lom import open_scene
from novags.testbed.stages.configs.importing import ImportConfig
from simscenes.rigs import opencv_to_opengl
from simscenes.sets.pictures.png import read_png, write_png
from tests.miniatures import (
    FOV,
    HEIGHT,
    RIG,
    TEST,
    VIEWS,
    WIDTH,
    codes16,
    colmap,
    dark_picture,
    lit_picture,
    llnerf,
    llrs,
    lom,
    moved,
    mvtv,
    poses_bounds,
    write16,
)

QUIET = Console(quiet=True)


def brought(folder: Path, out: Path, console: Console = QUIET, **config: Any) -> Capture:
    stages.import_photographs(folder, out, ImportConfig(**config), console)
    return open_capture(out)


def lit_of(capture: Capture, i: int) -> np.ndarray:
    return np.round(255 * capture.source(QUIET).lit(i)).astype(np.uint8)


def assert_pairs(capture: Capture, views: list[int]) -> None:
    """Dark and lit pictures of all views, to the bit, and their cameras."""
    assert len(capture.names) == len(views)
    for place, i in enumerate(views):
        np.testing.assert_array_equal(np.round(255 * capture.srgb8(place)), dark_picture(i))
        np.testing.assert_array_equal(lit_of(capture, place), lit_picture(i))
    rig = capture.cameras.rig
    assert np.abs(rig.viewmats - RIG.viewmats[views]).max() < 1e-9
    assert np.abs(rig.Ks - RIG.Ks[views]).max() < 1e-9


def test_a_scene_of_lom_has_its_twins_its_cameras_and_its_split(tmp_path: Path) -> None:
    """Expectation: the view that is for validation alone stays out, as in the loaders of the authors."""
    stream = io.StringIO()
    capture = brought(lom(tmp_path / "buu"), tmp_path / "cap", Console(stream=stream))
    views = [i for i in range(VIEWS) if i != 7]
    assert_pairs(capture, views)
    assert [views[place] for place in capture.cameras.test_indices] == list(TEST)
    assert (capture.imported.dataset, capture.imported.split, capture.record.scene) == ("LOM", "own", "buu")
    assert capture.imported.lit == {"folder": "high", "paired": "names", "resampled": 0}
    assert "is taken for a scene of LOM" in stream.getvalue()


def test_every_8th_of_all_views_of_lom_is_held_out_on_request(tmp_path: Path) -> None:
    capture = brought(lom(tmp_path / "buu"), tmp_path / "cap", split="every8")
    assert_pairs(capture, list(range(VIEWS)))
    assert capture.cameras.test_indices == [0, 8]


def test_the_model_of_lom_gives_cameras_and_first_points_in_a_world_of_its_own(tmp_path: Path) -> None:
    rig = moved(RIG)
    capture = brought(lom(tmp_path / "buu", model=rig), tmp_path / "cap", split="every8")
    assert np.abs(capture.cameras.rig.viewmats - rig.viewmats).max() < 1e-9
    points = capture.cameras.points()
    assert points is not None
    np.testing.assert_allclose(np.sort(points.xyz, 0), np.sort(np.eye(3) / 10, 0), atol=1e-12)
    np.testing.assert_array_equal(lit_of(capture, 5), lit_picture(5))


def test_a_model_of_lom_that_lacks_a_view_is_left_aside_and_that_is_said(tmp_path: Path) -> None:
    folder, stream = lom(tmp_path / "buu"), io.StringIO()
    few = moved(RIG)
    few = type(few)(viewmats=few.viewmats[1:], Ks=few.Ks[1:], width=WIDTH, height=HEIGHT)
    colmap(folder / "colmap_sparse", [f"IMG_{20 + i}.png" for i in range(1, VIEWS)], few)
    capture = brought(folder, tmp_path / "cap", Console(stream=stream), split="every8")
    assert_pairs(capture, list(range(VIEWS)))
    assert "lacks 1 of 9 listed views (IMG_20): cameras are taken from transforms_train.json" in stream.getvalue()


def test_a_picture_listed_for_training_and_testing_is_held_out(tmp_path: Path) -> None:
    folder, stream = lom(tmp_path / "buu"), io.StringIO()
    test, train = (json.loads((folder / f"transforms_{part}.json").read_text()) for part in ("test", "train"))
    train["frames"].append(test["frames"][0])
    (folder / "transforms_train.json").write_text(json.dumps(train))
    capture = brought(folder, tmp_path / "cap", Console(stream=stream))
    assert [capture.names[i] for i in capture.cameras.test_indices] == ["IMG_22", "IMG_25"]
    assert "lists 1 pictures for training and for testing (IMG_22)" in stream.getvalue()


def test_llnerf_pairs_by_order_and_counts_pictures_that_have_no_camera(tmp_path: Path) -> None:
    """Rationale: a dark picture that COLMAP could not place would shift all pairs behind it."""
    folder = llnerf(tmp_path / "LLNeRF")
    capture = brought(folder, tmp_path / "cap")
    assert_pairs(capture, list(range(VIEWS)))
    assert capture.imported.dataset == "LLNeRF"
    assert capture.imported.lit["paired"] == "order"
    (folder / "poses_bounds.npy").unlink()
    views = [0, 1, 2, 4, 5, 6, 7, 8]
    rig = type(RIG)(viewmats=RIG.viewmats[views], Ks=RIG.Ks[views], width=WIDTH, height=HEIGHT)
    colmap(folder / "sparse" / "0", [f"DSC{1650 + 2 * i:05d}.png" for i in views], rig)
    assert_pairs(brought(folder, tmp_path / "placed"), views)


def test_llnerf_pairs_by_order_even_where_a_name_agrees(tmp_path: Path) -> None:
    folder = llnerf(tmp_path / "LLNeRF")
    lit = tmp_path / "LLNeRF" / "normal-light-scenes" / "still2"
    (lit / "DSC01701.png").rename(lit / "DSC01658.png")  # the dark name of view 4
    assert_pairs(brought(folder, tmp_path / "cap"), list(range(VIEWS)))


@pytest.mark.parametrize("width", [WIDTH - 1, WIDTH + 1])
def test_lit_pictures_a_pixel_too_narrow_or_wide_are_resampled_and_that_is_said(width: int, tmp_path: Path) -> None:
    """Expectation: the bilinear interpolation that the authors advise, here by numpy, with pixel edges in place."""
    stream = io.StringIO()
    capture = brought(llnerf(tmp_path, lit_width=width), tmp_path / "cap", Console(stream=stream), dataset="LLNeRF")
    assert "9 of 9 lit pictures are a pixel larger or smaller than the dark ones: resampled" in stream.getvalue()
    assert capture.imported.lit["resampled"] == VIEWS
    where = (np.arange(WIDTH) + 0.5) * width / WIDTH - 0.5
    source = lit_picture(3, width).astype(np.float64)
    for row, column in ((0, 0), (5, 1), (20, 2)):
        expected = np.interp(where, np.arange(width), source[row, :, column])
        assert np.abs(lit_of(capture, 3)[row, :, column] - expected).max() <= 1.0  # OpenCV's weights have 11 bits


def test_lit_pictures_of_another_size_or_number_are_refused_with_names(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="DSC01701.png must be 32 x 24 px .* got 30 x 24"):
        brought(llnerf(tmp_path / "llnerf", lit_width=WIDTH - 2), tmp_path / "cap")
    folder = llnerf(tmp_path / "LLNeRF2")
    (tmp_path / "LLNeRF2" / "normal-light-scenes" / "still2" / "DSC01705.png").unlink()
    with pytest.raises(
        ValueError, match=r"has 8 pictures .DSC01701.png to DSC01717.png., .*images 9 .DSC01650.png to "
    ):
        brought(folder, tmp_path / "cap")


def test_a_scene_without_lit_pictures_is_imported_without(tmp_path: Path) -> None:
    folder = llnerf(tmp_path / "LLNeRF")
    shutil.rmtree(tmp_path / "LLNeRF" / "normal-light-scenes")
    stream = io.StringIO()
    capture = brought(folder, tmp_path / "cap", Console(stream=stream))
    assert capture.imported.lit is None
    assert not capture.holds("lit")
    assert "still2 has no lit pictures, so that there is nothing to score against" in stream.getvalue()


def test_a_scene_of_llrs_has_lit_pictures_in_gt_and_is_no_unfinished_render(tmp_path: Path) -> None:
    capture = brought(llrs(tmp_path), tmp_path / "cap")
    assert_pairs(capture, list(range(VIEWS)))
    assert (capture.imported.dataset, capture.cameras.test_indices) == ("LLRS", [0, 8])


def test_lit_pictures_are_found_whatever_case_their_folder_is_in(tmp_path: Path) -> None:
    folder = llrs(tmp_path)
    (folder / "gt").rename(folder / "moved")
    (folder / "moved").rename(folder / "GT")
    assert_pairs(brought(folder, tmp_path / "cap"), list(range(VIEWS)))


def test_hidden_files_of_archives_are_no_pictures(tmp_path: Path) -> None:
    """Rationale: ._NAME, which a Mac adds to each file of an archive, made the number of pictures another."""
    folder = llnerf(tmp_path / "LLNeRF")
    lit = tmp_path / "LLNeRF" / "normal-light-scenes" / "still2"
    for place, count in ((folder / "images", 3), (lit, 2)):
        for file in sorted(place.iterdir())[:count]:
            file.with_name(f"._{file.name}").write_bytes(b"\0")
    assert_pairs(brought(folder, tmp_path / "cap"), list(range(VIEWS)))


def test_a_scene_of_mvtv_keeps_its_16_bits(tmp_path: Path) -> None:
    """Expectation: code / 65535, within half a step of the 16-bit pictures of a capture."""
    capture = brought(mvtv(tmp_path), tmp_path / "cap")
    assert (capture.imported.dataset, capture.imported.depth) == ("MVTV", "16bit")
    assert np.abs(capture.linear16(6) - codes16(6) / 65535).max() <= 0.51 / 61439
    assert np.abs(capture.cameras.rig.viewmats - RIG.viewmats).max() < 1e-9


def test_a_scene_of_mvtv_may_hold_tiff_files_and_a_transforms_json(tmp_path: Path) -> None:
    folder, poses = tmp_path / "MVTV" / "hall", opencv_to_opengl(RIG.viewmats)
    for i in range(VIEWS):
        write16(folder / "images" / f"{i:03d}.tif", codes16(i))
    frames = [{"file_path": f"images/{i:03d}.tif", "transform_matrix": poses[i].tolist()} for i in range(VIEWS)]
    (folder / "transforms.json").write_text(json.dumps({"camera_angle_x": np.radians(FOV), "frames": frames}))
    capture = brought(folder, tmp_path / "cap")
    assert np.abs(capture.linear16(3) - codes16(3) / 65535).max() <= 0.51 / 61439
    assert np.abs(capture.cameras.rig.viewmats - RIG.viewmats).max() < 1e-9
    assert np.abs(capture.cameras.rig.Ks - RIG.Ks).max() < 1e-9


def test_folders_are_known_by_what_they_hold_and_by_a_name_above_them(tmp_path: Path) -> None:
    root = tmp_path / "data"
    for made in (lom(root / "LOM_full" / "buu"), lom(root / "LOM_full" / "bike"), llrs(root), mvtv(root)):
        assert dataset_of(made) is not None
    llnerf(root / "LLNeRF", scene="still3")
    poses_bounds(root / "LLNeRF" / "normal-light-scenes" / "still3" / "poses_bounds.npy", RIG)  # not a dark scene
    found = scenes_below(root)
    assert {name: list(scenes) for name, scenes in found.items()} == {
        "LOM": ["bike", "buu"], "LLNeRF": ["still3"], "LLRS": ["chair"], "MVTV": ["hall"],
    }  # fmt: skip
    assert found["LLNeRF"]["still3"] == root / "LLNeRF" / "llnerf-dataset" / "still3"
    own = shutil.copytree(llrs(root), tmp_path / "mine" / "a" / "b" / "c")
    assert dataset_of(own) is None
    shutil.copytree(root / "LOM_full" / "buu", root / "again" / "buu")
    with pytest.raises(ValueError, match="are both the scene buu of LOM"):
        scenes_below(root)


def test_folders_that_may_not_be_read_are_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a disk has such a folder, lost+found, beside the data. It is faked here: root may read all."""
    lom(tmp_path / "LOM" / "buu")
    (tmp_path / "lost+found").mkdir()

    def refusing(honest):
        def asked(self: Path, *more: Any, **named: Any) -> Any:
            if "lost+found" in self.parts[:-1] or (self.name == "lost+found" and honest.__name__ == "iterdir"):
                raise PermissionError(13, "Permission denied", str(self))
            return honest(self, *more, **named)

        return asked

    for name in ("is_file", "is_dir", "iterdir"):
        monkeypatch.setattr(Path, name, refusing(getattr(Path, name)))
    assert scenes_below(tmp_path) == {"LOM": {"buu": tmp_path / "LOM" / "buu"}}
    with pytest.raises(ValueError, match=r"contains scenes \(LOM/buu\)"):
        brought(tmp_path, tmp_path.parent / "cap")
    shutil.rmtree(tmp_path / "LOM" / "buu" / "high")
    with pytest.raises(ValueError, match="are in LOM/buu/low, LOM/buu/over_exp: give one"):
        brought(tmp_path, tmp_path.parent / "cap")


def test_the_dataset_can_be_said_and_is_refused_where_it_does_not_fit(tmp_path: Path) -> None:
    folder = lom(tmp_path / "LOM" / "buu")
    with pytest.raises(ValueError, match="buu must hold what a scene of LLRS does: images/, sparse/0"):
        brought(folder, tmp_path / "cap", dataset="LLRS")
    with pytest.raises(
        ValueError, match="dataset must be auto, none or one of LOM, LLNeRF, LLRS, MVTV, RealX3D, got 'LoM'"
    ):
        ImportConfig(dataset="LoM")
    with pytest.raises(ValueError, match="split must be one of own, every8, got 'half'"):
        ImportConfig(split="half")  # type: ignore[arg-type]
    capture = brought(folder, tmp_path / "cap", dataset="none")
    assert capture.imported.dataset is None


def test_every_8th_view_replaces_the_split_of_any_folder(tmp_path: Path) -> None:
    folder, poses = tmp_path / "mine", opencv_to_opengl(RIG.viewmats)
    for i in range(VIEWS):
        write_png(folder / "images" / f"{i}.png", dark_picture(i))
    frames = [{"file_path": f"images/{i}.png", "transform_matrix": poses[i].tolist()} for i in range(VIEWS)]
    content = {"camera_angle_x": np.radians(FOV), "frames": frames, "test_filenames": ["images/3.png"]}
    (folder / "transforms.json").write_text(json.dumps(content))
    assert brought(folder, tmp_path / "own").cameras.test_indices == [3]
    assert brought(folder, tmp_path / "every8", split="every8").cameras.test_indices == [0, 8]


def test_a_given_folder_of_lit_pictures_counts_before_that_of_the_data_set(tmp_path: Path) -> None:
    folder = llrs(tmp_path)
    for i in range(VIEWS):
        write_png(tmp_path / "other" / f"{i:03d}.png", lit_picture(i)[::-1])
    capture = brought(folder, tmp_path / "cap", lit=tmp_path / "other")
    np.testing.assert_array_equal(lit_of(capture, 2), lit_picture(2)[::-1])


def test_the_folder_of_a_whole_data_set_is_answered_with_its_scenes(tmp_path: Path) -> None:
    lom(tmp_path / "LOM" / "buu")
    lom(tmp_path / "LOM" / "sofa")
    with pytest.raises(
        ValueError, match=r"is not a scene, but contains scenes \(LOM/buu, LOM/sofa\): import one of them"
    ):
        brought(tmp_path / "LOM", tmp_path / "cap")


def other_pose(folder: Path) -> None:
    content = json.loads((folder / "transforms_val.json").read_text())
    frame = json.loads((folder / "transforms_test.json").read_text())["frames"][0]
    frame["transform_matrix"][0][3] += 0.1
    (folder / "transforms_val.json").write_text(json.dumps(content | {"frames": [frame]}))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f / "high" / "IMG_24.png").unlink(), r"has no picture of 1 of 8 views \(IMG_24\)"),
        (lambda f: (f / "transforms_train.json").write_text("{"), "transforms_train.json"),
        (other_pose, "transforms_test.json and .*transforms_val.json list different poses of IMG_22"),
        (lambda f: write_png(f / "low" / "IMG_21.png", dark_picture(1)[:, 1:]), "must share one size, got 31 x 24"),
        (lambda f: [p.unlink() for p in (f / "low").iterdir()], "none of the 8 images listed"),
    ],
)
def test_scenes_of_lom_that_are_damaged_are_refused_by_name(spoil, message: str, tmp_path: Path) -> None:
    folder = lom(tmp_path / "LOM" / "buu")
    spoil(folder)
    with pytest.raises(ValueError, match=message):
        brought(folder, tmp_path / "cap")


def test_what_is_read_decides_whether_an_import_is_done_again(tmp_path: Path) -> None:
    folder = lom(tmp_path / "LOM" / "buu", model=moved(RIG))
    brought(folder, tmp_path / "cap")
    stages.import_photographs(folder, tmp_path / "cap", ImportConfig(), QUIET)  # the same again
    shutil.rmtree(folder / "colmap_sparse")
    with pytest.raises(ValueError, match="--overwrite"):
        stages.import_photographs(folder, tmp_path / "cap", ImportConfig(), QUIET)


def test_lens_distortion_of_the_model_is_undone_in_dark_and_lit_pictures_alike(tmp_path: Path) -> None:
    import pycolmap

    folder = lom(tmp_path / "buu", model=RIG)
    path = str(folder / "colmap_sparse" / "0")
    model = pycolmap.Reconstruction(path)
    for camera in model.cameras.values():
        fx, _, cx, cy = camera.params
        camera.model, camera.params = pycolmap.CameraModelId.SIMPLE_RADIAL, [fx, cx, cy, 0.2]
    model.write_binary(path)
    capture = brought(folder, tmp_path / "cap", split="every8")
    K = RIG.Ks[0] - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV counts pixel centres from 0
    lens = np.array([0.2, 0, 0, 0, 0])
    new, _ = cv2.getOptimalNewCameraMatrix(K, lens, (WIDTH, HEIGHT), 0)
    for found, picture in (
        (lit_of(capture, 3), lit_picture(3)), (read_png(capture.path / "images" / "IMG_23.png"), dark_picture(3))
    ):  # fmt: skip
        shown = np.round(255 * found) if found.dtype != np.uint8 else found
        np.testing.assert_array_equal(shown, cv2.undistort(picture, K, lens, newCameraMatrix=new))


def test_every_data_set_that_is_absent_is_told_where_to_get() -> None:
    said = expected(DATASETS)
    for name, dataset in DATASETS.items():
        assert f"{name}: {dataset.layout} ({dataset.home})" in said


@pytest.mark.parametrize(("part", "place"), [("train", 0), ("test", -1)])
def test_one_distorted_lens_of_lom_is_undone_wherever_it_stands(part: str, place: int, tmp_path: Path) -> None:
    folder = lom(tmp_path / "buu")
    path = folder / f"transforms_{part}.json"
    content = json.loads(path.read_text())
    content["frames"][place]["k1"] = 0.1
    path.write_text(json.dumps(content))
    scene = open_scene(folder, "own")
    assert scene.lenses is not None
    assert [lens.distortion[0] for lens in scene.lenses if any(lens.distortion)] == [0.1]
