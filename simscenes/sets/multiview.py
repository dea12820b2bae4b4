"""The multiview set, in memory and on disk: posed images, and for rendered ones the truth behind each pixel.

Images are uint8 sRGB [h,w,3], radiance is float32 linear RGB [h,w,3]. No mitsuba here.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sensor_model import srgb_to_linear
from simscenes.rigs import Rig
from simscenes.sets.camera_files import is_test_view, write_cameras
from simscenes.sets.exr import read_exr
from simscenes.sets.photographs import (
    DistortedPinhole,
    Photographs,
    find_colmap,
    read_colmap,
    read_reconstruction,
    read_transforms,
)

__all__ = ["MultiviewSet", "load_set", "write_cameras"]

Image = NDArray[np.uint8]
Float32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class MultiviewSet:
    """Posed images of one scene.

    Attributes:
        path: The folder.
        names: File stems in sorted order.
        rig: Pinhole cameras; of the undistorted images if the source had distortion.
        kind: "rendered" (radiance and geometry are known) or "photographs".
        meta: Content of set.json (or capture.json), {} for folders from elsewhere.
    """

    path: Path
    names: tuple[str, ...]
    rig: Rig
    kind: Literal["rendered", "photographs"]
    meta: dict[str, Any]
    files: tuple[Path, ...] = field(repr=False)
    lenses: tuple[DistortedPinhole, ...] | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.names)

    @property
    def test_indices(self) -> list[int]:
        """Held-out views: every 8th in sorted order, from 0."""
        return [i for i in range(len(self)) if is_test_view(i)]

    @property
    def train_indices(self) -> list[int]:
        """All views but the held-out ones."""
        return [i for i in range(len(self)) if not is_test_view(i)]

    def image(self, i: int) -> Image:
        """The sRGB image of view `i`, uint8 [h,w,3], undistorted.

        Raises:
            ValueError: If the file cannot be read.
        """
        import cv2

        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION  # poses refer to the pixels as stored
        pixels = cv2.imread(str(self.files[i]), flags)
        if pixels is None:
            raise ValueError(f"image: {self.files[i]} is missing or not a readable image")
        rgb = np.ascontiguousarray(pixels[..., ::-1])
        if self.lenses is None:
            return rgb
        return self.lenses[i].undistort(rgb, self.rig.Ks[i])

    def radiance(self, i: int) -> Float32:
        """Linear RGB of view `i`, float32 [h,w,3]: the rendered radiance, else the image with sRGB undone."""
        if self.kind == "rendered":
            return _stack(read_exr(self._gt(i))[0], "R", "G", "B")
        return srgb_to_linear(self.image(i) / np.float32(255))

    def variance(self, i: int) -> Float32 | None:
        """Estimated variance of `radiance(i)`, float32 [h,w,3]; None for photographs."""
        return _stack(read_exr(self._gt(i))[0], "var.R", "var.G", "var.B") if self.kind == "rendered" else None

    def geometry(self, i: int) -> dict[str, NDArray[Any]] | None:
        """What the ray through each pixel centre hits; None for photographs.

        Returns:
            "z" and "distance" float32 [h,w], inf where there is no surface; "normals" (shading) and
            "geometric_normals", both in world axes and facing the camera, and "albedo", float32 [h,w,3], 0 where there
            is no surface; "id" and "material" uint32 [h,w], 0 where there is no surface (legends in `meta`).
        """
        if self.kind != "rendered":
            return None
        channels, _ = read_exr(self._gt(i))
        return {
            "z": channels["Z"],
            "distance": channels["distance"],
            "normals": _stack(channels, "N.X", "N.Y", "N.Z"),
            "geometric_normals": _stack(channels, "Ng.X", "Ng.Y", "Ng.Z"),
            "albedo": _stack(channels, "albedo.R", "albedo.G", "albedo.B"),
            "id": channels["id"],
            "material": channels["material"],
        }

    def points(self) -> tuple[NDArray[np.float64], Image] | None:
        """Sparse points, float64 [P,3], and their colours, uint8 [P,3]; None if there are none in the views' frame."""
        # Beside a foreign transforms.json a COLMAP model may be in another frame (nerfstudio re-orients), so only our
        # own folders, which name it in nb-info.json, and pure COLMAP folders give points.
        ours = (self.path / "nb-info.json").is_file() or not (self.path / "transforms.json").is_file()
        model = find_colmap(self.path) if ours else None
        points = list(read_reconstruction(model).points3D.values()) if model else []
        if not points:
            return None
        return np.array([p.xyz for p in points], np.float64), np.array([p.color for p in points], np.uint8)

    def _gt(self, i: int) -> Path:
        return self.path / "gt" / f"{self.names[i]}.exr"


def _stack(channels: dict[str, NDArray[Any]], *names: str) -> Float32:
    return np.stack([channels[n] for n in names], axis=-1).astype(np.float32)


def load_set(path: str | Path) -> MultiviewSet:
    """Open a folder of posed images: our sets and captures, nerfstudio or instant-ngp data, or a COLMAP model.

    Args:
        path: The folder. It holds set.json (rendered here), or transforms.json, or sparse/0 and images/.

    Raises:
        ValueError: If the folder is none of these, a render in it is unfinished, a camera file is broken or no image
            listed there exists. Listed images that are missing are skipped and counted in one warning.
    """
    path = Path(path)
    if not path.is_dir():
        raise ValueError(f"load_set: no such folder: {path}")
    if (path / "gt").is_dir() and not (path / "set.json").is_file():
        raise ValueError(
            f"load_set: {path} holds an unfinished render (gt/ without set.json); run the render again, it resumes"
        )
    meta = _read_meta(path)
    if (path / "transforms.json").is_file():
        found = read_transforms(path)
    elif model := find_colmap(path):
        found = read_colmap(path, model)
    else:
        raise ValueError(f"load_set: {path} holds no set.json, no transforms.json and no COLMAP model (sparse/0)")
    return _as_set(path, found, meta)


def _as_set(path: Path, found: Photographs, meta: dict[str, Any]) -> MultiviewSet:
    kind: Literal["rendered", "photographs"] = "rendered" if (path / "gt").is_dir() else "photographs"
    distorted = any(any(lens.distortion) for lens in found.lenses)
    lenses = found.lenses if distorted else None
    return MultiviewSet(
        path=path, names=found.names, rig=found.rig, kind=kind, meta=meta, files=found.files, lenses=lenses
    )


def _read_meta(path: Path) -> dict[str, Any]:
    for name in ("set.json", "capture.json"):
        if (path / name).is_file():
            try:
                return dict(json.loads((path / name).read_text(encoding="utf-8")))
            except ValueError as error:
                raise ValueError(f"load_set: {path / name} is not valid JSON ({error})") from error
    return {}
