"""Scenes of a few tiny pictures in the layouts of published data sets, of cameras and pictures that are known."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from simscenes import orbit_rig
from simscenes.rigs import Rig, invert_rigid, opencv_to_opengl
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.pictures.png import write_png
from simscenes.sets.writers.camera_files import write_cameras
from simscenes.sets.writers.neighbours import write_points

VIEWS, WIDTH, HEIGHT, FOV = 9, 32, 24, 50.0
RIG = orbit_rig(VIEWS, WIDTH, HEIGHT, FOV, radius=3.0)
TRAIN, VAL, TEST = (0, 1, 3, 4, 6, 8), (7,), (2, 5)  # of LOM


def lit_picture(i: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """A smooth pattern of view `i`, uint8 [h,w,3], unlike that of every other."""
    x, y = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
    waves = [np.sin((3 + i) * x + 2 * y + c) + np.cos((2 + c) * y - i) for c in range(3)]
    return (120 + 50 * np.stack(waves, -1)).clip(0, 255).astype(np.uint8)


def dark_picture(i: int) -> np.ndarray:
    """Its dark twin, uint8 [h,w,3]."""
    return lit_picture(i) // 8


def codes16(i: int) -> np.ndarray:
    """Codes of a dark picture that need all 16 bits, uint16 [h,w,3]."""
    return (dark_picture(i).astype(np.uint16) << 6) + np.uint16(i) + 1


def write16(path: Path, codes: np.ndarray) -> None:
    """A 16-bit PNG or TIFF."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), codes[..., ::-1])


def colmap(folder: Path, names: Sequence[str], rig: Rig) -> Path:
    """A COLMAP model of these pictures with three points, in `folder`."""
    points = SparsePoints.untracked(np.eye(3) / 10, np.full((3, 3), 0.5))
    scratch = folder.with_name(f"{folder.name}-scratch")
    write_cameras(scratch, [Path(name).stem for name in names], rig, points=points)
    folder.parent.mkdir(parents=True, exist_ok=True)
    shutil.move(scratch / "sparse" / "0", folder)
    shutil.rmtree(scratch)
    return folder


def moved(rig: Rig) -> Rig:
    """The same cameras in another world: turned, shifted and twice as large."""
    turn = cv2.Rodrigues(np.array([0.3, -0.2, 0.5]))[0]
    poses = invert_rigid(rig.viewmats)
    poses[:, :3, :3] = turn @ poses[:, :3, :3]
    poses[:, :3, 3] = 2 * poses[:, :3, 3] @ turn.T + [1.0, 2.0, 3.0]
    return replace(rig, viewmats=invert_rigid(poses))


def lom(folder: Path, *, model: Rig | None = None) -> Path:
    """A scene of LOM; `model`: with colmap_sparse/0 of these cameras."""
    names = [f"IMG_{20 + i}.png" for i in range(VIEWS)]
    for i, name in enumerate(names):
        write_png(folder / "low" / name, dark_picture(i))
        write_png(folder / "high" / name, lit_picture(i))
        write_png(folder / "over_exp" / name, np.full((HEIGHT, WIDTH, 3), 255, np.uint8))
    poses = opencv_to_opengl(RIG.viewmats)
    for part, views, place in (("train", TRAIN, "low"), ("val", VAL, "high"), ("test", TEST, "high")):
        frames = [{"file_path": f"{place}/{names[i]}", "transform_matrix": poses[i].tolist()} for i in views]
        content: dict[str, Any] = {"camera_angle_x": np.radians(FOV), "w": WIDTH, "h": HEIGHT, "frames": frames}
        (folder / f"transforms_{part}.json").write_text(json.dumps(content))
    if model is not None:
        colmap(folder / "colmap_sparse" / "0", names, model)
    return folder


def poses_bounds(path: Path, rig: Rig, scale: float = 1.0) -> None:
    """The cameras of an LLFF scene, for pictures `scale` times as large as those of `rig`."""
    rows = []
    for viewmat, K in zip(rig.viewmats, rig.Ks, strict=True):
        (right, down, forward), centre = viewmat[:3, :3], -viewmat[:3, :3].T @ viewmat[:3, 3]
        size = scale * np.array([rig.height, rig.width, K[0, 0]])
        rows.append([*np.stack([down, right, -forward, centre, size], 1).ravel(), 1.0, 5.0])
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, np.array(rows))


def llnerf(root: Path, *, scene: str = "still2", lit_width: int = WIDTH, pictures: str = "images") -> Path:
    """A scene of LLNeRF below `root`, with its lit pictures, whose names say nothing; an LLFF scene."""
    folder = root / "llnerf-dataset" / scene
    for i in range(VIEWS):
        write_png(folder / pictures / f"DSC{1650 + 2 * i:05d}.png", dark_picture(i))
        write_png(root / "normal-light-scenes" / scene / f"DSC{1701 + 2 * i:05d}.png", lit_picture(i, lit_width))
    poses_bounds(folder / "poses_bounds.npy", RIG)
    return folder


def llrs(root: Path, scene: str = "chair") -> Path:
    """A scene of LLRS below `root`."""
    folder, names = root / "LLRS-sRGB" / scene, [f"{i:03d}.png" for i in range(VIEWS)]
    for i, name in enumerate(names):
        write_png(folder / "images" / name, dark_picture(i))
        write_png(folder / "gt" / "images" / name, lit_picture(i))
    colmap(folder / "sparse" / "0", names, RIG)
    return folder


def mvtv(root: Path, scene: str = "hall") -> Path:
    """A scene of MVTV below `root`: 16-bit pictures and no lit ones."""
    folder, names = root / "mvtv" / scene, [f"{i:03d}.png" for i in range(VIEWS)]
    for i, name in enumerate(names):
        write16(folder / "images" / name, codes16(i))
    colmap(folder / "sparse" / "0", names, RIG)
    return folder


METRES = np.eye(4)  # from the model's frame to the scanner's of RealX3D: a turn, .532 times the size, a shift
METRES[:3, :3] = 0.532 * cv2.Rodrigues(np.array([0.4, 0.1, -0.7]))[0]
METRES[:3, 3] = (0.3, -1.2, 2.5)


def under(rig: Rig, similarity: np.ndarray) -> Rig:
    """Cameras of a world in the world that a similarity [4,4] leads to."""
    scale = np.cbrt(np.linalg.det(similarity[:3, :3]))
    poses = invert_rigid(rig.viewmats)
    poses[:, :3, :3] = similarity[:3, :3] / scale @ poses[:, :3, :3]
    poses[:, :3, 3] = poses[:, :3, 3] @ similarity[:3, :3].T + similarity[:3, 3]
    return replace(rig, viewmats=invert_rigid(poses))


REALX3D_TEST = (7, 8)  # views of RealX3D's test/, whose numbers go on after the others'


def realx3d_rig() -> Rig:
    """The cameras of a scene of RealX3D in metres, their principal point beside the middle."""
    Ks = RIG.Ks.copy()
    Ks[:, 0, 2] += 1.3
    Ks[:, 1, 2] -= 2.1
    return under(replace(RIG, Ks=Ks), METRES)


def realx3d(root: Path, *, rig: Rig | None = None, condition: str = "lowlight", scene: str = "Popcorn") -> Path:
    """A scene of RealX3D below `root`, as released: two frames of cameras, the way to metres, and the scan's depth.

    `rig`: cameras in metres; None: `realx3d_rig`. The depth of view `i`, at four times the size, is 2 + i / 10 m and
    half a metre less in its left half; its first row is not known.
    """
    rig = realx3d_rig() if rig is None else rig
    folder, truth = root / "data_4" / condition / scene, root / "pointclouds" / scene
    names = [f"{i + 1:04d}.png" for i in range(VIEWS)]
    for i, name in enumerate(names):
        if i in REALX3D_TEST:
            write_png(folder / "test" / name, lit_picture(i))
            continue
        write_png(folder / "train" / name, dark_picture(i))
        write_png(folder / "val" / name, lit_picture(i))
    of_model = under(rig, np.linalg.inv(METRES))
    colmap(folder / "sparse" / "0", names, of_model)
    centred = np.diag([2.5, 2.5, 2.5, 1.0])
    centred[:3, 3] = -2.5 * of_model.positions.mean(0)
    poses = opencv_to_opengl(under(of_model, centred).viewmats)
    K = rig.Ks[0]
    for part, place in (("train", "train"), ("val", "val"), ("test", "test")):
        views = [i for i in range(VIEWS) if (i in REALX3D_TEST) == (part == "test")]
        frames = [{"file_path": f"{place}/{names[i]}", "sharpness": 30.0 + i, "transform_matrix": poses[i].tolist()}
                  for i in views]  # fmt: skip
        content = {
            "camera_angle_x": 2 * np.arctan(WIDTH / 2 / K[0, 0]), "camera_angle_y": 2 * np.arctan(HEIGHT / 2 / K[1, 1]),
            "fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "w": WIDTH, "h": HEIGHT, "aabb_scale": 2,
            **dict.fromkeys(("k1", "k2", "k3", "k4", "p1", "p2"), 0), "is_fisheye": False, "frames": frames,
        }  # fmt: skip
        (folder / f"transforms_{part}.json").write_text(json.dumps(content))
    (truth / "depth").mkdir(parents=True)
    np.save(truth / "colmap2world.npy", METRES)
    write_points(truth / "cull_pointcloud.ply", scan_points(rig), np.full((len(scan_points(rig)), 3), 9, np.uint8))
    for i, name in enumerate(names):
        depth = np.full((4 * HEIGHT, 4 * WIDTH), 2000 + 100 * i, np.uint16)
        depth[:, : 2 * WIDTH] -= 500
        depth[:4] = 0
        write_png16(truth / "depth" / name, depth)
    return folder


def scan_points(rig: Rig) -> np.ndarray:
    """What the depth of the first view of `realx3d` shows, and a point of each other place twice, [n,3], metres."""
    y, x = np.mgrid[1:HEIGHT, :WIDTH]
    z = np.where(x < WIDTH // 2, 1.5, 2.0)
    local = np.stack([x + 0.5, y + 0.5, np.ones_like(z)], -1) @ np.linalg.inv(rig.Ks[0]).T * z[..., None]
    seen = (local.reshape(-1, 3) - rig.viewmats[0, :3, 3]) @ rig.viewmats[0, :3, :3]
    return np.concatenate([seen, seen[::7]])


def write_png16(path: Path, codes: np.ndarray) -> None:
    """A grey PNG of 16 bits."""
    assert cv2.imwrite(str(path), codes)


def unsealed(record: Path) -> None:
    """Take the checksums out of a record, as in those of earlier versions: then tests may change its files."""
    content = json.loads(record.read_text(encoding="utf-8"))
    del content["stage"]["files"]
    record.write_text(json.dumps(content), encoding="utf-8")
