"""What stands in a transforms.json: entries that are understood, that are harmless, that are said, and all others.

An entry that nobody here understands may state a lens, a shutter, or other axes. Taken for a pinhole, such pictures
give a wrong scene without a word, so it is refused by its name. Entries that are not set (0, false, null, empty) state
nothing. The harmless ones are from files of instant-ngp 2.0, nerfstudio 1.1.5 (COLMAP, Polycam, Record3D, Metashape,
RealityCapture, ODM, Aria), BlenderNeRF 6, sai-cli, NeRF-synthetic and this program.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sensor_model.files.reading import some

PINHOLES = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
# Of the camera, the pictures and the split: `photographs` reads them.
UNDERSTOOD = frozenset(
    "frames file_path transform_matrix camera_model is_fisheye distortion_params fl_x fl_y camera_angle_x "
    "camera_angle_y x_fov y_fov fovx fovy w h cx cy k1 k2 k3 k4 p1 p2 train_filenames val_filenames test_filenames "
    "ply_file_path mask_path".split()
)
# Where others render, how they train, and facts about files: no pixel and no ray depends on them.
HARMLESS = frozenset(
    # instant-ngp: its box, its unit, its training
    "aabb aabb_scale render_aabb render_aabb_to_local scale offset up n_extra_learnable_dims importance_sampling "
    "integer_depth_scale enable_depth_loading enable_ray_loading sharpness driver_parameters "
    # nerfstudio: how it turned and scaled the world that cameras and points share, and numbers of images
    "applied_transform applied_scale orientation_override auto_scale_poses_override colmap_im_id fisheye_crop_radius "
    "depth_unit_scale_factor scene_box near far near_far "
    # Blender: turn of the camera rig between frames
    "rotation "
    # telephones and video: when, how long, how sharp
    "timestamp exposure_time exposure_duration iso blur_score motion_blur_score camera_linear_velocity "
    "camera_angular_velocity "
    # who and what
    "id name image_id image_name camera_id camera_name frame_id frame_name scene scene_name dataset title author "
    "description comment comments note notes copyright license url date created version software generator units "
    "device device_model "
    # this program: how the scene of a Blender folder was scaled and moved
    "scene_scale scene_center".split()
)
# Not used here, which is said: entry -> what it is.
SAID = {
    "depth_file_path": "depth", "depth_path": "depth", "depth": "depth", "normal_file_path": "normals",
    "normal_path": "normals", "mono_depth_path": "depth", "semantics": "classes", "semantic_path": "classes",
    "segmentation_path": "classes", "sharpness_discard_threshold": "which blurred frames to drop",
    "n_frames": "how many frames to take", "white_transparent": "white pixels are transparent",
    "black_transparent": "black pixels are transparent", "mask_color": "pixels of a colour are transparent",
    "fix_premult": "colours are divided by alpha", "sharpen": "pictures are sharpened", "envmap": "an environment map",
    "split": "a purpose of a frame; write train_filenames and test_filenames", "bg_path": "a background",
}  # fmt: skip
# Refused with their meaning; any other entry is refused as not understood.
MEANING = {
    r"ftheta_p\d": "an f-theta fisheye", r"latlong|equirectangular": "a panorama", r"orthographic": "parallel rays",
    r"k[056]": "a rational or fisheye lens", r"s[0-4x]|s[xy]?\d": "a thin prism", r"b1|b2|skew": "slanted pixels",
    r"omega|xi|alpha|beta": "a wide lens", r"from_mitsuba|normal_mts_args|from_na": "other axes of the cameras",
}  # fmt: skip
SHUTTER = ("rolling_shutter", "rolling_shutter_time", "rolling_shutter_duration", "readout_time")
ENDS = ("transform_matrix_start", "transform_matrix_end")
NOT_SET = ("", "none", "off", "false", "no", "global")
PATH = re.compile(r".*(_path|_file|_filename)s?")  # names of files that are not opened
SHOWN = 40  # characters of a value in a message


@dataclass(frozen=True)
class _Entry:
    key: str
    value: Any
    where: str  # "" in the file itself, else in a frame
    count: int  # frames that have it


def check_entries(content: dict[str, Any], source: Path, focal: float | None) -> list[str]:
    """Refuse a transforms.json whose entries may state more than a pinhole with OpenCV distortion.

    Args:
        content: Of the file, with a list of frames.
        source: The file, for messages.
        focal: A focal length of it in px, to say what a shutter costs; None: not known.

    Returns:
        Notes for the user on entries that are not used.

    Raises:
        ValueError: Naming every entry that is not understood, with its value, its place and what it may mean.
    """
    frames = content["frames"]
    entries = [e for e in _set_entries(content, frames) if e.key not in UNDERSTOOD | HARMLESS]
    known = (*SAID, *SHUTTER, *ENDS)
    unknown = [e for e in entries if e.key not in known and not _is_path(e)]
    if unknown:
        raise ValueError(
            f"load_set: {source} has entries that are not understood and may change what its pictures show: "
            f"{some([_described(e) for e in unknown], 6)}; only pinholes with k1 k2 k3 p1 p2 are supported: undistort "
            "the images first, or remove the entries if they say nothing about lens, shutter and axes"
        )
    said = [e for e in entries if e.key in SAID or _is_path(e)]
    if (source.parent / "set.json").is_file() or (source.parent / "capture.json").is_file():
        said = []  # our own depth is in gt/, and is used
    notes = [] if not said else [
        f"entries of {source} that are not used: "
        + some([f"{e.key} ({SAID.get(e.key, 'files')})" for e in {e.key: e for e in said}.values()], 8)
    ]  # fmt: skip
    times = {str(frame["time"]) for frame in frames if _is_set(frame.get("time"))}
    if len(times) > 1:
        notes.append(f"frames of {source} state {len(times)} different times (time): the scene is taken for one that "
                     "stands still, and what moves will be blurred")  # fmt: skip
    return notes + _shutter(content, frames, source, focal)


def without_nulls(content: Any) -> Any:
    """The content of a transforms.json without entries that are null, in the file and in its frames."""
    if not isinstance(content, dict):
        return content
    kept = {key: value for key, value in content.items() if value is not None}
    frames = kept.get("frames")
    if isinstance(frames, list) and all(isinstance(frame, dict) for frame in frames):
        kept["frames"] = [{key: value for key, value in frame.items() if value is not None} for frame in frames]
    return kept


def _set_entries(content: dict[str, Any], frames: Sequence[dict[str, Any]]) -> Iterable[_Entry]:
    """Each entry that is set, once for the file and once for its frames."""
    for key, value in content.items():
        if _is_set(value):
            yield _Entry(key, value, "", 0)
    first: dict[str, tuple[int, Any, int]] = {}
    for i, frame in enumerate(frames):
        for key, value in frame.items():
            if key != "time" and _is_set(value):
                place, shown, count = first.get(key, (i, value, 0))
                first[key] = place, shown, count + 1
    for key, (place, value, count) in first.items():
        yield _Entry(key, value, f"frames[{place}]", count)


def _is_set(value: Any) -> bool:
    if isinstance(value, str):
        return value.strip().lower() not in NOT_SET
    if isinstance(value, list):
        return any(_is_set(each) for each in value)
    return bool(value)


def _is_path(entry: _Entry) -> bool:
    return isinstance(entry.value, str) and PATH.fullmatch(entry.key) is not None


def _described(entry: _Entry) -> str:
    meaning = next((words for key, words in MEANING.items() if re.fullmatch(key, entry.key)), "")
    value = str(entry.value)
    shown = value if len(value) <= SHOWN else f"{value[: SHOWN - 3]}..."
    where = f" in {entry.where}" + (f" and {entry.count - 1} more" if entry.count > 1 else "") if entry.where else ""
    return f"{entry.key} = {shown}" + (f" ({meaning})" if meaning else "") + where


def _shutter(content: dict[str, Any], frames: Sequence[dict[str, Any]], source: Path, focal: float | None) -> list[str]:
    """That rows exposed one after the other, or a camera that moves meanwhile, are not undone, and what that costs."""
    stated = [k for k in SHUTTER if any(_is_set(one.get(k)) for one in (content, *frames))]
    turns = [angle for frame in frames if (angle := _turn_between_ends(frame)) is not None and angle > 1e-6]
    if not stated and not turns:
        return []
    speeds = [float(np.linalg.norm(v)) for frame in frames if (v := _numbers(frame.get("camera_angular_velocity"), 3))]
    seconds = next((float(content[k]) for k in SHUTTER[1:] if isinstance(content.get(k), int | float)), None)
    if not turns and speeds and seconds:
        turns = [speed * seconds for speed in speeds]
    pixels = math.nan if focal is None else focal
    if turns:
        shift = "" if focal is None else f", which shifts pixels by up to {max(turns) * pixels:.3g} px"
        cost = f"in one exposure the camera turns by up to {math.degrees(max(turns)):.3g} degrees{shift}"
    else:
        shift = "the last rows" if focal is None else f"the last rows by {math.radians(1) * pixels:.2g} px"
        cost = f"each degree that the camera turns while its rows are read shifts {shift}"
    what = ", ".join(stated) or ", ".join(key for key in ENDS if any(key in frame for frame in frames))
    return [f"{source} states that its rows were exposed one after the other, or that its camera moved meanwhile "
            f"({what}): this is not undone, each picture counts as taken from one place; {cost}"]  # fmt: skip


def _turn_between_ends(frame: dict[str, Any]) -> float | None:
    """Angle between the poses at the start and the end of an exposure, rad; None: they are not stated."""
    middle = frame.get("transform_matrix")
    ends = [rows for key in ENDS if (rows := _rotation(frame.get(key, middle))) is not None]
    if len(ends) < 2 or not any(key in frame for key in ENDS):
        return None
    return float(np.arccos(np.clip((np.trace(ends[0].T @ ends[1]) - 1) / 2, -1, 1)))


def _rotation(value: Any) -> Any:
    try:
        rows = np.array(value, np.float64)
    except (TypeError, ValueError):
        return None
    return rows[:3, :3] if rows.ndim == 2 and min(rows.shape) >= 3 else None


def _numbers(value: Any, count: int) -> list[float] | None:
    ok = isinstance(value, list) and len(value) == count and all(isinstance(x, int | float) for x in value)
    return [float(x) for x in value] if ok else None
