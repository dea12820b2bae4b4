"""The outer files of a set folder: cameras in the form COLMAP, nerfstudio, gsplat's trainer and nerfbaselines read.

A set and a capture share these files; images are named `images/<name>.png`, or `lit/<name>.png` of a view that no
dark picture shows.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.atomic import atomic, write_text
from simscenes.rigs import TEST_EVERY, Rig, opencv_to_opengl
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.names import check_names, file_of
from simscenes.sets.writers.neighbours import POINTS, instant_ngp_box, write_points

LISTS = ("train_list.txt", "val_list.txt", "test_list.txt")  # nerfstudio reads all three, and asks for "val" by default
CAMERA_FILES = ("transforms.json", "sparse", *LISTS, "nb-info.json", POINTS)


def is_test_view(index: int) -> bool:
    """Whether the view at this place in the order of names is held out for testing."""
    return index % TEST_EVERY == 0


def write_json(path: Path, content: Any) -> None:
    """Write JSON atomically; nan and inf are refused because other readers do not accept them."""
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def write_cameras(
    folder: str | Path,
    names: Sequence[str],
    rig: Rig,
    *,
    points: SparsePoints | None = None,
    held_out: Sequence[int] | None = None,
    depth_dir: str | None = None,
    scene: str | None = None,
    lit_alone: Collection[int] = (),
) -> None:
    """Write transforms.json, sparse/0/*.bin, points3D.ply, a list of files for each split, and nb-info.json.

    The held-out views serve as both val and test.

    Args:
        folder: Created if it is missing.
        names: File stems, one per camera, sorted as files (`names.file_of`).
        rig: The cameras.
        points: Sparse points with their tracks and errors, which are written unchanged.
        held_out: Places of the views for testing; None: every 8th, from 0.
        depth_dir: Folder of the depth images of all views, relative to `folder`; None if the set has no depth.
        scene: The scene's name.
        lit_alone: Places of held-out views without a file in images/: transforms.json names their picture in lit/, and
            sparse/0, whose readers look into images/ alone, leaves them out.

    Raises:
        ValueError: If names are not safe, different and sorted, or do not match the rig.
    """
    folder = Path(folder)
    check_names(names, len(rig))
    folder.mkdir(parents=True, exist_ok=True)
    files = [file_of(name) for name in names]
    tested = {i for i in range(len(files)) if is_test_view(i)} if held_out is None else set(held_out)
    test = [f for i, f in enumerate(files) if i in tested]
    train = [f for i, f in enumerate(files) if i not in tested]
    _write_colmap(folder / "sparse" / "0", files, rig, points, lit_alone)
    pictures = [f"{'lit' if i in lit_alone else 'images'}/{f}" for i, f in enumerate(files)]
    transforms = _transforms(rig, pictures, tested, None if depth_dir is None else [f"{depth_dir}/{f}" for f in files])
    xyz = np.zeros((0, 3)) if points is None else points.xyz
    transforms |= instant_ngp_box(rig.positions, xyz)
    if points is not None and len(points):
        write_points(folder / POINTS, points.xyz, points.rgb)
        transforms["ply_file_path"] = POINTS
    else:
        (folder / POINTS).unlink(missing_ok=True)
    write_json(folder / "transforms.json", transforms)
    for name, split in zip(LISTS, (train, test, test), strict=True):
        write_text(folder / name, "".join(f"{f}\n" for f in split))
    write_json(folder / "nb-info.json", nerfbaselines_info(scene))


def nerfbaselines_info(scene: str | None) -> dict[str, Any]:
    """The facts for nerfbaselines about a folder with a COLMAP model: its loader, and the scene's name."""
    loader = {"loader": "colmap", "loader_kwargs": {"images_path": "images", "colmap_path": "sparse/0"}}
    return {**loader, "id": "novags", **({} if scene is None else {"scene": scene})}


def _transforms(rig: Rig, pictures: list[str], tested: set[int], depths: list[str] | None) -> dict[str, Any]:
    """Camera file of nerfstudio; all distortion keys are there because nerfbaselines fails on a partial set."""
    frames: list[dict[str, Any]] = [
        {"file_path": file, "transform_matrix": pose.tolist()}
        for file, pose in zip(pictures, opencv_to_opengl(rig.viewmats), strict=True)
    ]
    test = [file for i, file in enumerate(pictures) if i in tested]
    one_lens = bool((rig.Ks == rig.Ks[0]).all())
    shared: dict[str, Any] = fields_of_view(rig.Ks[0], rig.width, rig.height) if one_lens else {}
    for i, frame in enumerate(frames):
        if depths is not None:
            frame["depth_file_path"] = depths[i]
        K = rig.Ks[i]
        camera = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
        (shared if one_lens else frame).update({k: float(v) for k, v in camera.items()})
    return {
        "camera_model": "OPENCV",
        "w": rig.width,
        "h": rig.height,
        **shared,
        **dict.fromkeys(("k1", "k2", "k3", "k4", "p1", "p2"), 0.0),
        "orientation_override": "none",
        "train_filenames": [file for i, file in enumerate(pictures) if i not in tested],
        "val_filenames": test,
        "test_filenames": test,
        "frames": frames,
    }


def fields_of_view(K: NDArray[np.float64], width: int, height: int) -> dict[str, float]:
    """The same focal lengths as angles: without them nerfstudio's reader of instant-ngp takes fy for fx."""
    x, y = (float(2 * np.arctan2(size / 2, focal)) for size, focal in ((width, K[0, 0]), (height, K[1, 1])))
    return {"camera_angle_x": x, "camera_angle_y": y, "x_fov": math.degrees(x), "y_fov": math.degrees(y)}


def _write_colmap(
    folder: Path, files: list[str], rig: Rig, points: SparsePoints | None, left_out: Collection[int]
) -> None:  # fmt: skip
    import pycolmap

    points = SparsePoints.untracked(np.zeros((0, 3)), np.zeros((0, 3))) if points is None else points
    reconstruction = pycolmap.Reconstruction()
    cameras = {K.tobytes(): n + 1 for n, K in enumerate(np.unique(rig.Ks, axis=0))}
    for K in np.unique(rig.Ks, axis=0):
        params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        camera = pycolmap.Camera(
            model="PINHOLE", width=rig.width, height=rig.height, params=params, camera_id=cameras[K.tobytes()]
        )
        reconstruction.add_camera_with_trivial_rig(camera)
    tracks = [pycolmap.Track() for _ in range(len(points))]
    for c, file in enumerate(files):
        if c in left_out:
            continue
        pose = pycolmap.Rigid3d(rig.viewmats[c, :3, :4])
        mine = slice(*np.searchsorted(points.view, [c, c + 1]))
        image = pycolmap.Image(
            name=file, keypoints=points.pixel[mine], camera_id=cameras[rig.Ks[c].tobytes()], image_id=c + 1
        )
        reconstruction.add_image_with_trivial_frame(image, pose)
        for k, p in enumerate(points.point[mine]):
            tracks[p].add_element(c + 1, k)
    for position, color, track, error in zip(points.xyz, points.rgb, tracks, points.error, strict=True):
        number = reconstruction.add_point3D(position, track, color)
        reconstruction.points3D[number].error = error
    with atomic(folder) as temporary:
        temporary.mkdir()
        reconstruction.write_binary(str(temporary))
