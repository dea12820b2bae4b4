"""Claims about scenes of RealX3D: cameras in metres, lit held-out views without a dark twin, depth of the scan."""

import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from novags.methods import METHODS, chosen
from novags.methods.inputs import LacksInput
from novags.settings import changed
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.references import references, true_depth
from novags.testbed.folders.run import open_run
from novags.testbed.folders.set import open_source
from novags.testbed.importing.published import realx3d as realx3d_scenes
from novags.testbed.importing.published.datasets import dataset_of, scenes_below
from novags.testbed.importing.published.realx3d import colmap_to_world, in_metres, open_scene, read_depth
from novags.testbed.metrics.geometry import seen_points, surface_scores
from novags.testbed.report.page import write_reports
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.viewer.shown import Shown
from simscenes.rigs import opengl_to_opencv
from simscenes.sets.readers.ply_points import read_ply_points
from tests.miniatures import (
    HEIGHT,
    METRES,
    REALX3D_TEST,
    VIEWS,
    WIDTH,
    dark_picture,
    lit_picture,
    realx3d,
    realx3d_rig,
    write_png16,
)

QUIET = Console(quiet=True)
TRAIN = [i for i in range(VIEWS) if i not in REALX3D_TEST]


def brought(folder: Path, out: Path, console: Console = QUIET, **config: Any) -> Capture:
    stages.import_photographs(folder, out, ImportConfig(**config), console)
    return open_capture(out)


def test_a_scene_as_released_has_its_cameras_in_metres_its_twins_and_its_split(tmp_path: Path) -> None:
    stream = io.StringIO()
    capture = brought(realx3d(tmp_path / "RealX3D"), tmp_path / "cap", Console(stream=stream))
    rig, truth = capture.cameras.rig, realx3d_rig()
    assert np.abs(rig.viewmats - truth.viewmats).max() < 1e-9
    assert np.abs(rig.Ks - truth.Ks).max() < 1e-9  # the principal point too, which is not in the middle
    assert capture.cameras.test_indices == list(REALX3D_TEST)
    assert capture.imported is not None
    assert (capture.imported.dataset, capture.record.scene) == ("RealX3D", "Popcorn")
    source = capture.source(QUIET)
    for i in range(VIEWS):
        np.testing.assert_array_equal(np.round(255 * source.lit(i)), lit_picture(i))
        if i in TRAIN:
            np.testing.assert_array_equal(np.round(255 * capture.srgb8(i)), dark_picture(i))
    assert "2 held-out views are known in good light only" in stream.getvalue()


def test_a_view_known_in_good_light_only_is_never_taken_for_a_dark_one(tmp_path: Path) -> None:
    capture = brought(realx3d(tmp_path / "RealX3D"), tmp_path / "cap")
    for read in (capture.srgb8, capture.linear, lambda i: capture.dark(i, "8bit")):
        with pytest.raises(LacksInput, match="view 0008 is known in good light only: it has no dark picture"):
            read(7)
    assert not (tmp_path / "cap" / "images" / "0008.png").exists()
    frames = json.loads((tmp_path / "cap" / "transforms.json").read_text())
    assert [f["file_path"] for f in frames["frames"]] == [f"images/{i + 1:04d}.png" for i in TRAIN] + [
        f"lit/{i + 1:04d}.png" for i in REALX3D_TEST
    ]
    assert frames["test_filenames"] == ["lit/0008.png", "lit/0009.png"]
    import pycolmap

    model = pycolmap.Reconstruction(str(tmp_path / "cap" / "sparse" / "0"))
    assert sorted(image.name for image in model.images.values()) == [f"{i + 1:04d}.png" for i in TRAIN]


def test_the_viewer_shows_no_picture_that_a_view_does_not_have(tmp_path: Path) -> None:
    folder, nothing = realx3d(tmp_path / "RealX3D"), SimpleNamespace()
    shutil.rmtree(folder / "val")
    capture = brought(folder, tmp_path / "cap")
    runs: Any = {"a": SimpleNamespace(enhancement=None, path=tmp_path)}
    shown = Shown("t", capture, capture.source(QUIET), runs, nothing, nothing)  # type: ignore[arg-type]
    for i in range(VIEWS):
        dark, true = (shown.picture(kind, "a", i) for kind in ("dark", "true"))
        assert (dark is not None, true is not None) == (i in TRAIN, i in REALX3D_TEST)


def test_points_of_the_model_and_depth_of_the_scan_are_in_the_frame_of_the_cameras(tmp_path: Path) -> None:
    capture = brought(realx3d(tmp_path / "RealX3D"), tmp_path / "cap")
    points = capture.cameras.points()
    assert points is not None
    wanted = np.eye(3) / 10 @ METRES[:3, :3].T + METRES[:3, 3]
    np.testing.assert_allclose(points.xyz[np.lexsort(points.xyz.T)], wanted[np.lexsort(wanted.T)], atol=1e-9)
    source = capture.source(QUIET)
    for i in (0, 8):
        depth = true_depth(source, i)
        assert depth is not None
        assert depth.shape == (HEIGHT, WIDTH)
        assert (depth[0] == 0).all()  # nobody measured it
        np.testing.assert_allclose(depth[1:, WIDTH // 2 :], 2 + i / 10, atol=1e-6)
        np.testing.assert_allclose(depth[1:, : WIDTH // 2], 1.5 + i / 10, atol=1e-6)


def test_the_scan_lies_where_the_depth_of_a_view_shows_it(tmp_path: Path) -> None:
    capture = brought(realx3d(tmp_path / "RealX3D"), tmp_path / "cap")
    source, rig = capture.source(QUIET), capture.cameras.rig
    depth = true_depth(source, 0)
    assert depth is not None
    assert source.scan is not None
    found = surface_scores(
        [seen_points(depth, np.ones_like(depth), rig.Ks[0], rig.viewmats[0])], read_ply_points(source.scan).xyz
    )
    assert found["f1"] == 1
    assert found["accuracy"] == pytest.approx(
        0, abs=0.005
    )  # the scan is kept as means of cubes, which hold points twice
    assert found["completeness"] == pytest.approx(0, abs=0.005)


def test_in_metres_a_point_has_the_pixel_it_had_and_a_depth_larger_by_the_scale() -> None:
    """Independent: points are moved by the matrix itself, cameras by the function."""
    rng = np.random.default_rng(0)
    rig, points = realx3d_rig(), rng.normal(size=(20, 3))
    matrix = np.eye(4)
    matrix[:3, :3] = 1.7 * Rotation.from_rotvec([0.2, -1.0, 0.4]).as_matrix()
    matrix[:3, 3] = (5.0, -3.0, 0.5)
    pixels, depths = rig.project(points)
    moved, scaled = in_metres(rig, matrix).project(points @ matrix[:3, :3].T + matrix[:3, 3])
    np.testing.assert_allclose(moved, pixels, atol=1e-6)
    np.testing.assert_allclose(scaled, 1.7 * depths, atol=1e-9)


@pytest.mark.parametrize("name", ["colmap2world.npy", "colmap2world.txt", "sparse/0/colmap2world.npy"])
def test_the_way_to_metres_is_found_in_each_form_and_place_that_the_data_set_has(name: str, tmp_path: Path) -> None:
    folder = realx3d(tmp_path / "RealX3D")
    truth = folder.parents[2] / "pointclouds" / "Popcorn"
    (truth / "colmap2world.npy").unlink()
    assert colmap_to_world(folder) is None
    (truth / name).parent.mkdir(parents=True, exist_ok=True)
    (np.savetxt if name.endswith(".txt") else np.save)(truth / name, METRES)
    np.testing.assert_array_equal(colmap_to_world(folder), METRES)


@pytest.mark.parametrize(("part", "place"), [("train", 0), ("train", 3), ("test", -1)])
def test_one_distorted_lens_is_undone_wherever_it_stands(part: str, place: int, tmp_path: Path) -> None:
    folder = realx3d(tmp_path / "RealX3D")
    shutil.rmtree(folder / "sparse")
    assert open_scene(folder, "own").lenses is None
    path = folder / f"transforms_{part}.json"
    content = json.loads(path.read_text())
    content["frames"][place]["k1"] = 0.1
    path.write_text(json.dumps(content))
    scene = open_scene(folder, "own")
    assert scene.lenses is not None
    assert [lens.distortion[0] for lens in scene.lenses if any(lens.distortion)] == [0.1]


@pytest.mark.parametrize(("above", "place"), [("", "train"), ("train/", "")])
def test_tracks_are_through_the_dark_pictures_wherever_the_names_of_the_model_begin(
    above: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = list[Path]()
    scene = realx3d_scenes.RealX3DScene(
        path=tmp_path, names=("0001", "0002"), rig=realx3d_rig(), kind="photographs", meta={}, files=(),
        colmap=tmp_path / "sparse", colmap_rig=realx3d_rig(),
    )  # fmt: skip
    monkeypatch.setattr(
        realx3d_scenes, "colmap_views", lambda model: ([f"{above}{n}.png" for n in scene.names], [], [])
    )
    monkeypatch.setattr(realx3d_scenes, "read_points", lambda pictures, *_: seen.append(pictures))
    assert scene.points() is None
    assert seen == [scene.path / place]


def test_without_the_model_cameras_are_in_the_frame_of_the_transforms_and_the_scan_is_left_out(tmp_path: Path) -> None:
    folder = realx3d(tmp_path / "RealX3D")
    shutil.rmtree(folder / "sparse")
    capture = brought(folder, tmp_path / "cap")
    frames = [frame for part in ("train", "test")
              for frame in json.loads((folder / f"transforms_{part}.json").read_text())["frames"]]  # fmt: skip
    wanted = np.stack([opengl_to_opencv(np.array(frame["transform_matrix"])) for frame in frames])
    assert np.abs(capture.cameras.rig.viewmats - wanted).max() < 1e-9
    assert np.abs(capture.cameras.rig.Ks - realx3d_rig().Ks).max() < 1e-9
    assert not capture.holds("depth")
    assert true_depth(capture.source(QUIET), 8) is None


def test_the_layout_of_the_challenge_has_lit_pictures_of_its_held_out_views_alone(tmp_path: Path) -> None:
    folder = realx3d(tmp_path / "RealX3D")
    for part in ("val", "sparse"):
        shutil.rmtree(folder / part)
    capture = brought(folder, tmp_path / "cap")
    source = capture.source(QUIET)
    assert [i for i in range(VIEWS) if source.shows(i)] == list(REALX3D_TEST)
    np.testing.assert_array_equal(np.round(255 * source.lit(8)), lit_picture(8))
    with pytest.raises(ValueError, match="view 0001 of .* is not known in good light"):
        source.lit(0)
    run: Any = SimpleNamespace(space="enhanced", enhancement=None, lacks=None)
    assert [list(references(run, capture, source, i)) for i in (0, 8)] == [[], ["lit"]]


def test_without_held_out_pictures_every_8th_dark_one_is_held_out_and_that_is_said(tmp_path: Path) -> None:
    folder, stream = realx3d(tmp_path / "RealX3D"), io.StringIO()
    shutil.rmtree(folder / "test")
    capture = brought(folder, tmp_path / "cap", Console(stream=stream))
    assert (capture.cameras.test_indices, len(capture.names)) == ([0], len(TRAIN))
    np.testing.assert_array_equal(np.round(255 * capture.source(QUIET).lit(0)), lit_picture(0))
    assert "no picture of a held-out view (the challenge kept them)" in stream.getvalue()


def test_with_every_8th_view_held_out_the_views_without_a_dark_picture_stay_out(tmp_path: Path) -> None:
    capture = brought(realx3d(tmp_path / "RealX3D"), tmp_path / "cap", split="every8")
    assert capture.names == tuple(f"{i + 1:04d}" for i in TRAIN)
    assert capture.cameras.test_indices == [0]
    assert capture.cameras.lit_alone == ()


def test_it_is_known_by_its_content_or_by_the_name_above_and_scenes_by_their_condition(tmp_path: Path) -> None:
    folder = realx3d(tmp_path / "x")
    other = realx3d(tmp_path / "x", condition="smoke", scene="Akikaze")
    realx3d(tmp_path / "y", condition="smoke")
    assert dataset_of(folder).name == "RealX3D"
    assert list(scenes_below(tmp_path / "x")["RealX3D"]) == ["lowlight/Popcorn", "smoke/Akikaze"]
    (other / "val" / "0001.png").rename(other / "val" / "other.png")
    assert dataset_of(other) is None  # of no other layout either, nor by its name
    other = shutil.copytree(other, tmp_path / "RealX3D" / "Akikaze")
    assert dataset_of(other).name == "RealX3D"


def test_a_scene_of_the_challenge_is_known_by_its_numbers(tmp_path: Path) -> None:
    """As the eight scenes of the low-light track have them: no lit twins, test/ goes on with the numbers of train/."""

    def told(numbers: range, test: range, **more: Any) -> Any:
        folder = tmp_path / "Cupcake"
        (folder / "train").mkdir(parents=True, exist_ok=True)
        for part, own in (("train", numbers), ("test", test)):
            frames = [{"file_path": f"{part}/{k:04d}.JPG", "sharpness": 9.0, **more} for k in own]
            (folder / f"transforms_{part}.json").write_text(json.dumps({"frames": frames}))
        return dataset_of(folder)

    assert told(range(1, 31), range(31, 37)).name == "RealX3D"
    assert told(range(1, 31), range(1, 7)) is None
    assert told(range(31), range(31, 37)) is None
    assert told(range(1, 31), range(31, 37), file_path="train/0001.JPG") is None
    for other in (0, 29):  # not of that tool
        assert told(range(1, 31), range(31, 37)).name == "RealX3D"
        listed = tmp_path / "Cupcake" / "transforms_train.json"
        frames = json.loads(listed.read_text())["frames"]
        del frames[other]["sharpness"]
        listed.write_text(json.dumps({"frames": frames}))
        assert dataset_of(tmp_path / "Cupcake") is None


def test_a_scene_that_is_not_known_is_not_trained_on_dark_and_lit_pictures_without_a_word(tmp_path: Path) -> None:
    folder, stream = realx3d(tmp_path / "x"), io.StringIO()
    for part in ("val", "sparse"):
        shutil.rmtree(folder / part)
    assert dataset_of(folder) is None
    brought(folder, tmp_path / "cap", Console(stream=stream))
    said = " ".join(stream.getvalue().split())
    assert "times as bright as the others: if they are lit ones, as of RealX3D, give --dataset" in said


def break_matrix(folder: Path) -> None:
    np.save(folder.parents[2] / "pointclouds" / "Popcorn" / "colmap2world.npy", METRES * [[1], [2], [1], [1]])


def cut_matrix(folder: Path) -> None:
    (folder.parents[2] / "pointclouds" / "Popcorn" / "colmap2world.npy").write_bytes(b"\x93NUMPY")


def lose_views_of_the_model(folder: Path) -> None:
    from tests.miniatures import colmap

    shutil.rmtree(folder / "sparse")
    rig = realx3d_rig()
    few = type(rig)(viewmats=rig.viewmats[:8], Ks=rig.Ks[:8], width=WIDTH, height=HEIGHT)
    colmap(folder / "sparse" / "0", [f"{i + 1:04d}.png" for i in range(8)], few)


def name_a_held_out_view_like_a_dark_one(folder: Path) -> None:
    (folder / "test" / "0008.png").rename(folder / "test" / "0001.png")
    text = (folder / "transforms_test.json").read_text()
    (folder / "transforms_test.json").write_text(text.replace("test/0008.png", "test/0001.png"))


def exchange_the_transforms(folder: Path) -> None:
    rng = np.random.default_rng(0)
    for part in ("train", "test"):
        content = json.loads((folder / f"transforms_{part}.json").read_text())
        for frame in content["frames"]:
            frame["transform_matrix"][0][3] += float(rng.normal())
        (folder / f"transforms_{part}.json").write_text(json.dumps(content))


def shrink_the_depth(folder: Path) -> None:
    place = folder.parents[2] / "pointclouds" / "Popcorn" / "depth" / "0001.png"
    write_png16(place, np.ones((30, 30), np.uint16))


def colour_the_depth(folder: Path) -> None:
    place = folder.parents[2] / "pointclouds" / "Popcorn" / "depth" / "0001.png"
    shutil.copy(folder / "val" / "0001.png", place)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (break_matrix, "must hold a turn, a positive scale and a shift"),
        (cut_matrix, "holds no matrix of numbers"),
        (lose_views_of_the_model, "lacks 1 of the 9 listed views .0009.: download the scene again"),
        (name_a_held_out_view_like_a_dark_one, "have names of pictures in transforms_train.json .0001.png."),
        (exchange_the_transforms, "are of different scenes: the camera positions differ by"),
        (shrink_the_depth, "0001.png is 30 x 30 px, another shape than its view"),
        (colour_the_depth, "0001.png must be a grey picture of 16 bits"),
    ],
)
def test_half_downloaded_and_exchanged_files_are_named(
    tmp_path: Path, spoil: Callable[[Path], None], said: str
) -> None:
    folder = realx3d(tmp_path / "RealX3D")
    spoil(folder)
    with pytest.raises(ValueError, match=said):
        brought(folder, tmp_path / "cap")


def test_clean_exposures_need_dark_pictures_of_all_views(tmp_path: Path) -> None:
    folder = realx3d(tmp_path / "RealX3D")
    with pytest.raises(ValueError, match="add --split every8"):
        brought(folder, tmp_path / "cap", clean=folder / "val")


def test_depth_is_that_of_the_code_in_which_the_centre_of_a_pixel_lies(tmp_path: Path) -> None:
    codes = np.arange(24, dtype=np.uint16).reshape(4, 6)
    write_png16(tmp_path / "d.png", codes)
    np.testing.assert_allclose(read_depth(tmp_path / "d.png", 6, 4), codes / 1000, rtol=1e-6)
    np.testing.assert_allclose(read_depth(tmp_path / "d.png", 3, 2), codes[1::2, 1::2] / 1000, rtol=1e-6)


def test_a_set_of_such_a_scene_is_photographs_with_cameras(tmp_path: Path) -> None:
    capture = brought(realx3d(tmp_path / "RealX3D"), tmp_path / "cap")
    assert open_source(capture.path, QUIET).views.test_indices == list(REALX3D_TEST)


def test_methods_are_scored_by_lit_pictures_and_the_scan_and_the_report_shows_them(tmp_path: Path) -> None:
    capture = brought(realx3d(tmp_path / "RealX3D"), tmp_path / "cap")
    for method in ("naive", "naive-l1"):
        variant, settings = chosen(method), {"fit.iterations": 8, "enhance.window": 9}
        config = changed(variant.config(METHODS[variant.method].config(), {}), settings, what=method)
        wanted = ReconstructConfig(variant=variant, config=config, points=40)
        stages.reconstruct(capture.path, tmp_path / method, wanted, QUIET)
        stages.score(tmp_path / method, QUIET)
        scores = open_run(tmp_path / method).scores()
        assert scores is not None
        assert set(scores["views"]) == {"0008", "0009"}
        assert scores["mean"]["lit"]["psnr"] > 0
        assert scores["geometry"]["abs_rel"] is not None
        assert scores["mean"]["lit"]["jpeg_psnr"] == pytest.approx(scores["mean"]["lit"]["psnr"], abs=1.0)
        assert 0 < scores["mean"]["lit"]["jpeg_ssim"] <= 1
        assert 0 <= scores["geometry"]["f1"] <= 1
        assert scores["geometry"]["accuracy"] > 0
    write_reports([tmp_path / "naive", tmp_path / "naive-l1"], QUIET, out=tmp_path / "report.html")
    told = (tmp_path / "report.html").read_text()
    assert "Truth: depth" in told
    assert "PSNR as JPEG" in told
    assert "F1 within 5 cm" in told
    assert "Dark input, view 0001" in told
    assert "Dark input, view 0008" not in told
