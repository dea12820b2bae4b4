"""The multiview set, in memory and on disk: posed images, and for rendered ones the truth behind each pixel.

Images are uint8 sRGB [h,w,3], radiance is float32 linear RGB [h,w,3]. No mitsuba here.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.door import enter, resolved
from sensor_model.files.reading import some
from sensor_model.files.records import Numbers, read_record
from sensor_model.files.registry import Registry
from sensor_model.isp import srgb_to_linear
from simscenes.rigs import Rig
from simscenes.sets.geometry.tracks import SparsePoints, in_frame
from simscenes.sets.pictures.exr import read_exr
from simscenes.sets.pictures.image_file import WITH_ALPHA, has_alpha, read_light, read_rgb
from simscenes.sets.pictures.meaning import is_deep
from simscenes.sets.readers.bare import SUFFIXES, named_as_masks, picture_files
from simscenes.sets.readers.colmap import find_colmap, read_colmap, read_points
from simscenes.sets.readers.llff import is_llff
from simscenes.sets.readers.nerf_synthetic import is_nerf_synthetic
from simscenes.sets.readers.photographs import DistortedPinhole, Photographs, read_transforms
from simscenes.sets.readers.ply_points import is_ours, listed_points, read_ply_points
from simscenes.sets.readers.resized import picture_folder
from simscenes.sets.writers.camera_files import is_test_view, write_cameras

__all__ = ["MultiviewSet", "load_set", "write_cameras"]

Image = NDArray[np.uint8]
Float32 = NDArray[np.float32]
DEEP = (".png", ".tif", ".tiff")  # formats of photographs that can have 16 bits
GEOMETRY = ("Z", "distance", *(f"{kind}.{axis}" for kind in ("N", "Ng") for axis in "XYZ"),
            *(f"albedo.{c}" for c in "RGB"), "id", "material")  # fmt: skip
LEAST_SEEN = 0.01  # share of first points in some picture; of a scan of a whole house few are, of another frame none
# Cameras that no set made here has.
READERS: Registry[Callable[[Path], Photographs]] = Registry({
    "NeRF-synthetic": "simscenes.sets.readers.nerf_synthetic:read_nerf_synthetic",
    "LLFF": "simscenes.sets.readers.llff:read_llff",
})  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class MultiviewSet:
    """Posed images of one scene.

    Attributes:
        path: The folder.
        names: Of the views, and of their files in all products of the set: sorted as files (`sets.names`).
        rig: Pinhole cameras; of the undistorted images if the source had distortion.
        kind: "rendered" (radiance and geometry are known) or "photographs".
        meta: Content of set.json (or capture.json), {} for folders from elsewhere.
        held_out: Places of the views that the folder itself holds out; None: every 8th is.
        lit_alone: Places of held-out views whose only picture, in `files`, is a well-lit one, among dark ones.
        unregistered: Photographs of the same take that have no camera, as files relative to their folder.
        origin: Where the zero of `rig` and of the points lies in the coordinates of the folder's files.
    """

    path: Path
    names: tuple[str, ...]
    rig: Rig
    kind: Literal["rendered", "photographs"]
    meta: dict[str, Any]
    files: tuple[Path, ...] = field(repr=False)
    lenses: tuple[DistortedPinhole, ...] | None = field(default=None, repr=False)
    held_out: tuple[int, ...] | None = None
    lit_alone: tuple[int, ...] = ()
    unregistered: tuple[str, ...] = field(default=(), repr=False)
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __len__(self) -> int:
        return len(self.names)

    def about(self, origin: tuple[float, float, float]) -> MultiviewSet:
        """The same set in a world whose zero lies at `origin` of this one; itself if that is zero."""
        if not any(origin):
            return self
        x, y, z = (a + b for a, b in zip(self.origin, origin, strict=True))
        return replace(self, rig=self.rig.about(origin), origin=(x, y, z))

    @property
    def renamed(self) -> dict[str, str]:
        """File, relative to the folder, of the views that could not have its name, by the view's name."""
        pairs = zip(self.names, self.files, strict=True)
        return {name: os.path.relpath(file, self.path) for name, file in pairs if file.stem != name}

    @property
    def scene(self) -> str:
        """The scene's name: the name it was rendered by, else the folder's."""
        return str(self.meta.get("scene") or resolved(self.path).name)

    @property
    def test_indices(self) -> list[int]:
        """Held-out views: the folder's own, else every 8th in the order of their names, from 0."""
        return [i for i in range(len(self)) if is_test_view(i)] if self.held_out is None else list(self.held_out)

    @property
    def train_indices(self) -> list[int]:
        """All views but the held-out ones."""
        tested = set(self.test_indices)
        return [i for i in range(len(self)) if i not in tested]

    @property
    def transparent(self) -> bool:
        """Whether some photograph can be transparent: the background counts as white then."""
        clear = (file for file in self.files if file.suffix.lower() in WITH_ALPHA)
        return self.kind == "photographs" and any(has_alpha(file) for file in clear)

    def is_deep(self, i: int) -> bool:
        """Whether view `i` is a photograph of more than 8 bits, whose codes are light unless it says otherwise."""
        return self.kind == "photographs" and self.files[i].suffix.lower() in DEEP and is_deep(self.files[i])

    def image(self, i: int) -> Image:
        """The sRGB image of view `i`, uint8 [h,w,3], undistorted, before white where it is transparent.

        Raises:
            ValueError: If the file cannot be read.
        """
        rgb = read_rgb(self.files[i])
        if self.lenses is None:
            return rgb
        return self.lenses[i].undistort(rgb, self.rig.Ks[i])

    def radiance(self, i: int) -> Float32:
        """Linear RGB of view `i`, float32 [h,w,3]: the rendered radiance; of a photograph the light in its 16-bit
        codes, or the 8-bit image with sRGB undone.
        """
        if self.kind == "rendered":
            return _stack(self._truth(i, "R", "G", "B"), "R", "G", "B")
        if self.is_deep(i):
            light: NDArray[Any] = read_light(self.files[i])
            return np.asarray(
                light if self.lenses is None else self.lenses[i].undistort(light, self.rig.Ks[i]), np.float32
            )
        return srgb_to_linear(self.image(i) / np.float32(255))

    def variance(self, i: int) -> Float32 | None:
        """Estimated variance of `radiance(i)`, float32 [h,w,3]; None for photographs.

        Each value is the mean over 3 x 3 pixels, of which two passes give one degree of freedom each.
        """
        names = ("var.R", "var.G", "var.B")
        return _stack(self._truth(i, *names), *names) if self.kind == "rendered" else None

    def half(self, i: int) -> Float32 | None:
        """Half the difference between the two halves of the samples of view `i`, float32 [h,w,3].

        `radiance(i)` with it added and with it taken away are two independent renders. None for photographs, and for
        sets of versions that did not keep it.
        """
        if self.kind != "rendered":
            return None
        names, channels = ("half.R", "half.G", "half.B"), self._truth(i, "R")
        return _stack(channels, *names) if names[0] in channels else None

    def geometry(self, i: int) -> dict[str, NDArray[Any]] | None:
        """The surface that the ray through each pixel centre hits; None for photographs.

        Returns:
            "z" and "distance" float32 [h,w]; "normals" (shading) and "geometric_normals", both in world axes and facing
            the camera, and "albedo", float32 [h,w,3]; "id" and "material" uint32 [h,w] (legends in `meta`). Rays that
            hit nothing have an infinite "z" and "distance", and 0 elsewhere.
        """
        if self.kind != "rendered":
            return None
        channels = self._truth(i, *GEOMETRY)
        return {
            "z": channels["Z"],
            "distance": channels["distance"],
            "normals": _stack(channels, "N.X", "N.Y", "N.Z"),
            "geometric_normals": _stack(channels, "Ng.X", "Ng.Y", "Ng.Z"),
            "albedo": _stack(channels, "albedo.R", "albedo.G", "albedo.B"),
            "id": channels["id"],
            "material": channels["material"],
        }

    def points(self) -> SparsePoints | None:
        """Sparse points with their tracks through the views; None if the set has none in the frame of its cameras."""
        if (model := self.model()) is None:
            return None if (file := self.points_file) is None else self._listed_points(file)
        x, y, z = self.origin
        found = read_points(*model, self.files, self.rig.about((-x, -y, -z)))
        return None if found is None else found.about(self.origin)

    @property
    def points_file(self) -> Path | None:
        """The PLY file of first points that a foreign camera file names, and that is used; None: there is none."""
        return listed_points(self.path) if self.kind == "photographs" and self.model() is None else None

    def _listed_points(self, file: Path) -> SparsePoints:
        found = read_ply_points(file).about(self.origin)
        pixels, depths = self.rig.project(found.xyz)
        seen = int(in_frame(self.rig, pixels, depths).any(0).sum())
        if seen < LEAST_SEEN * len(found):
            raise ValueError(f"{file}: points must lie in the frame of the cameras, {seen} of {len(found)} are in a "
                             "picture: export both together, or remove ply_file_path")  # fmt: skip
        return found

    def model(self) -> tuple[Path, Path] | None:
        """Folders of the images and of the COLMAP model in the frame of the cameras; None without such a model."""
        # Beside a foreign transforms.json a COLMAP model may be in another frame (nerfstudio re-orients), so only our
        # own folders, which name it in nb-info.json, and pure COLMAP folders give points.
        ours = is_ours(self.path) or not (self.path / "transforms.json").is_file()
        model = find_colmap(self.path) if ours else None
        return None if model is None else (picture_folder(self.path), model)

    def _truth(self, i: int, *names: str) -> dict[str, NDArray[Any]]:
        """Channels of view `i`, all of them, each as large as the camera says."""
        path = self.path / "gt" / f"{self.names[i]}.exr"
        channels, _ = read_exr(path)
        if missing := [name for name in names if name not in channels]:
            raise ValueError(f"{path} lacks the channels {', '.join(missing)}: render the set again")
        if (shape := channels[names[0]].shape) != (self.rig.height, self.rig.width):
            raise ValueError(f"{path} must be {self.rig.width} x {self.rig.height} px, got {shape[1]} x {shape[0]}")
        return channels


def _stack(channels: dict[str, NDArray[Any]], *names: str) -> Float32:
    return np.stack([channels[n] for n in names], axis=-1).astype(np.float32)


def is_rendered(folder: Path) -> bool:
    """Whether a set folder holds a render, with its truth, rather than photographs."""
    return (folder / "gt").is_dir()


def load_set(path: str | Path) -> MultiviewSet:
    """Open a folder of posed images: our sets and captures, nerfstudio, instant-ngp, NeRF-synthetic, COLMAP or LLFF.

    Args:
        path: The folder. It holds set.json (rendered here), or transforms.json, or sparse/0 and images/, or
            transforms_train.json, or poses_bounds.npy and images/.

    Raises:
        ValueError: If the folder is of another kind, a render in it is unfinished, a camera file is broken or no image
            listed there exists. Listed images that are missing are skipped, counted and named in one warning.
    """
    path = Path(path)
    if not path.is_dir():
        raise ValueError(f"load_set: no such folder: {path}")
    enter(path)
    if is_rendered(path) and not (path / "set.json").is_file():
        raise ValueError(
            f"load_set: {path} holds an unfinished render (gt/ without set.json); run the render again, it resumes"
        )
    return _as_set(path, _read(path), _read_meta(path), "rendered" if is_rendered(path) else "photographs")


def load_photographs(path: Path) -> MultiviewSet:
    """Open a folder of photographs with cameras; errors as `load_set`. Files in gt/ beside them are not looked at.

    Some data sets call well-lit pictures so.
    """
    return _as_set(path, _read(path), {}, "photographs")


def _read(path: Path) -> Photographs:
    if (path / "transforms.json").is_file():
        return read_transforms(path)
    if model := find_colmap(path):
        return read_colmap(path, model)
    if is_nerf_synthetic(path):
        return READERS["NeRF-synthetic"](path)
    if is_llff(path):
        return READERS["LLFF"](path)
    raise ValueError(_no_set(path))


def _as_set(
    path: Path, found: Photographs, meta: dict[str, Any], kind: Literal["rendered", "photographs"]
) -> MultiviewSet:
    distorted = any(any(lens.distortion) for lens in found.lenses)
    lenses = found.lenses if distorted else None
    return MultiviewSet(
        path=path, names=found.names, rig=found.rig, kind=kind, meta=meta, files=found.files, lenses=lenses,
        held_out=found.held_out,
        unregistered=_unregistered(path, found, meta) if kind == "photographs" else (),
    )  # fmt: skip


def _unregistered(path: Path, found: Photographs, meta: dict[str, Any]) -> tuple[str, ...]:
    """As set.json says; without one, the pictures without a camera beside the pictures with one."""
    if meta:
        return tuple(meta.get("unregistered", ()))
    if is_nerf_synthetic(path):  # beside its pictures lie their depths and normals
        return ()
    placed = {os.path.abspath(file) for file in (*found.files, *found.unused)}
    suffixes = {file.suffix.lower() for file in found.files}
    every = (file for folder in {file.parent for file in found.files} for file in folder.iterdir())
    beside = [file for file in every if os.path.abspath(file) not in placed]
    drawn = [file for file in beside if file.suffix.lower() in SUFFIXES]
    masks = set(named_as_masks([*found.files, *drawn])).intersection(drawn)
    if masks:
        warnings.warn(f"load_set: {len(masks)} masks beside the pictures of {path} are not used "
                      f"({some(sorted(file.name for file in masks))}): all pixels count", stacklevel=4)  # fmt: skip
    left = [file for file in beside if file.suffix.lower() in suffixes and file not in masks]
    return tuple(sorted(os.path.relpath(file, path) for file in left if not file.name.startswith(".")))


def _no_set(path: Path) -> str:
    """Why a folder is not a set, and what to do about it."""
    if pictures := picture_files(path):
        return (f"{path} holds {len(pictures)} pictures without camera poses: find the poses first, with "
                f"novags poses {path} --out SET")  # fmt: skip
    return (f"load_set: {path} holds no set.json, no transforms.json (or transforms_train.json), no COLMAP model "
            "(sparse/0) and no poses_bounds.npy")  # fmt: skip


# Entries read from set.json, where there is one; a capture.json is its own writer's business.
EFFECT = {"name": str, "on": bool, "forced": bool, "contribution": (float, None), "bound": (float, None), "unit": str,
          "reason": str}  # fmt: skip
PLAN = {"effects": [EFFECT], "bound": (float, None), "unit": str, "seconds?": {"*": float},
        "biases?": {"*": (float, None)}}  # fmt: skip
SET = {
    "scene?": (str, None), "exposure_scale?": float, "camera_matrix?": Numbers(3, 3), "plan?": PLAN, "width?": int,
    "height?": int, "unregistered?": [str], "views?": {"*": {"relative_error": float, "fireflies": int}},
    "stage?": {"seconds": float, "peak_bytes": int, "config": dict, "files?": {"*": str}},
}  # fmt: skip


def _read_meta(path: Path) -> dict[str, Any]:
    for name, shape in (("set.json", SET), ("capture.json", dict)):
        if (path / name).is_file():
            meta: dict[str, Any] = read_record(path / name, shape, "make it again")
            if name == "set.json" and (scale := meta.get("exposure_scale", 1.0)) <= 0:
                raise ValueError(f"{path / name}: exposure_scale must be > 0, got {scale}; render the set again")
            if "camera_matrix" in meta and abs(np.linalg.det(np.array(meta["camera_matrix"], np.float64))) < 1e-9:
                raise ValueError(f"{path / name}: camera_matrix must be invertible; render the set again")
            return meta
    return {}
