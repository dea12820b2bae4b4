"""Claims about the lens that a transforms.json states, in any of the ways in which its writers do."""

import json
import warnings
from math import degrees, radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import load_set, orbit_rig
from simscenes.rigs import opencv_to_opengl
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.lens import DistortedPinhole
from simscenes.sets.readers.photographs import collect, rig_of, transforms_lens

WIDTH, HEIGHT = 40, 30
X, Y = 0.9, 0.5  # rad
FX, FY = WIDTH / 2 / np.tan(X / 2), HEIGHT / 2 / np.tan(Y / 2)


def folder_of(folder: Path, *, first: dict[str, Any] | None = None, **more: Any) -> Path:
    """Two pictures; `first`: what the first frame states of its own."""
    poses = opencv_to_opengl(orbit_rig(2, WIDTH, HEIGHT, 50.0, radius=3.0).viewmats)
    frames: list[dict[str, Any]] = [
        {"file_path": f"{i}.png", "transform_matrix": p.tolist()} for i, p in enumerate(poses)
    ]
    frames[0] |= first or {}
    for i in range(2):
        write_png(folder / f"{i}.png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    (folder / "transforms.json").write_text(json.dumps({"frames": frames, **more}))
    return folder


@pytest.mark.parametrize(
    ("stated", "fx", "fy"),
    [
        ({"fl_x": 33.0}, 33, 33),
        ({"fl_x": 33.0, "fl_y": 44.0, "camera_angle_x": X, "camera_angle_y": Y, "y_fov": 9.0}, 33, 44),
        ({"fl_x": 33.0, "camera_angle_y": Y, "y_fov": 9.0}, 33, FY),
        ({"fl_x": 33.0, "y_fov": degrees(Y)}, 33, FY),
        ({"camera_angle_x": X, "x_fov": 9.0}, FX, FX),
        ({"camera_angle_x": X, "camera_angle_y": Y}, FX, FY),
        ({"camera_angle_x": X, "camera_angle_y": Y, "w": 2 * WIDTH, "h": 2 * HEIGHT}, FX, FY),
        ({"x_fov": degrees(X)}, FX, FX),
        ({"x_fov": degrees(X), "y_fov": degrees(Y)}, FX, FY),
        ({"camera_angle_y": Y}, FY, FY),
        ({"fovx": degrees(X), "fovy": degrees(Y)}, FX, FY),
    ],
)
def test_focal_lengths_come_from_pixels_else_radians_else_degrees_of_their_own_axis(
    stated: dict[str, Any], fx: float, fy: float, tmp_path: Path
) -> None:
    K = load_set(folder_of(tmp_path, **stated)).rig.Ks[1]
    np.testing.assert_allclose([K[0, 0], K[1, 1], K[0, 2], K[1, 2]], [fx, fy, WIDTH / 2, HEIGHT / 2], rtol=1e-12)


def test_pictures_of_several_sizes_are_refused_with_an_example_of_each(tmp_path: Path) -> None:
    write_png(folder_of(tmp_path, fl_x=33.0) / "1.png", np.zeros((HEIGHT + 1, WIDTH, 3), np.uint8))
    with pytest.raises(ValueError, match=r"must share one size, got 40 x 30 \(0.png\), 40 x 31 \(1.png\); resize"):
        load_set(tmp_path)


def test_pictures_of_several_sizes_in_several_folders_are_named_from_the_folder_that_holds_all(tmp_path: Path) -> None:
    viewmats, files = (
        orbit_rig(2, WIDTH, HEIGHT, 50.0, radius=3.0).viewmats,
        [tmp_path / "a/0.png", tmp_path / "b/0.png"],
    )
    for k, file in enumerate(files):
        write_png(file, np.zeros((HEIGHT + k, WIDTH, 3), np.uint8))
    lens = DistortedPinhole(K=np.eye(3), distortion=(0.0,) * 5)
    with pytest.raises(ValueError, match=r"one size, got 40 x 30 \(a/0.png\), 40 x 31 \(b/0.png\); resize"):
        collect(files, viewmats, (0, 1), tmp_path / "there", lambda *_: lens)


@pytest.mark.parametrize(
    ("own", "fx", "fy"),
    [({"camera_angle_x": X}, FX, FX), ({"y_fov": degrees(Y)}, FY, FY), ({"fl_x": 25.0}, 25, 25), ({}, 99, 88),
     ({"cx": 19.0}, 99, 88)],
)  # fmt: skip
def test_what_a_frame_states_of_its_focal_length_counts_before_all_that_the_file_states(
    own: dict[str, Any], fx: float, fy: float, tmp_path: Path
) -> None:
    Ks = load_set(folder_of(tmp_path, first=own, fl_x=99.0, fl_y=88.0)).rig.Ks
    np.testing.assert_allclose(Ks[:, [0, 1], [0, 1]], [[fx, fy], [99, 88]], rtol=1e-12)


@pytest.mark.parametrize(
    ("first", "shared"),
    [({"fl_x": 33.0}, {"fl_x": 60.0, "camera_angle_x": X}), ({"fl_x": 60.0, "camera_angle_x": X}, {"fl_x": 33.0})],
)
def test_two_focal_lengths_are_said_whichever_frame_has_them(
    first: dict[str, Any], shared: dict[str, Any], tmp_path: Path
) -> None:
    folder = folder_of(tmp_path, first=first, w=WIDTH, h=HEIGHT, **shared)
    with pytest.warns(UserWarning, match="states two focal lengths: fl_x gives 60 px, .*; fl_x counts"):
        load_set(folder)


@pytest.mark.parametrize(("first", "px"), [({"fl_x": 60.0}, "1"), ({}, "0.58")])
def test_what_a_shutter_costs_is_said_of_the_first_focal_length(first: dict[str, Any], px: str, tmp_path: Path) -> None:
    folder = folder_of(tmp_path, first=first, fl_x=33.0, rolling_shutter=[0, 0, 0.03])
    with pytest.warns(UserWarning, match=f"shifts the last rows by {px} px"):
        load_set(folder)


def test_a_set_without_a_focal_length_is_told_every_key_that_would_do(tmp_path: Path) -> None:
    with pytest.raises(
        ValueError, match="none of fl_x, camera_angle_x, x_fov, fovx, fl_y, camera_angle_y, y_fov, fovy$"
    ):
        load_set(folder_of(tmp_path, cx=20.0))


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"camera_angle_x": X, "camera_angle_y": 3.2}, "camera_angle_y must lie between 0 and 3.14159, got 3.2"),
        ({"x_fov": 180.0}, "x_fov must lie between 0 and 180, got 180"),
        ({"fl_x": 30.0, "y_fov": radians(1e-6)}, r"angles must give a focal length below 1e\+07 px, got"),
        ({"fovy": 5e-324, "w": WIDTH, "h": HEIGHT}, r"angles must give a focal length below 1e\+07 px, got inf"),
    ],
)
def test_angles_out_of_range_are_refused(stated: dict[str, Any], message: str, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match=message):
            load_set(folder_of(tmp_path, **stated))


def test_a_principal_point_of_larger_pictures_asks_for_their_size(tmp_path: Path) -> None:
    """Rationale: of pictures that were shrunk, focal lengths would silently be those of the large ones."""
    large = {"fl_x": 80.0, "cx": 40.0, "cy": 30.0}
    for key, got, more in (("w", "cx .* got 40 px of a width of 40 px", {}),
                           ("h", "cy .* got 30 px of a height of 30 px", {"cx": 20.0})):  # fmt: skip
        with pytest.raises(ValueError, match=rf"states no {key}: {got}; add w and h, the size .*\(were they shrunk"):
            load_set(folder_of(tmp_path, **large | more))
    K = load_set(folder_of(tmp_path, **large, w=2 * WIDTH, h=2 * HEIGHT)).rig.Ks[0]
    np.testing.assert_allclose(K, [[40, 0, 20], [0, 40, 15], [0, 0, 1]])
    off = load_set(folder_of(tmp_path, fl_x=40.0, cx=29.0, cy=8.0)).rig.Ks[0]
    np.testing.assert_allclose(off[:2, 2], [29, 8])
    cropped = load_set(folder_of(tmp_path, fl_x=40.0, cx=39.0, cy=8.0, w=WIDTH, h=HEIGHT)).rig.Ks[0]
    np.testing.assert_allclose(cropped[:2, 2], [39, 8])


@pytest.mark.parametrize(
    "stated",
    [
        {"k1": 0.1, "k2": 0.02, "k3": 0.003, "p1": 0.004, "p2": 0.005},
        {"distortion_params": [0.1, 0.02, 0.003, 0.0, 0.004, 0.005]},  # k1 k2 k3 k4 p1 p2
    ],
)
def test_coefficients_of_distortion_come_in_the_order_of_opencv(stated: dict[str, Any]) -> None:
    lens = transforms_lens({"fl_x": 90.0, **stated}, WIDTH, HEIGHT, Path("transforms.json"))
    assert lens.distortion == (0.1, 0.02, 0.004, 0.005, 0.003)


def test_masks_are_not_used_and_that_is_said_once_with_their_count(tmp_path: Path) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_set(folder_of(tmp_path, first={"mask_path": "masks/0.png"}, fl_x=30.0))
    assert [str(w.message) for w in caught] == [
        f"load_set: 1 of 2 frames of {tmp_path}/transforms.json have a mask (mask_path): masks are not used, all "
        "pixels count"
    ]


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_lens_that_folds_the_corners_of_its_picture_is_said_whichever_camera_has_it(order: tuple[int, int]) -> None:
    K = np.array([[33.0, 0, WIDTH / 2], [0, 33.0, HEIGHT / 2], [0, 0, 1]])
    lenses = [DistortedPinhole(K=K, distortion=(k1, 0.0, 0.0, 0.0, 0.0)) for k1 in (-0.1, -0.4)]
    assert [lens.folded(WIDTH, HEIGHT) > 0 for lens in lenses] == [False, True]
    viewmats = orbit_rig(2, WIDTH, HEIGHT, 50.0, radius=3.0).viewmats
    least = f"{lenses[1].turn_px():.0f} px"
    assert least != f"{lenses[0].turn_px():.0f} px"
    with pytest.warns(UserWarning, match=f"the distortion that there states turns {least} from the centre"):
        _, found = rig_of((0, 1), viewmats, order, Path("there"), lambda k, *_: lenses[k], (WIDTH, HEIGHT))
    assert found == tuple(lenses[k] for k in order)
