"""Posed photographs from elsewhere: nerfstudio and instant-ngp `transforms.json`, and COLMAP models.

Whatever the source's lens, a reader returns the rig of the *undistorted* images and the lens that undoes distortion.
"""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.rigs import Rig, intrinsics, opengl_to_opencv

_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".JPG", ".JPEG", ".PNG")


@dataclass(frozen=True)
class DistortedPinhole:
    """A pinhole with OpenCV distortion: K [3,3] (pixel centres at +0.5) and (k1, k2, p1, p2, k3)."""

    K: NDArray[np.float64]
    distortion: tuple[float, float, float, float, float]

    def pinhole(self, width: int, height: int) -> NDArray[np.float64]:
        """Intrinsics [3,3] of the largest undistorted image of this size without empty borders."""
        if not any(self.distortion):
            return self.K
        import cv2

        shifted, _ = cv2.getOptimalNewCameraMatrix(_to_cv(self.K), np.array(self.distortion), (width, height), 0)
        return _from_cv(shifted)

    def undistort(self, image: NDArray[np.uint8], pinhole: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Resample a distorted image [h,w,3] to the pinhole camera `pinhole` [3,3]."""
        if not any(self.distortion):
            return image
        import cv2

        return cv2.undistort(image, _to_cv(self.K), np.array(self.distortion), newCameraMatrix=_to_cv(pinhole))


def _to_cv(K: NDArray[np.float64]) -> NDArray[np.float64]:
    return K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV counts pixel centres from 0


def _from_cv(K: NDArray[np.float64]) -> NDArray[np.float64]:
    return K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


@dataclass(frozen=True)
class Photographs:
    """Posed photographs in sorted order: names, image files, the pinhole rig, one lens per view."""

    names: tuple[str, ...]
    files: tuple[Path, ...]
    rig: Rig
    lenses: tuple[DistortedPinhole, ...]


def image_size(file: Path) -> tuple[int, int]:
    """Width and height of an image file, from its header alone."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(file) as image:
            return image.size
    except (OSError, UnidentifiedImageError) as error:
        raise ValueError(f"load_set: {file} is not a readable image ({error}); replace or remove it") from error


def _find(folder: Path, file_path: str) -> Path | None:
    return next((f for s in _SUFFIXES if (f := folder / (file_path + s)).is_file()), None)


def _collect(entries: list[tuple[Path | None, NDArray[np.float64], Any]], source: Path, lens_of: Any) -> Photographs:
    """Sort the entries by file, skip and count those without one, and bring all to one pinhole rig."""
    found = sorted(((f, v, c) for f, v, c in entries if f is not None), key=lambda e: str(e[0]))
    if not found:
        raise ValueError(
            f"load_set: none of the {len(entries)} images listed in {source} exists; put them where it says"
        )
    if len(found) < len(entries):
        warnings.warn(f"load_set: {len(entries) - len(found)} of {len(entries)} views listed in {source} have no image "
                      "file and are skipped", stacklevel=4)  # fmt: skip
    sizes = {image_size(f) for f, _, _ in found}
    if len(sizes) > 1:
        raise ValueError(f"load_set: the images of {source} must share one size, got {sorted(sizes)}; resize them "
                         "together with their intrinsics, or remove the odd ones")  # fmt: skip
    width, height = next(iter(sizes))
    lenses = tuple(lens_of(camera, width, height) for _, _, camera in found)
    Ks = np.stack([lens.pinhole(width, height) for lens in lenses])
    rig = Rig(viewmats=np.stack([v for _, v, _ in found]), Ks=Ks, width=width, height=height)
    files = tuple(f for f, _, _ in found)
    stems = [f.stem for f in files]
    if len(set(stems)) < len(stems):
        shared = Path(os.path.commonpath([f.parent for f in files]))  # whole paths differ between machines
        stems = [f.relative_to(shared).with_suffix("").as_posix().replace("/", "_") for f in files]
    return Photographs(tuple(stems), files, rig, lenses)


def read_transforms(folder: Path) -> Photographs:
    """Read a nerfstudio or instant-ngp `transforms.json` and its photographs.

    Raises:
        ValueError: If the file is not valid, the lens is not a pinhole with OpenCV distortion, no listed image exists,
            or sizes differ.
    """
    source = folder / "transforms.json"
    try:
        content = json.loads(source.read_text(encoding="utf-8"))
        frames = [({**content, **f}, f["file_path"], f["transform_matrix"]) for f in content["frames"]]
        poses = np.asarray([m for _, _, m in frames], dtype=np.float64).reshape(-1, 4, 4)
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"load_set: {source} must be JSON with frames of file_path and 4x4 transform_matrix "
                         f"({type(error).__name__}: {error})") from error  # fmt: skip
    viewmats = opengl_to_opencv(poses)
    entries = [(_find(folder, path), v, camera) for (camera, path, _), v in zip(frames, viewmats, strict=True)]
    return _collect(entries, source, lambda c, w, h: transforms_lens(c, w, h, source))


def transforms_lens(camera: dict[str, Any], width: int, height: int, source: Path) -> DistortedPinhole:
    """Intrinsics and distortion that a transforms.json states for images of this size.

    Args:
        camera: A frame's entries over those of the whole file.
        width: Of the image, px.
        height: Of the image, px.
        source: The file, for messages.

    Raises:
        ValueError: If it is not a pinhole with k1 k2 k3 p1 p2, or focal length or size is missing or wrong.
    """
    model = "OPENCV_FISHEYE" if camera.get("is_fisheye") else camera.get("camera_model", "OPENCV")
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL") or camera.get("k4"):
        raise ValueError(f"load_set: {source} has a {model} camera (k4 = {camera.get('k4', 0)}); only pinholes with "
                         "k1 k2 k3 p1 p2 are supported: undistort the images first")  # fmt: skip
    try:
        if "fl_x" in camera:
            fx = float(camera["fl_x"])
            K = np.array([[fx, 0, width / 2], [0, float(camera.get("fl_y", fx)), height / 2], [0, 0, 1]])
        else:
            K = intrinsics(int(camera.get("w", width)), height, np.degrees(float(camera["camera_angle_x"])))
        listed = float(camera.get("w", width)), float(camera.get("h", height))
        K[0, 2], K[1, 2] = float(camera.get("cx", listed[0] / 2)), float(camera.get("cy", listed[1] / 2))
        k1, k2, p1, p2, k3 = (float(camera.get(k, 0)) for k in ("k1", "k2", "p1", "p2", "k3"))
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"load_set: {source} needs fl_x or camera_angle_x as numbers ({error})") from error
    return DistortedPinhole(_rescale(K, listed, (width, height), source), (k1, k2, p1, p2, k3))


def _rescale(K: Any, listed: tuple[float, float], actual: tuple[int, int], source: Path) -> NDArray[np.float64]:
    """Follow images that were shrunk after their cameras were written down."""
    sx, sy = actual[0] / listed[0], actual[1] / listed[1]
    if abs(sx / sy - 1) > 0.01:
        raise ValueError(f"load_set: images are {actual[0]} x {actual[1]} but {source} says "
                         f"{listed[0]:g} x {listed[1]:g}, another shape; they do not belong together")  # fmt: skip
    return np.diag([sx, sy, 1.0]) @ K


def find_colmap(folder: Path) -> Path | None:
    """The folder of a COLMAP model (binary or text) inside `folder`, if there is one."""
    places = (folder / p for p in ("sparse/0", "sparse", "."))
    return next((p for p in places if any((p / f"cameras.{ext}").is_file() for ext in ("bin", "txt"))), None)


def read_colmap(folder: Path, model: Path) -> Photographs:
    """Read a COLMAP model and the photographs in `folder/images`.

    Raises:
        ValueError: If the model cannot be read, a lens is not a pinhole with OpenCV distortion, no image exists, or
            sizes differ.
    """
    reconstruction = read_reconstruction(model)
    entries = []
    for image in reconstruction.images.values():
        if not image.has_pose:
            continue
        viewmat = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        entries.append((_find(folder / "images", image.name), viewmat, reconstruction.cameras[image.camera_id]))
    return _collect(entries, model, lambda c, w, h: _colmap_lens(c, w, h, model))


def read_reconstruction(model: Path) -> Any:
    """Open a COLMAP model with pycolmap, with a clear error where it cannot."""
    import pycolmap

    try:
        return pycolmap.Reconstruction(str(model))
    except Exception as error:  # pycolmap raises several types, some of them its own
        raise ValueError(f"load_set: {model} is not a readable COLMAP model ({error})") from error


def _colmap_lens(camera: Any, width: int, height: int, source: Path) -> DistortedPinhole:
    names = [n.strip() for n in camera.params_info.split(",")]
    params = {n: float(p) for n, p in zip(names, camera.params, strict=True)}
    # COLMAP calls the radial terms of its one- and two-parameter models k, or k1 and k2.
    k1 = params["k"] if "k" in params else params.get("k1", 0.0)
    allowed = {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"}
    if camera.model_name not in allowed:
        raise ValueError(f"load_set: {source} has a {camera.model_name} camera, supported are {sorted(allowed)}; "
                         "run colmap image_undistorter first")  # fmt: skip
    K = np.asarray(camera.calibration_matrix(), dtype=np.float64)
    K = _rescale(K, (camera.width, camera.height), (width, height), source)
    return DistortedPinhole(K, (k1, params.get("k2", 0.0), params.get("p1", 0.0), params.get("p2", 0.0), 0.0))
