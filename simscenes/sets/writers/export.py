"""Copies of a set or a capture in the two other layouts the field reads: Blender (NeRF synthetic) and LLFF."""

from __future__ import annotations

import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.atomic import atomic
from sensor_model.files.door import admitted
from simscenes.rigs import Rig, opencv_to_opengl
from simscenes.sets.geometry.depth_range import Depths
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.names import file_of
from simscenes.sets.pictures.png import write_png
from simscenes.sets.writers.camera_files import nerfbaselines_info, write_cameras, write_json
from simscenes.sets.writers.layouts import Layout

NERFBASELINES = "nerfbaselines.datasets.blender:load_blender_dataset"  # it has no short name there
CENTRED = 0.01  # px that a principal point may be off without a word
OFF_CENTRE = 0.02  # of the longer side, from which on it is another camera
NEAR, FAR = 2.0, 6.0  # between which the readers of the Blender layout look, with any file


def check_blender(rig: Rig) -> None:
    """Raise ValueError unless all cameras are one centred pinhole: the Blender layout describes no other."""
    K = rig.Ks[0]
    centred = np.allclose(K[:2, 2], (rig.width / 2, rig.height / 2), atol=1e-6) and np.isclose(K[0, 0], K[1, 1])
    if not centred or not np.allclose(rig.Ks, K):
        raise ValueError("the Blender layout holds one field of view for all: cameras must share intrinsics with "
                         "square pixels and a centred principal point; use the set's own transforms.json")  # fmt: skip


def check_llff(rig: Rig) -> None:
    """Raise ValueError unless each camera has square pixels and its principal point in the middle of the picture.

    The LLFF layout holds nothing else. Photographs are a little off: up to `OFF_CENTRE` the export warns instead.
    """
    fx, fy = rig.Ks[:, 0, 0], rig.Ks[:, 1, 1]
    if not np.allclose(fx, fy):
        i = int(np.abs(fx / fy - 1).argmax())
        raise ValueError(f"the LLFF layout holds one focal length per view, so pixels must be square; view {i} has "
                         f"{fx[i]:.2f} and {fy[i]:.2f} px. Use the set's own transforms.json")  # fmt: skip
    away, i = _off_centre(rig)
    if away > OFF_CENTRE * max(rig.width, rig.height):
        raise ValueError(f"the LLFF layout has the principal point in the middle of the picture; in view {i} it is "
                         f"{away:.2f} px away. Use the set's own transforms.json")  # fmt: skip


def _off_centre(rig: Rig) -> tuple[float, int]:
    """How far the principal point is from the middle of the picture at most, pixels, and in which view."""
    away = np.abs(rig.Ks[:, :2, 2] - (rig.width / 2, rig.height / 2)).max(1)
    return float(away.max()), int(away.argmax())


def export_blender(views: MultiviewSet, folder: str | Path, *, truth: MultiviewSet | None = None) -> Path:
    """Write transforms_train.json, transforms_val.json and transforms_test.json, with RGBA images beside them.

    The world is moved and scaled, x' = scene_scale (x - scene_center), so that the scene is about the origin and
    visible surfaces lie between `NEAR` and `FAR`; both numbers are in every file. Alpha is 0 where a pixel's centre
    sees no surface, which takes a rendered set; photographs are opaque. Of pictures that are not square nerfbaselines
    1.2 puts the optical axis at row width / 2; other readers do not.

    Args:
        views: The set, or a capture.
        folder: Created if missing. The held-out views serve as both val and test.
        truth: The rendered set that a capture was made of.

    Raises:
        ValueError: If the cameras are not all one centred pinhole, which is all this layout can describe. Where no
            scale can bring all of the scene between `NEAR` and `FAR`, a warning says how much stays outside; the world
            stays unchanged, with a warning, where it is not known how far away the scene is.
    """
    folder, rig = Path(folder), views.rig
    check_blender(rig)
    K = rig.Ks[0]
    scale, center = _frame(views, truth)
    poses = opencv_to_opengl(rig.viewmats)
    poses[:, :3, 3] = scale * (poses[:, :3, 3] - center)
    shared = {"camera_angle_x": float(2 * np.arctan(rig.width / 2 / K[0, 0])), "w": rig.width, "h": rig.height,
              "scene_scale": scale, "scene_center": center.tolist()}  # fmt: skip
    for split, indices in (("train", views.train_indices), ("val", views.test_indices), ("test", views.test_indices)):
        (folder / split).mkdir(parents=True, exist_ok=True)
        frames: list[dict[str, Any]] = []
        for i in indices:
            seen = _surface(truth or views, i, (rig.height, rig.width))
            write_png(folder / split / file_of(views.names[i]), np.dstack([views.image(i), seen]))
            frames.append({"file_path": f"./{split}/{views.names[i]}", "transform_matrix": poses[i].tolist()})
        write_json(folder / f"transforms_{split}.json", {**shared, "frames": frames})
    info = {"loader": NERFBASELINES, "id": "novags", "evaluation_protocol": "nerf", "type": "object-centric"}
    write_json(folder / "nb-info.json", {**nerfbaselines_info(views.scene), "loader_kwargs": {}, **info})
    return folder


def _frame(views: MultiviewSet, truth: MultiviewSet | None) -> tuple[float, NDArray[np.float64]]:
    """Scale and centre of the world that `export_blender` writes."""
    try:
        scale, center, outside = Depths.of(views, truth).fit(NEAR, FAR)
    except ValueError as error:
        warnings.warn(f"{error}; the Blender layout keeps the world unchanged, though its readers look between "
                      f"near {NEAR:g} and far {FAR:g} alone", stacklevel=3)  # fmt: skip
        return 1.0, np.zeros(3)
    if outside:
        warnings.warn(f"no scale brings the whole scene between near {NEAR:g} and far {FAR:g}, where readers of the "
                      f"Blender layout look: {100 * outside:.2g} % of it stays outside", stacklevel=3)  # fmt: skip
    return scale, center


def _surface(truth: MultiviewSet, i: int, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Alpha [h,w] of view `i`: 255 where a surface is, or nobody knows."""
    geometry = truth.geometry(i)
    if geometry is None:
        return np.full(size, 255, np.uint8)
    import cv2

    seen = np.where(np.isfinite(geometry["z"]), np.uint8(255), np.uint8(0))
    return np.asarray(cv2.resize(seen, size[::-1], interpolation=cv2.INTER_NEAREST), np.uint8)


def export_llff(views: MultiviewSet, folder: str | Path, *, truth: MultiviewSet | None = None) -> Path:
    """Write images/ and poses_bounds.npy [n,17]: pose columns (down, right, back, centre, [h, w, f]), near and far.

    A COLMAP model and nb-info.json lie beside them.

    Raises:
        ValueError: If nobody knows near and far of a view, the focal lengths of a camera differ, or its principal point
            is far from the middle of the picture. A little beside it gives a warning.
    """
    folder, rig = Path(folder), views.rig
    check_llff(rig)
    away, i = _off_centre(rig)
    if away > CENTRED:
        warnings.warn(f"the LLFF layout has the principal point in the middle of the picture: for its readers it is up "
                      f"to {away:.2f} px wrong (view {i})", stacklevel=2)  # fmt: skip
    depths = Depths.of(views, truth)
    (folder / "images").mkdir(parents=True, exist_ok=True)
    rows = []
    for i, c2w in enumerate(opencv_to_opengl(rig.viewmats)):
        right, up, back, centre = c2w[:3].T
        pose = np.stack([-up, right, back, centre, [rig.height, rig.width, rig.Ks[i, 0, 0]]], -1)
        rows.append(np.concatenate([pose.ravel(), depths.bounds(i)]))
        _write_image(views, i, folder / "images")
    with atomic(folder / "poses_bounds.npy") as temporary:
        np.save(temporary, np.array(rows))
    write_cameras(folder, views.names, rig, points=views.points(), held_out=views.test_indices, scene=views.scene)
    return folder


def _write_image(views: MultiviewSet, i: int, folder: Path) -> None:
    """The image of view `i` under its name: a copy, or the part of a photograph that the cameras describe."""
    source, target = views.files[i], folder / file_of(views.names[i])
    if source.suffix == target.suffix and views.lenses is None:
        with atomic(target) as temporary:
            shutil.copyfile(admitted(source), temporary)
    else:
        write_png(target, views.image(i))


BLENDER = Layout(export_blender, check_blender)
LLFF = Layout(export_llff, check_llff, needs_depth=True)
