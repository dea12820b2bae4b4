"""COLMAP models (sparse/0) and the photographs beside them."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.door import resolved
from sensor_model.files.reading import brief, some
from simscenes.rigs import Rig
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.readers.colmap_check import Model, check_model, count_images, model_suffix, with_points
from simscenes.sets.readers.finding import find_files, spelt
from simscenes.sets.readers.photographs import DistortedPinhole, Photographs, check_pose, collect, rescaled
from simscenes.sets.readers.resized import named_pictures, picture_folder

SAME_POSE = 1e-5  # elements of one pose in two files differ by less: some programs write six digits
MASKS = "masks"  # where COLMAP's users and trainers of Gaussians keep the areas to be left out of each picture


def find_colmap(folder: Path) -> Path | None:
    """The folder of a COLMAP model (binary or text) inside `folder`, if there is one: of several the largest."""
    found = _largest(folder / "sparse") or (folder if is_model(folder) else None)
    if found is None and picture_folder(folder).is_dir():
        return _largest(folder / "colmap" / "sparse")  # nerfstudio's place
    return found


def _largest(place: Path) -> Path | None:
    models = models_in(place)
    if len(models) > 1:
        return max(models, key=count_images)  # the first of equals
    return models[0] if models else place if is_model(place) else None


def models_in(place: Path) -> list[Path]:
    """The models that COLMAP numbers in a folder, where it found the images in several pieces; in their order."""
    numbered = (path for path in place.glob("*") if re.fullmatch(r"\d{1,9}", path.name, re.ASCII) and is_model(path))
    return sorted(numbered, key=lambda path: (int(path.name), path.name))


def is_model(folder: Path) -> bool:
    """Whether a COLMAP model is here."""
    return any((folder / f"cameras.{suffix}").is_file() for suffix in ("bin", "txt"))


def read_colmap(folder: Path, model: Path) -> Photographs:
    """Read a COLMAP model and the photographs in `folder/images`, or `images_N` where that is missing.

    Raises:
        ValueError: If the model cannot be read, a lens is not a pinhole with OpenCV distortion, no image exists, or
            sizes differ.
    """
    names, viewmats, cameras = colmap_views(model)
    pictures = picture_folder(folder)
    files = named_pictures(pictures, names)
    there = [(name, file) for name, file in zip(names, files, strict=True) if file is not None]
    if pictures.name != "images" and there and not any(find_files(pictures, names)):
        name, file = min(there)
        warnings.warn(f"load_set: the pictures of {pictures} have other names than the images of {model}: paired by "
                      f"order, {name} with {file.name} and so on", stacklevel=3)  # fmt: skip
    below = [f"{pictures.name}/{name}" for name in names]
    if next((folder / MASKS).glob("*"), None) is not None:
        warnings.warn(f"load_set: {folder / MASKS} is not used: all pixels count", stacklevel=3)
    lens_of = partial(colmap_lens, source=model)
    return collect(files, viewmats, cameras, model, lens_of, spelt(folder, below, files))


def colmap_views(model: Path) -> tuple[list[str], list[NDArray[np.float64]], list[Any]]:
    """File names, world-to-camera [4,4] and cameras of the images of a COLMAP model that have a pose.

    Raises:
        ValueError: If the model cannot be read, or a pose is of no usable size. A warning counts others beside it.
    """
    beside = models_in(model.parent)
    if model in beside and len(beside) > 1:
        counts = [f"{path.name} has {count_images(path)} images" for path in beside]
        warnings.warn(f"load_set: of {len(beside)} COLMAP models in {model.parent}, {model.name} is taken: "
                      f"{some(counts, 8)}; the others have no part", stacklevel=4)  # fmt: skip
    reconstruction, names = read_reconstruction(model)
    posed = [image for image in reconstruction.images.values() if image.has_pose]
    viewmats = [np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]]) for image in posed]
    found = [names[image.image_id] for image in posed]
    for name, viewmat in zip(found, viewmats, strict=True):
        check_pose(viewmat, f"{model}: the pose of {name}")
    return found, viewmats, [reconstruction.cameras[image.camera_id] for image in posed]


def read_points(pictures: Path, model: Path, files: Sequence[Path], rig: Rig) -> SparsePoints | None:
    """The points of a COLMAP model and their tracks through some of its images; None if it has no points.

    Observations move with the pixels they were made in: through the model's own lens to the ray, and to the pixel that
    the pinhole `rig` has there. Errors are in pixels of `rig`, where the model states any.

    Args:
        pictures: Where the images of the model lie.
        model: The model.
        files: Images of the views; others of the model are left out, and so are views that it does not have.
        rig: One camera for each of `files`, in the frame of the model.

    Raises:
        ValueError: If the model is damaged.
    """
    reconstruction, names = read_reconstruction(model)
    if not reconstruction.points3D:
        return None
    row = {number: i for i, number in enumerate(sorted(reconstruction.points3D))}  # pycolmap's own order is a hash's
    points = [reconstruction.points3D[number] for number in row]
    found = SparsePoints.untracked([p.xyz for p in points], [p.color for p in points])
    found = replace(found, error=np.array([p.error for p in points], np.float64))
    views = {resolved(file): i for i, file in enumerate(files)}
    seen = [(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros((0, 2)))]
    posed = {number: image for number, image in reconstruction.images.items() if image.has_pose}
    there = named_pictures(pictures, [names[number] for number in posed])
    for image, file in zip(posed.values(), there, strict=True):
        if file is None or (i := views.get(resolved(file))) is None:
            continue
        observed = [p for p in image.points2D if p.has_point3D()]
        rays = image.camera.cam_from_img(np.array([p.xy for p in observed]).reshape(-1, 2))
        pixels = rays * np.diag(rig.Ks[i])[:2] + rig.Ks[i][:2, 2]
        rows = np.array([row[p.point3D_id] for p in observed], np.intp)
        seen.append((np.full(len(rows), i, np.intp), rows, pixels))
    view, point, pixel = (np.concatenate(parts) for parts in zip(*seen, strict=True))
    return found.observed(rig, view, point, pixel)


def read_reconstruction(model: Path) -> tuple[Any, dict[int, str]]:
    """Open a COLMAP model with pycolmap, which is shown nothing that is cut short or refers to missing entries.

    Returns:
        The model, and the name of each image by its number.

    Raises:
        ValueError: If the model is damaged, or its frames give an image another pose than images does.
    """
    import pycolmap

    stated = check_model(model)
    try:
        with with_points(model) as whole:
            found = pycolmap.Reconstruction(str(whole))
    except Exception as error:  # pycolmap raises several types, some of them its own
        raise ValueError(f"load_set: {model} is not a readable COLMAP model ({brief(error)})") from error
    _check_frames(found, stated, model)
    return found, stated.names


def _check_frames(found: Any, stated: Model, model: Path) -> None:
    """Poses are pycolmap's, from frames (COLMAP 3.12), which programs that know images alone leave unchanged."""
    import pycolmap

    apart = []
    for number, image in sorted(found.images.items()):
        turn, shift = np.split(np.array(stated.poses[number]), [4])
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.roll(turn, -1)), shift).matrix()  # pycolmap has w last
        if image.has_pose and not np.allclose(image.cam_from_world().matrix(), pose, SAME_POSE, SAME_POSE):
            apart.append(stated.names[number])
    if apart:
        suffix = model_suffix(model)
        raise ValueError(
            f"{model}: images.{suffix} and frames.{suffix} must give an image one pose, they differ for {len(apart)} "
            f"of {len(found.images)} ({some(apart)}): a program that does not know frames may have written images "
            f"alone; delete rigs.{suffix} and frames.{suffix} if images is right, else export the model again"
        )


def colmap_lens(camera: Any, width: int, height: int, source: Path) -> DistortedPinhole:
    """Intrinsics and distortion of a COLMAP camera for images of this size.

    Raises:
        ValueError: If it is not a pinhole with OpenCV distortion, or images have another shape.
    """
    names = [n.strip() for n in camera.params_info.split(",")]
    params = {n: float(p) for n, p in zip(names, camera.params, strict=True)}
    # COLMAP calls the radial terms of its one- and two-parameter models k, or k1 and k2.
    k1 = params["k"] if "k" in params else params.get("k1", 0.0)
    allowed = {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"}
    rational = any(params.get(f"k{i}") for i in range(4, 7))  # without these FULL_OPENCV is OPENCV and k3
    if camera.model_name not in allowed and (camera.model_name != "FULL_OPENCV" or rational):
        raise ValueError(f"load_set: {source} has a {camera.model_name} camera, supported are {sorted(allowed)}; "
                         "run colmap image_undistorter first")  # fmt: skip
    K = np.asarray(camera.calibration_matrix(), dtype=np.float64)
    K = rescaled(K, (camera.width, camera.height), (width, height), source)
    return DistortedPinhole(
        K, (k1, params.get("k2", 0.0), params.get("p1", 0.0), params.get("p2", 0.0), params.get("k3", 0.0))
    )
