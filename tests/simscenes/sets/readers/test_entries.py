"""Claims about entries of a transforms.json: what is understood, harmless, said, and refused by name."""

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import load_set, orbit_rig
from simscenes.rigs import opencv_to_opengl
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.entries import without_nulls

WIDTH, HEIGHT = 40, 30
RIG = orbit_rig(3, WIDTH, HEIGHT, 50.0, radius=3.0)
LENS = {"fl_x": 60.0, "fl_y": 60.0, "cx": 20.0, "cy": 15.0, "w": WIDTH, "h": HEIGHT}


def folder_of(folder: Path, *, frame: dict[str, Any] | None = None, name: str = "transforms.json", **more: Any) -> Path:
    """Three pictures; `frame`: what the second frame states of its own."""
    frames: list[dict[str, Any]] = [
        {"file_path": f"{i}.png", "transform_matrix": p.tolist()} for i, p in enumerate(opencv_to_opengl(RIG.viewmats))
    ]
    frames[1] |= frame or {}
    for i in range(3):
        write_png(folder / f"{i}.png", np.full((HEIGHT, WIDTH, 3), 100 + i, np.uint8))
    (folder / name).write_text(json.dumps({**LENS, **more, "frames": frames}))
    return folder


def notes_of(folder: Path) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        views = load_set(folder)
    np.testing.assert_allclose(views.rig.viewmats, RIG.viewmats, atol=1e-12)
    np.testing.assert_allclose(views.rig.Ks[:, 0, 0], 60)
    return [str(w.message) for w in caught]


@pytest.mark.parametrize(
    ("stated", "shown"),
    [
        ({"ftheta_p0": 0, "ftheta_p1": 0.001}, r"ftheta_p1 = 0.001 \(an f-theta fisheye\)"),
        ({"latlong": True}, r"latlong = True \(a panorama\)"),
        ({"k5": 0.3, "k6": 0.1}, r"k5 = 0.3 \(a rational or fisheye lens\).*, k6 = 0.1"),
        ({"b1": 3.0}, r"b1 = 3.0 \(slanted pixels\)"),
        ({"xi": 0.9}, r"xi = 0.9 \(a wide lens\)"),
        ({"from_na": True}, r"from_na = True \(other axes of the cameras\)"),
        ({"projection": "fisheye"}, "projection = fisheye"),
        ({"lens": {"type": "division"}}, "lens = {'type': 'division'}"),
        ({"K1": 0.2}, "K1 = 0.2"),
        ({"intrinsic_matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "intrinsic_matrix = "),
    ],
)
@pytest.mark.parametrize("in_frame", [False, True])
@pytest.mark.parametrize("name", ["transforms.json", "transforms_train.json"])
def test_an_entry_that_may_state_a_lens_is_refused_by_name_value_and_place(
    stated: dict[str, Any], shown: str, in_frame: bool, name: str, tmp_path: Path
) -> None:
    folder = folder_of(tmp_path, name=name, **({"frame": stated} if in_frame else stated))
    with pytest.raises(ValueError, match=rf"{name} has entries that are not understood .*{shown}") as refused:
        load_set(folder)
    assert ("in frames[1]" in str(refused.value)) == in_frame


@pytest.mark.parametrize("value", [0, 0.0, False, None, "", [], {}, [0, 0, 0], "none"])
def test_an_entry_that_is_not_set_states_nothing(value: Any, tmp_path: Path) -> None:
    assert notes_of(folder_of(tmp_path, latlong=value, k5=value, rolling_shutter=value)) == []


def test_entries_of_a_camera_that_are_null_count_as_missing(tmp_path: Path) -> None:
    assert notes_of(folder_of(tmp_path, frame={"k1": None, "camera_model": None}, k4=None, ply_file_path=None)) == []


WRITERS = {
    "nerfstudio, COLMAP": ({"camera_model": "OPENCV", "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0,
                            "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]]}, {"colmap_im_id": 7}),
    "nerfstudio, Polycam": ({"camera_model": "OPENCV", "orientation_override": "none"}, LENS),
    "nerfstudio, Record3D": ({"camera_model": "OPENCV"}, {}),
    "nerfstudio, Metashape": ({"camera_model": "OPENCV",
                               "applied_transform": [[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0]]},
                              LENS | dict.fromkeys(("k1", "k2", "k3", "k4", "p1", "p2"), 0.0)),
    "nerfstudio, RealityCapture": ({"camera_model": "OPENCV", "orientation_override": "none"},
                                   LENS | dict.fromkeys(("k1", "k2", "k3", "k4", "p1", "p2"), 0.0)),
    "instant-ngp": ({"k1": 0, "k2": 0, "k3": 0, "k4": 0, "p1": 0, "p2": 0, "is_fisheye": False, "aabb_scale": 32},
                    {"sharpness": 37.8}),
    "instant-ngp, by hand": ({"scale": 0.33, "offset": [0.5, 0.5, 0.5], "aabb": [[0, 0, 0], [1, 1, 1]], "up": [0, 0, 1],
                              "n_extra_learnable_dims": 16, "render_aabb": [[0, 0, 0], [1, 1, 1]]}, {}),
    "BlenderNeRF": ({"k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "aabb_scale": 4}, {}),
    "NeRF-synthetic": ({}, {"rotation": 0.012566370614359171}),
    "sai-cli": ({"camera_model": "OPENCV", "auto_scale_poses_override": False, "orientation_override": "none"},
                {"camera_angular_velocity": [0.1, 0, 0], "camera_linear_velocity": [0.1, 0, 0],
                 "motion_blur_score": 0.3, "colmap_im_id": 3}),
}  # fmt: skip


@pytest.mark.parametrize("writer", WRITERS)
def test_files_of_the_known_writers_are_read_without_a_word(writer: str, tmp_path: Path) -> None:
    shared, own = WRITERS[writer]
    assert notes_of(folder_of(tmp_path, frame=own, **shared)) == []


@pytest.mark.parametrize(
    ("stated", "own", "said"),
    [
        ({"white_transparent": True}, {}, r"white_transparent \(white pixels are transparent\)"),
        ({"n_frames": 2}, {}, r"n_frames \(how many frames to take\)"),
        ({}, {"depth_file_path": "depth/1.png"}, r"depth_file_path \(depth\)"),
        ({}, {"flow_path": "flow/1.flo"}, r"flow_path \(files\)"),
    ],
)
def test_what_cannot_change_the_cameras_is_said_once(
    stated: dict[str, Any], own: dict[str, Any], said: str, tmp_path: Path
) -> None:
    (note,) = notes_of(folder_of(tmp_path, frame=own, **stated))
    assert note.startswith(f"load_set: entries of {tmp_path}/transforms.json that are not used: ")
    np.testing.assert_string_equal(note.split(": ")[-1], said.replace("\\", ""))


def test_a_rolling_shutter_is_said_with_what_it_costs(tmp_path: Path) -> None:
    (note,) = notes_of(folder_of(tmp_path, rolling_shutter=[0, 0, 0.03]))
    assert "(rolling_shutter): this is not undone" in note
    assert note.endswith("each degree that the camera turns while its rows are read shifts the last rows by 1 px")


def test_a_rolling_shutter_of_one_frame_is_said_too(tmp_path: Path) -> None:
    (note,) = notes_of(folder_of(tmp_path, frame={"rolling_shutter": [0, 0, 0.03]}))
    assert "(rolling_shutter): this is not undone" in note


def test_all_that_is_not_used_is_said_together(tmp_path: Path) -> None:
    own = {"depth_file_path": "depth/1.png"}
    (note,) = notes_of(folder_of(tmp_path, frame=own, white_transparent=True, n_frames=2))
    said = "white_transparent (white pixels are transparent), n_frames (how many frames to take), depth_file_path"
    assert f"not used: {said} (depth)" in note


def test_frames_that_are_no_frames_are_left_for_their_own_check() -> None:
    content = {"a": None, "frames": [{"k1": None, "w": 3}, 7]}
    assert without_nulls(content) == {"frames": content["frames"]}
    assert without_nulls({"frames": content["frames"][::-1]}) == {"frames": content["frames"][::-1]}
    assert without_nulls({"frames": [{"k1": None}, {"w": 3, "k2": None}]}) == {"frames": [{}, {"w": 3}]}


def test_a_camera_that_turns_during_an_exposure_is_said_with_the_pixels_of_its_turn(tmp_path: Path) -> None:
    """A turn of .02 rad at a focal length of 60 px is 1.2 px, whether poses or speeds state it."""
    start, end = opencv_to_opengl(RIG.viewmats)[1], opencv_to_opengl(RIG.viewmats)[1].copy()
    c, s = np.cos(0.02), np.sin(0.02)
    end[:3, :3] = end[:3, :3] @ [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    ends = {"transform_matrix_start": start.tolist(), "transform_matrix_end": end.tolist()}
    (note,) = notes_of(folder_of(tmp_path, frame=ends))
    assert "(transform_matrix_start, transform_matrix_end): this is not undone" in note
    assert "by up to 1.15 degrees, which shifts pixels by up to 1.2 px" in note
    (note,) = notes_of(folder_of(tmp_path, frame={"camera_angular_velocity": [0, 1.0, 0]}, rolling_shutter_time=0.02))
    assert "by up to 1.15 degrees, which shifts pixels by up to 1.2 px" in note
    content = json.loads((tmp_path / "transforms.json").read_text())
    for speeds in ((0.1, 0.2, 2.0), (2.0, 0.2, 0.1)):
        for frame, speed in zip(content["frames"], speeds, strict=True):
            frame["camera_angular_velocity"] = [0, speed, 0]
        (tmp_path / "transforms.json").write_text(json.dumps(content))
        (note,) = notes_of(tmp_path)
        assert "by up to 2.29 degrees" in note  # in the frame that turns fastest
    turning = [angle for frame in content["frames"] if (angle := frame.pop("camera_angular_velocity")) is not None]
    assert len(turning) == 3
    content.pop("rolling_shutter_time")
    for place in (0, 2):
        moved = json.loads(json.dumps(content))
        moved["frames"][place] |= ends
        (tmp_path / "transforms.json").write_text(json.dumps(moved))
        (note,) = notes_of(tmp_path)
        assert "by up to 1.15 degrees" in note  # in the one frame that turns
        assert "(transform_matrix_start, transform_matrix_end)" in note
    assert notes_of(folder_of(tmp_path, frame=dict.fromkeys(ends, start.tolist()))) == []


def test_frames_of_different_times_are_said_to_be_taken_for_one_scene(tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    content = json.loads((folder / "transforms.json").read_text())
    for i, frame in enumerate(content["frames"]):
        frame["time"] = i / 2
    (folder / "transforms.json").write_text(json.dumps(content))
    (note,) = notes_of(folder)
    assert "2 different times (time): the scene is taken for one that stands still" in note


def test_distortion_of_a_frame_counts_before_a_list_of_the_file(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, frame={"k1": 0.05}, distortion_params=[0.2, 0, 0, 0, 0, 0])
    lenses = load_set(folder).lenses
    assert lenses is not None
    assert [lens.distortion[0] for lens in lenses] == [0.2, 0.05, 0.2]


def test_another_lens_is_named_before_its_numbers_are_counted(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="has a FISHEYE624 camera"):
        load_set(folder_of(tmp_path, camera_model="FISHEYE624", distortion_params=[0.1] * 12))


def test_a_pose_without_its_last_row_is_the_same_pose(tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    content = json.loads((folder / "transforms.json").read_text())
    for frame in content["frames"]:
        frame["transform_matrix"] = frame["transform_matrix"][:3]
    (folder / "transforms.json").write_text(json.dumps(content))
    assert notes_of(folder) == []


def test_a_byte_order_mark_changes_nothing(tmp_path: Path) -> None:
    source = folder_of(tmp_path) / "transforms.json"
    source.write_bytes(b"\xef\xbb\xbf" + source.read_bytes())
    assert notes_of(tmp_path) == []


def test_two_focal_lengths_that_contradict_each_other_are_said(tmp_path: Path) -> None:
    (note,) = notes_of(folder_of(tmp_path, camera_angle_x=2.0))
    assert "states two focal lengths: fl_x gives 60 px, camera_angle_x gives 12.84 px; fl_x counts" in note
    (note,) = notes_of(folder_of(tmp_path, frame={"fl_y": 60.0, "camera_angle_y": 2.0}))
    assert "fl_y gives 60 px, camera_angle_y gives 9.631 px; fl_y counts" in note
    content = json.loads((folder_of(tmp_path) / "transforms.json").read_text())
    for place in (0, 2):
        moved = json.loads(json.dumps(content))
        moved["frames"][place] |= {"fl_y": 60.0, "camera_angle_y": 2.0}
        (tmp_path / "transforms.json").write_text(json.dumps(moved))
        (note,) = notes_of(tmp_path)  # wherever it stands
        assert "camera_angle_y gives 9.631 px" in note
    assert notes_of(folder_of(tmp_path, camera_angle_x=float(2 * np.arctan(20 / 60)))) == []
