"""LLFF scenes: the cameras in poses_bounds.npy, in the order of the names of the pictures in images/."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.door import admitted
from sensor_model.files.reading import reading
from simscenes.rigs import invert_rigid
from simscenes.sets.readers.photographs import DistortedPinhole, Photographs, check_pose, collect, rescaled
from simscenes.sets.readers.resized import picture_folder, sorted_pictures

POSES = "poses_bounds.npy"
SHOWN = 3  # names in a message


def is_llff(folder: Path) -> bool:
    """Whether a folder has this layout."""
    return (folder / POSES).is_file()


def read_llff(folder: Path) -> Photographs:
    """Read poses_bounds.npy and the pictures of images/, or of images_N/ where that is missing.

    Raises:
        ValueError: If the file is not valid, there are not as many pictures as cameras, or their sizes differ.
    """
    source, pictures = folder / POSES, picture_folder(folder)
    viewmats, sizes = llff_cameras(source)
    files = sorted_pictures(pictures)
    if len(files) != len(viewmats):
        names = ", ".join(file.name for file in files[:SHOWN]) or "none"
        raise ValueError(f"{source} has {len(viewmats)} cameras and {pictures} {len(files)} pictures ({names}, ...): "
                         "LLFF pairs them by order alone, so there must be one picture for each camera")  # fmt: skip
    return collect(files, list(viewmats), sizes, source, partial(llff_lens, source=source))


def llff_cameras(source: Path) -> tuple[NDArray[np.float64], list[tuple[float, float, float]]]:
    """World-to-camera [C,4,4] in OpenCV axes, and height, width and focal length of each camera, px.

    A row is a matrix [3,5], camera-to-world [R | t] and (height, width, focal length), then the least and the largest
    depth. The columns of R are the camera's axes down, right, backwards (https://github.com/Fyusion/LLFF).

    Raises:
        ValueError: If it is not such a file, or a pose or a size is out of range.
    """
    with reading(source):
        # Mapped, so that a damaged header, which may claim any size, is compared with the file before memory is taken.
        rows = np.load(admitted(source), allow_pickle=False, mmap_mode="r")
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind != "f":
        raise ValueError(f"{source} must hold 17 numbers for each camera, got {rows.dtype} {list(rows.shape)}")
    parts = rows[:, :15].astype(np.float64).reshape(-1, 3, 5)
    poses = np.zeros((len(parts), 4, 4))
    poses[:, 3, 3] = 1
    # down, right, backwards -> right, down, forward
    poses[:, :3, :4] = np.stack([parts[..., 1], parts[..., 0], -parts[..., 2], parts[..., 3]], -1)
    for i, (pose, size) in enumerate(zip(poses, parts[..., 4], strict=True)):
        check_pose(pose, f"{source}: the pose of camera {i}")
        if not (np.isfinite(size).all() and (size > 0).all() and (size < 1e7).all()):
            raise ValueError(f"{source}: height, width and focal length of camera {i} must lie between 0 and 1e7 px, "
                             f"got {size.tolist()}")  # fmt: skip
    return invert_rigid(poses), [(float(h), float(w), float(f)) for h, w, f in parts[..., 4]]


def llff_lens(camera: tuple[float, float, float], width: int, height: int, source: Path) -> DistortedPinhole:
    """Intrinsics for pictures of this size; the principal point is their middle.

    Raises:
        ValueError: If the pictures have another shape than the camera.
    """
    stated_height, stated_width, focal = camera
    K = np.array([[focal, 0, stated_width / 2], [0, focal, stated_height / 2], [0, 0, 1]])
    return DistortedPinhole(rescaled(K, (stated_width, stated_height), (width, height), source), (0.0,) * 5)
