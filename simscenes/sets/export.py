"""Copies of a set in the two other layouts the field reads: Blender (NeRF synthetic) and LLFF."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from simscenes.rigs import opencv_to_opengl
from simscenes.sets.camera_files import write_json
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.names import file_of
from simscenes.sets.png import write_png


def export_blender(views: MultiviewSet, folder: str | Path) -> Path:
    """Write transforms_train.json, transforms_val.json and transforms_test.json, with the images beside them.

    Args:
        views: The set.
        folder: Created if missing. The held-out views serve as both val and test.

    Raises:
        ValueError: If the cameras are not all one centred pinhole, which is all this layout can describe.
    """
    folder, rig = Path(folder), views.rig
    K = rig.Ks[0]
    centred = np.allclose(K[:2, 2], (rig.width / 2, rig.height / 2), atol=1e-6) and np.isclose(K[0, 0], K[1, 1])
    if not centred or not np.allclose(rig.Ks, K):
        raise ValueError("the Blender layout holds one field of view for all: cameras must share intrinsics with "
                         "square pixels and a centred principal point; use the set's own transforms.json")  # fmt: skip
    poses = opencv_to_opengl(rig.viewmats)
    for split, indices in (("train", views.train_indices), ("val", views.test_indices), ("test", views.test_indices)):
        (folder / split).mkdir(parents=True, exist_ok=True)
        frames: list[dict[str, Any]] = []
        for i in indices:
            _write_image(views, i, folder / split)
            frames.append({"file_path": f"./{split}/{views.names[i]}", "transform_matrix": poses[i].tolist()})
        angle = float(2 * np.arctan(rig.width / 2 / K[0, 0]))
        size = {"w": rig.width, "h": rig.height}  # without them nerfbaselines takes 800
        write_json(folder / f"transforms_{split}.json", {"camera_angle_x": angle, **size, "frames": frames})
    return folder


def export_llff(views: MultiviewSet, folder: str | Path) -> Path:
    """Write images/ and poses_bounds.npy [n,17]: pose columns (down, right, back, centre, [h, w, f]), near and far.

    Raises:
        ValueError: If the set has no depth to take near and far from, or the focal lengths of a camera differ.
    """
    folder, rig = Path(folder), views.rig
    if not np.allclose(rig.Ks[:, 0, 0], rig.Ks[:, 1, 1]):
        raise ValueError("the LLFF layout holds one focal length per view: pixels must be square")
    (folder / "images").mkdir(parents=True, exist_ok=True)
    rows = []
    for i, c2w in enumerate(opencv_to_opengl(rig.viewmats)):
        geometry = views.geometry(i)
        if geometry is None:
            raise ValueError(f"the LLFF layout needs near and far of every view, and {views.path} has no depth")
        z = geometry["z"][np.isfinite(geometry["z"])]
        near, far = np.quantile(z, [0.001, 0.999]) if z.size else (1.0, 10.0)
        right, up, back, centre = c2w[:3].T
        pose = np.stack([-up, right, back, centre, [rig.height, rig.width, rig.Ks[i, 0, 0]]], -1)
        rows.append(np.concatenate([pose.ravel(), [near, far]]))
        _write_image(views, i, folder / "images")
    np.save(folder / "poses_bounds.npy", np.array(rows))
    return folder


def _write_image(views: MultiviewSet, i: int, folder: Path) -> None:
    """The image of view `i` under its name: a copy, or what the cameras describe of a photograph."""
    source, target = views.files[i], folder / file_of(views.names[i])
    if source.suffix == target.suffix and views.lenses is None:
        shutil.copyfile(source, target)
    else:
        write_png(target, views.image(i))


EXPORTS: dict[str, Callable[[MultiviewSet, str | Path], Path]] = {"blender": export_blender, "llff": export_llff}
