"""Posed photographs from elsewhere, as nerfstudio and instant-ngp list them: `transforms.json`.

For any lens of the source, a reader returns the rig of the *undistorted* images and the lens that undoes distortion.
"""

from __future__ import annotations

import os
import warnings
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.reading import reading, some
from sensor_model.files.records import Numbers, check_shape, read_record
from simscenes.rigs import MAX_ROTATION_ERROR, Rig, opengl_to_opencv, rotation_error
from simscenes.sets.names import file_of, view_names
from simscenes.sets.pictures.image_file import image_size
from simscenes.sets.readers.entries import PINHOLES, check_entries, without_nulls
from simscenes.sets.readers.finding import find_file as find_file
from simscenes.sets.readers.finding import find_files, spelt
from simscenes.sets.readers.focal import FOCAL, FOCAL_X, FOCAL_Y, contradictions, first_focal, focal_length
from simscenes.sets.readers.lens import DistortedPinhole
from simscenes.sets.readers.ply_points import notes_on_points
from simscenes.sets.readers.split import SPLIT, split_of

# Entries read from a camera file, of the whole set or of one frame.
NUMBERS = (*FOCAL, "w", "h", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2")
LISTED = ("k1", "k2", "k3", "k4", "p1", "p2")  # in the order of nerfstudio's "distortion_params"
LENS = dict.fromkeys((f"{key}?" for key in NUMBERS), float) | {
    "camera_model?": str, "is_fisheye?": (bool, int), "distortion_params?": Numbers(len(LISTED))
}  # fmt: skip
POSE = (Numbers(4, 4), Numbers(3, 4))  # the last row of a pose is always the same, and some leave it out
TRANSFORMS = {**LENS, **SPLIT, "ply_file_path?": str, "frames": [
    {**LENS, "file_path": str, "transform_matrix": POSE, "mask_path?": (str, None)}
]}  # fmt: skip
# Beyond these no lens makes sense, and float32, in which pictures are rendered, would overflow. Pixels, rad, OpenCV's.
RANGES = dict.fromkeys(("w", "h", "fl_x", "fl_y"), (0.0, 1e7)) | dict.fromkeys(("cx", "cy"), (-1e7, 1e7))
RANGES |= dict.fromkeys(("camera_angle_x", "camera_angle_y"), (0.0, np.pi)) | dict.fromkeys(
    ("x_fov", "y_fov", "fovx", "fovy"), (0.0, 180.0)
)
RANGES |= dict.fromkeys(("k1", "k2", "k3", "p1", "p2"), (-100.0, 100.0))
Poses = list[NDArray[np.float64]]
MAX_COORDINATE = 1e12  # of a camera; float64 then still resolves a tenth of a millimetre in metres


@dataclass(frozen=True)
class FrameEntry:
    """An entry of a transforms.json but for its pose: its camera (over the file's camera) and image.

    `use` is the purpose its file states for it; None: not stated.
    """

    camera: dict[str, Any]
    file_path: str
    use: Literal["train", "test", "none"] | None = None


@dataclass(frozen=True)
class Photographs:
    """Posed photographs in the order of their names: names, image files, the pinhole rig, one lens per view.

    `held_out` are the views that their source holds out for testing; None: it does not say. `unused` are images that it
    lists and uses for nothing.
    """

    names: tuple[str, ...]
    files: tuple[Path, ...]
    rig: Rig
    lenses: tuple[DistortedPinhole, ...]
    held_out: tuple[int, ...] | None = None
    unused: tuple[Path, ...] = ()

    def holding_out(self, tested: Collection[Path], source: Path) -> Photographs:
        """The same with these files held out.

        Raises:
            ValueError: Naming `source`, if nothing is left to train on.
        """
        return replace(self, held_out=held_out(self.files, tested, source))


def held_out(files: Sequence[Path], tested: Collection[Path], source: Path) -> tuple[int, ...] | None:
    """Indices of the tested files; None if no file is tested.

    Raises:
        ValueError: Naming `source`, if nothing is left to train on.
    """
    found = tuple(i for i, file in enumerate(files) if file in tested)
    if found and len(found) == len(files) > 1:  # a single view is every eighth
        raise ValueError(f"{source} holds every image out for testing: list some for training")
    return found or None


def names_for_testing(source: Path) -> list[str]:
    """`file_path` of the frames that a transforms.json holds out; [] where it does not say."""
    frames, _, _ = _frames(source)
    return [frame.file_path for frame in frames if frame.use == "test"]


def transforms_frames(source: Path) -> tuple[list[FrameEntry], Poses]:
    """The frames that a nerfstudio or instant-ngp transforms.json lists, checked, without the frames it leaves out.

    Warnings name the frames it leaves out, and its entries that are not used here.

    Returns:
        The frames, and the pose of each: camera-to-world [4,4] in OpenGL axes.

    Raises:
        ValueError: If the file is not valid, or a pose is not a rotation and a translation.
    """
    frames, poses = _all_frames(source)
    used = [i for i, frame in enumerate(frames) if frame.use != "none"]
    return [frames[i] for i in used], [poses[i] for i in used]


def _all_frames(source: Path) -> tuple[list[FrameEntry], Poses]:
    frames, poses, notes = _frames(source)
    for note in notes:
        warnings.warn(f"load_set: {note}", stacklevel=4)
    return frames, poses


def _frames(source: Path) -> tuple[list[FrameEntry], Poses, list[str]]:
    """All frames of a file and their poses, checked, and notes for the user."""
    content = read_content(source)
    split = split_of(content, source)
    shared = {key: value for key, value in content.items() if key != "frames"}
    frames, poses = [], []
    for i, entry in enumerate(content["frames"]):
        pose = np.array([*entry["transform_matrix"][:3], [0, 0, 0, 1]], np.float64)
        where = f"{source}: frames[{i}].transform_matrix"
        last = np.array(entry["transform_matrix"][3:] or [[0, 0, 0, 1]], np.float64)[0]
        if np.abs(last - [0, 0, 0, 1]).max() > 1e-6:  # other tools write a rounded inverse
            raise ValueError(f"{where} must end in the row 0 0 0 1 (is it transposed?), got {last.tolist()}")
        check_pose(pose, where)
        use = None if split is None else split.use(i)
        poses.append(pose)
        frames.append(FrameEntry(_camera(shared, entry), entry["file_path"], use))
    masked = sum(bool(entry.get("mask_path")) for entry in content["frames"])
    notes = [] if split is None else list(split.notes)
    notes += check_entries(content, source, first_focal([frame.camera for frame in frames]))
    notes += notes_on_points(content, source)
    notes += contradictions([frame.camera for frame in frames], source)
    if masked:
        notes.append(f"{masked} of {len(frames)} frames of {source} have a mask (mask_path): masks are not used, all "
                     "pixels count")  # fmt: skip
    return frames, poses, notes


def read_content(source: Path) -> dict[str, Any]:
    """What a transforms.json holds, of the shape that readers rely on, without entries that are null.

    Raises:
        ValueError: If it is of another shape, or of a camera that is not a pinhole.
    """
    content = without_nulls(read_record(source, {"frames": [dict]}))
    for one in (content, *content["frames"]):
        model = one.get("camera_model", PINHOLES[0])
        # Before the shape: the numbers of another lens are of another number.
        if isinstance(model, str) and model.upper() not in PINHOLES:
            raise ValueError(_no_pinhole(source, model, one.get("k4", 0)))
    check_shape(content, TRANSFORMS, f"{source}", "correct it or put the original back")
    return dict(content)


def _no_pinhole(source: Path, model: str, k4: Any) -> str:
    return (f"load_set: {source} has a {model} camera (k4 = {k4}); only pinholes with k1 k2 k3 p1 p2 are supported: "
            "undistort the images first")  # fmt: skip


def _camera(shared: dict[str, Any], entry: dict[str, Any]) -> dict[str, Any]:
    """The frame's entries over the file's; where it states a focal length or distortion, none of the file's counts."""
    own: tuple[str, ...] = FOCAL if any(key in entry for key in FOCAL) else ()
    own += ("distortion_params",) if any(key in entry for key in LISTED) else ()
    return {key: value for key, value in shared.items() if key not in own} | entry


def check_pose(pose: NDArray[np.float64], where: str) -> None:
    """Refuse matrices that cannot be a camera's pose: [4,4] must be a rotation and a translation of usable size.

    Raises:
        ValueError: Naming `where`.
    """
    if not np.isfinite(pose).all() or np.abs(pose[:3, 3]).max() > MAX_COORDINATE:
        raise ValueError(f"{where} must be finite, with coordinates up to {MAX_COORDINATE:g}")
    if not (error := rotation_error(pose[:3, :3])) <= MAX_ROTATION_ERROR:
        got = ("it mirrors, as if one axis or three had been turned round" if np.isinf(error) else
               f"R R^T differs from the identity by {error:.3g}")  # fmt: skip
        raise ValueError(f"{where} must be a rotation and a translation (no scale, no mirror); {got}")


def listed(files: Sequence[Path | None], source: Path, names: Sequence[str] = ()) -> dict[str, int]:
    """The images that `source` lists and that exist: places in `files` by the name of the view, in the order of the
    views.

    Args:
        files: The file of each image; None: not there.
        source: For messages.
        names: Names of the images in messages, as `spelt` makes it; (): images that are missing are counted only.

    Raises:
        ValueError: If no photograph is there, or one file is listed twice. Missing ones are counted and named in one
            warning.
    """
    there = {i: file for i, file in enumerate(files) if file is not None}
    missing = some(sorted(name for name, file in zip(names, files, strict=bool(names)) if file is None))
    if not there:
        raise ValueError(f"load_set: none of the {len(files)} images listed in {source} exists"
                         f"{missing and f': {missing}'}; put them where it says, under these names, or correct the "
                         "names in it")  # fmt: skip
    if len(there) < len(files):
        warnings.warn(f"load_set: {len(files) - len(there)} of {len(files)} views listed in {source} have no image "
                      f"file and are skipped{missing and f': {missing}'}", stacklevel=5)  # fmt: skip
    for path, count in Counter(map(os.path.abspath, there.values())).items():
        if count > 1:
            raise ValueError(f"{source} lists {path} {count} times: keep one, else a held-out view would be trained on")
        if not _is_text(path):
            raise ValueError(f"the name of {path!r}, listed in {source}, is not valid UTF-8: rename it")
    named = dict(zip(view_names(list(there.values())), there, strict=True))
    return {name: named[name] for name in sorted(named, key=file_of)}


def _is_text(path: str) -> bool:
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True


def collect(
    files: Sequence[Path | None],
    viewmats: Sequence[NDArray[np.float64]],
    cameras: Sequence[Any],
    source: Path,
    lens_of: Callable[[Any, int, int], DistortedPinhole],
    names: Sequence[str] = (),
) -> Photographs:
    """Bring the existing images that `source` lists to one pinhole rig.

    Args:
        files: The file of each image; None: not there.
        viewmats: World-to-camera [4,4] of each.
        cameras: The camera of each, as its source states it.
        source: For messages.
        lens_of: The lens of a camera, for images of a width and a height.
        names: As for `listed`.

    Raises:
        ValueError: As `listed`, and if sizes differ or a camera is not valid.
    """
    there = listed(files, source, names)
    paths = tuple(file for i in there.values() if (file := files[i]) is not None)
    sizes = {image_size(file): file for file in paths}
    if len(sizes) > 1:
        above = os.path.commonpath([os.path.abspath(file.parent) for file in paths])
        below = {size: Path(os.path.relpath(file, above)).as_posix() for size, file in sizes.items()}
        got = ", ".join(f"{w} x {h} ({name})" for (w, h), name in sorted(below.items())[:4])
        raise ValueError(f"load_set: the images of {source} must share one size, got {got}; resize them together with "
                         "their intrinsics, remove the odd ones, or, where their distortion was undone one by one "
                         "(dense/ of COLMAP), take the pictures and the model from before that")  # fmt: skip
    width, height = next(iter(sizes))
    rig, lenses = rig_of(there.values(), viewmats, cameras, source, lens_of, (width, height))
    return Photographs(tuple(there), paths, rig, lenses)


def rig_of(
    chosen: Collection[int], viewmats: Sequence[NDArray[np.float64]], cameras: Sequence[Any], source: Path,
    lens_of: Callable[[Any, int, int], DistortedPinhole], size: tuple[int, int],
) -> tuple[Rig, tuple[DistortedPinhole, ...]]:  # fmt: skip
    """The pinhole rig of some of the cameras that `source` lists, and their lenses; arguments as for `collect`."""
    with reading(source):
        lenses = tuple(lens_of(cameras[i], *size) for i in chosen)
        Ks = np.stack([_pinhole_of(lens, size, source) for lens in lenses])
        if worst := max((lens.folded(*size) for lens in lenses), default=0.0):
            turn = min(lens.turn_px() for lens in lenses)
            warnings.warn(f"load_set: the distortion that {source} states turns {turn:.0f} px from the centre of the "
                          f"picture: up to {worst:.1%} of each picture lies beyond, belongs to no ray, and is cut off",
                          stacklevel=5)  # fmt: skip
        return Rig(viewmats=np.stack([viewmats[i] for i in chosen]), Ks=Ks, width=size[0], height=size[1]), lenses


def _pinhole_of(lens: DistortedPinhole, size: tuple[int, int], source: Path) -> NDArray[np.float64]:
    try:
        return lens.pinhole(*size)
    except ValueError as error:
        raise ValueError(f"load_set: {source}: {error}") from error


def read_transforms(folder: Path) -> Photographs:
    """Read a nerfstudio or instant-ngp `transforms.json` and its photographs.

    Raises:
        ValueError: If the file is not valid, the lens is not a pinhole with OpenCV distortion, no listed image exists,
            or sizes differ.
    """
    source = folder / "transforms.json"
    every, poses = _all_frames(source)
    files = find_files(folder, [frame.file_path for frame in every])
    used = [i for i, frame in enumerate(every) if frame.use != "none"]
    found = frames_at([files[i] for i in used], [every[i] for i in used], [poses[i] for i in used], folder, source)
    unused = (file for file, frame in zip(files, every, strict=True) if frame.use == "none" and file is not None)
    return replace(found, unused=tuple(unused))


def frames_at(
    files: Sequence[Path | None], frames: Sequence[FrameEntry], poses: Poses, folder: Path, source: Path
) -> Photographs:  # fmt: skip
    """The photographs of these files (None: not there) and frames, with those held out that are for testing.

    Args:
        files: Of the images.
        frames: Of each image.
        poses: As `transforms_frames` gives them.
        folder: What the names of the images are relative to.
        source: The camera file, for messages.

    Raises:
        ValueError: As `collect`, and if images are held out and none of them is there, or nothing is left to train on.
    """
    there = collect(
        files, [opengl_to_opencv(pose) for pose in poses], [frame.camera for frame in frames], source,
        lambda c, w, h: transforms_lens(c, w, h, source), spelt(folder, [frame.file_path for frame in frames], files),
    )  # fmt: skip
    tested = [(file, frame.file_path) for file, frame in zip(files, frames, strict=True) if frame.use == "test"]
    if tested and not any(file for file, _ in tested):
        raise ValueError(f"load_set: none of the {len(tested)} images that {folder} holds out for testing exists "
                         f"({some([name for _, name in tested])}); put some there, or hold out others")  # fmt: skip
    return there.holding_out({file for file, _ in tested if file is not None}, source)


def transforms_lens(camera: dict[str, Any], width: int, height: int, source: Path) -> DistortedPinhole:
    """Intrinsics and distortion that a transforms.json states for images of this size.

    Args:
        camera: A frame's entries over the entries of the whole file.
        width: Of the image, px.
        height: Of the image, px.
        source: The file, for messages.

    Raises:
        ValueError: If it is not a pinhole with k1 k2 k3 p1 p2, or focal length or size is missing or wrong.
    """
    # As nerfstudio 1.1.5 does: where there is a list, it counts, and not the single numbers.
    camera = {**camera, **dict(zip(LISTED, camera.get("distortion_params", ()), strict=False))}
    model = "OPENCV_FISHEYE" if camera.get("is_fisheye") else camera.get("camera_model", "OPENCV").upper()
    if model not in PINHOLES or camera.get("k4"):
        raise ValueError(_no_pinhole(source, model, camera.get("k4", 0)))
    for key, (low, high) in RANGES.items():
        if key in camera and not low < camera[key] < high:
            raise ValueError(f"load_set: {source}: {key} must lie between {low:g} and {high:g}, got {camera[key]:.3g}")
    listed = float(camera.get("w", width)), float(camera.get("h", height))
    for key, size, centre, side in (("w", "width", "cx", width), ("h", "height", "cy", height)):
        if key not in camera and centre in camera and not 1 / 4 < camera[centre] / side < 3 / 4:
            raise ValueError(f"load_set: {source} states no {key}: {centre} must lie in the middle half of the "
                             f"pictures, got {camera[centre]:g} px of a {size} of {side} px; add w and h, the size of "
                             "the pictures that the camera was found with (were they shrunk since?)")  # fmt: skip
    fx, fy = (focal_length(camera, keys, side) for keys, side in zip((FOCAL_X, FOCAL_Y), listed, strict=True))
    fx, fy = fx or fy, fy or fx
    if fx is None or fy is None:
        raise ValueError(f"load_set: {source} needs a focal length as a number, got none of {', '.join(FOCAL)}")
    if not max(fx, fy) < RANGES["fl_x"][1]:
        raise ValueError(f"load_set: {source}: angles must give a focal length below {RANGES['fl_x'][1]:g} px, got "
                         f"{max(fx, fy):.3g} px: correct the given ones of {', '.join(FOCAL)}")  # fmt: skip
    cx, cy = (float(camera.get(key, side / 2)) for key, side in zip(("cx", "cy"), listed, strict=True))
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    k1, k2, p1, p2, k3 = (float(camera.get(k, 0)) for k in ("k1", "k2", "p1", "p2", "k3"))
    return DistortedPinhole(rescaled(K, listed, (width, height), source), (k1, k2, p1, p2, k3))


def rescaled(K: Any, listed: tuple[float, float], actual: tuple[int, int], source: Path) -> NDArray[np.float64]:
    """Follow images that were shrunk after their cameras were written down."""
    sx, sy = actual[0] / listed[0], actual[1] / listed[1]
    if abs(sx / sy - 1) > 0.01:
        raise ValueError(f"load_set: images are {actual[0]} x {actual[1]} but {source} says "
                         f"{listed[0]:g} x {listed[1]:g}, another shape; they do not belong together")  # fmt: skip
    return np.diag([sx, sy, 1.0]) @ K
