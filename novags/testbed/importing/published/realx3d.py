"""RealX3D: dark pictures in train/, lit twins in val/, lit views from elsewhere in test/; a laser scan beside.

Layouts, as the release and the pages of the NTIRE 2026 challenge have them:

    data_4/CONDITION/SCENE/   train/, val/, test/, sparse/0, transforms_train.json, _val, _test; data/: the same larger
    pointclouds/SCENE/        depth/NNNN.png (16 bits, mm, z-depth, 0: nothing), colmap2world.npy, cull_pointcloud.ply
    SCENE/ of the challenge   train/, transforms_train.json, transforms_test.json; test/ of one scene

The two kinds of camera file have frames of their own: the transforms are centred and scaled again, and `colmap2world`
leads from the frame of sparse/0 to the scanner's, in metres. Where the model and the matrix are there, cameras are in
metres.
"""

import io
import json
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from novags.testbed.importing.split import Split
from sensor_model.files.door import read_bytes, resolved
from sensor_model.files.reading import brief, some
from simscenes.rigs import Rig, opengl_to_opencv, rotation_error
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.pictures.image_file import STORED, read_image
from simscenes.sets.readers.colmap import colmap_lens, colmap_views, is_model, read_points
from simscenes.sets.readers.finding import find_files
from simscenes.sets.readers.photographs import FrameEntry, Photographs, collect, transforms_frames, transforms_lens
from simscenes.sets.readers.resized import sorted_pictures

TRAIN, VAL, TEST = (f"transforms_{part}.json" for part in ("train", "val", "test"))
DARK, LIT = "train", "val"
TRUTH, CLOUD = "pointclouds", "cull_pointcloud.ply"  # beside data/ and data_4/
ABOVE = 4  # folders above a scene in which the truth is looked for
CONDITION = re.compile(r"(defocus|motion|lowlight|smoke|reflection|dynamic|.*exp)\w*", re.IGNORECASE)
APART = 0.01  # of the extent of the cameras: files that differ by more than one turn and scale are of two scenes
SIMILAR = 1e-3  # in the matrix over its scale, which fits to correspondences leave a rotation
MILLIMETRE = 1e-3  # m, a code of the depth pictures

Float = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RealX3DScene(MultiviewSet):
    """The pictures of a scene.

    Attributes:
        colmap: The model; None: cameras are from the transforms.
        colmap_rig: The cameras in the frame of the model.
        to_metres: From that frame to the frame of `rig`, [4,4]; None: it is that frame.
    """

    colmap: Path | None = None
    colmap_rig: Rig | None = None
    to_metres: Float | None = None

    def model(self) -> tuple[Path, Path] | None:
        """As `MultiviewSet.model`."""
        return None if self.colmap is None else (self.path / DARK, self.colmap)

    def points(self) -> SparsePoints | None:
        """As `MultiviewSet.points`: with their tracks through the dark pictures."""
        if self.colmap is None or self.colmap_rig is None:
            return None
        name = colmap_views(self.colmap)[0][0]  # like all others: relative to the scene or to its dark pictures
        pictures = self.path if "/" in name else self.path / DARK
        found = read_points(pictures, self.colmap, self.files, self.colmap_rig)
        if found is not None and self.to_metres is not None:
            found = replace(found, xyz=found.xyz @ self.to_metres[:3, :3].T + self.to_metres[:3, 3])
        return None if found is None else found.about(self.origin)


def is_scene(folder: Path) -> bool:
    """Whether a folder has the files of a scene, of the release or of the challenge."""
    return (folder / TRAIN).is_file() and (folder / DARK).is_dir()


def is_proved(folder: Path) -> bool:
    """Whether its camera files are from the tool that all scenes were made with, and its lit pictures are twins of the
    dark ones by name, or go on with their numbers: no other layout has both.
    """
    try:
        found = [json.loads(read_bytes(folder / name))["frames"] for name in (TRAIN, TEST) if (folder / name).is_file()]
        frames = [frame for part in found for frame in part]
        if not all("sharpness" in frame for frame in frames):
            return False
        named = {frame["file_path"] for frame in frames}
    except (ValueError, TypeError, KeyError):  # damaged, or something else: told when it is opened
        return False
    parts = [DARK] * len(found[0]) + ["test"] * (len(frames) - len(found[0]))
    if len(found) == 2 and named == {f"{part}/{k:04d}.JPG" for k, part in enumerate(parts, 1)}:
        return True
    dark, lit = ({file.name for file in sorted_pictures(folder / part)} for part in (DARK, LIT))
    return bool(dark) and dark == lit


def scene_name(folder: Path) -> str:
    """SCENE, or CONDITION/SCENE where the folder above is of a condition: scenes have one name in all of them."""
    above = folder.parent.name
    return f"{above}/{folder.name}" if CONDITION.fullmatch(above) else folder.name


def lit(folder: Path) -> Path | None:
    """The folder of the lit twins; None: of the challenge, which gives none."""
    return folder / LIT if (folder / LIT).is_dir() else None


def open_scene(folder: Path, split: Split) -> MultiviewSet:
    """The dark pictures of a scene and, of the published split, the lit held-out views, with their cameras.

    With a split of the dark views alone, views that have no dark picture stay out.

    Raises:
        ValueError: If a file is damaged, no listed picture exists, the camera files are of different scenes, or the
            matrix to the scanner's frame is no similarity.
    """
    frames, poses = transforms_frames(folder / TRAIN)
    dark, tested = len(frames), folder / TEST
    if split == "own" and tested.is_file():
        more, their = transforms_frames(tested)
        frames, poses = frames + more, poses + their
    files = find_files(folder, [frame.file_path for frame in frames])
    held = {file for file in files[dark:] if file is not None}
    if split == "own" and not held:
        warnings.warn(f"{folder} has no picture of a held-out view (the challenge kept them): every 8th dark picture "
                      "is held out", stacklevel=2)  # fmt: skip
        frames, poses, files = frames[:dark], poses[:dark], files[:dark]
    stems = {file.stem for file in files[:dark] if file is not None}
    if twice := sorted(file.name for file in held if file.stem in stems):  # cameras and depths go by these names
        raise ValueError(f"{tested} lists pictures that have names of pictures in {TRAIN} ({some(twice, 4)}), and each "
                         "view must have its own: download the scene again")  # fmt: skip
    source = folder / TRAIN
    from_transforms = [opengl_to_opencv(pose) for pose in poses]
    if (model := _model(folder)) is None:
        lens_of = partial(transforms_lens, source=source)
        found = collect(files, from_transforms, [frame.camera for frame in frames], source, lens_of)
        colmap_rig = to_metres = None
    else:
        found = _from_model(files, frames, model)
        _check_alike(found, files, from_transforms, model, source)
        colmap_rig, to_metres = found.rig, colmap_to_world(folder)
    if to_metres is not None:
        found = replace(found, rig=in_metres(found.rig, to_metres))
    found = found.holding_out(held, folder)
    lenses = found.lenses if any(any(lens.distortion) for lens in found.lenses) else None
    return RealX3DScene(
        path=folder, names=found.names, rig=found.rig, kind="photographs", meta={}, files=found.files, lenses=lenses,
        held_out=found.held_out, lit_alone=found.held_out if held and found.held_out else (), colmap=model,
        colmap_rig=colmap_rig, to_metres=to_metres,
    )  # fmt: skip


def _model(folder: Path) -> Path | None:
    return next((path for path in (folder / "sparse" / "0", folder / "sparse") if is_model(path)), None)


def _from_model(files: list[Path | None], frames: list[FrameEntry], model: Path) -> Photographs:
    names, viewmats, cameras = colmap_views(model)
    posed = {Path(name).stem: i for i, name in enumerate(names)}
    stems = [Path(frame.file_path).stem for frame in frames]
    if lacking := sorted(stem for stem in stems if stem not in posed):
        raise ValueError(
            f"{model} lacks {len(lacking)} of the {len(stems)} listed views ({some(lacking, 4)}): download the scene "
            "again, or move sparse/ away to take the cameras from the transforms"
        )
    own = [posed[stem] for stem in stems]
    lens_of = partial(colmap_lens, source=model)
    return collect(files, [viewmats[i] for i in own], [cameras[i] for i in own], model, lens_of)


def _check_alike(
    found: Photographs, files: list[Path | None], from_transforms: list[Float], model: Path, source: Path
) -> None:
    """Refuse a model and transforms that no similarity brings together."""
    from novags.cameras.align import left_apart  # torch comes with it: lists of data sets must not wait for that
    from novags.cameras.estimate import centers_of

    place = {file: i for i, file in enumerate(files)}
    theirs = np.stack([from_transforms[place[file]] for file in found.files])
    here = found.rig.positions
    away = left_apart(centers_of(theirs), here) / max(float(np.linalg.norm(np.ptp(here, axis=0))), 1e-12)
    if len(here) > 2 and away > APART:  # two cameras agree with any two
        raise ValueError(
            f"{model} and {source} are of different scenes: the camera positions differ by {away:.1%} of their extent "
            "after the best turn, scale and shift: download the scene again"
        )


def _above(folder: Path) -> Iterator[Path]:
    """Where the truth of a scene may lie."""
    real = resolved(folder)
    yield real
    for above in list(real.parents)[:ABOVE]:
        yield above / TRUTH / real.name


def _matrix_file(folder: Path) -> Path | None:
    names = ("colmap2world.npy", "colmap2world.txt", "sparse/0/colmap2world.npy")
    return next((place / name for place in _above(folder) for name in names if (place / name).is_file()), None)


def colmap_to_world(folder: Path) -> Float | None:
    """From the frame of a scene's model to the scanner's, in metres: a similarity [4,4]; None where it is not there.

    Raises:
        ValueError: If the file is damaged or holds no similarity.
    """
    if (file := _matrix_file(folder)) is None:
        return None
    try:
        content = io.BytesIO(read_bytes(file))
        found = np.load(content, allow_pickle=False) if file.suffix == ".npy" else np.loadtxt(content)
        matrix = np.asarray(found, np.float64)
    except (ValueError, EOFError, TypeError) as error:
        raise ValueError(f"{file} holds no matrix of numbers ({brief(error)}): download it again") from error
    whole = matrix.shape == (4, 4) and bool(np.isfinite(matrix).all())
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3]))) if whole else 0.0
    turned = scale > 0 and rotation_error(matrix[:3, :3] / scale) <= SIMILAR
    if not (turned and np.array_equal(matrix[3], (0, 0, 0, 1))):
        raise ValueError(f"{file} must hold a turn, a positive scale and a shift in a 4 x 4 matrix, got "
                         f"{brief(matrix.tolist())}: download it again")  # fmt: skip
    return matrix


def in_metres(rig: Rig, to_metres: Float) -> Rig:
    """Cameras of a model's frame in the frame that a similarity [4,4] leads to.

    x' = s Q x + b, so that s (R x + t) = R Q' (x' - b) + s t: depths in a picture become s times as large.
    """
    scale = np.cbrt(np.linalg.det(to_metres[:3, :3]))
    u, _, vt = np.linalg.svd(to_metres[:3, :3])  # the nearest rotation: the file has rounded numbers
    viewmats = rig.viewmats.copy()
    viewmats[:, :3, :3] = rig.viewmats[:, :3, :3] @ (u @ vt).T
    viewmats[:, :3, 3] = scale * rig.viewmats[:, :3, 3] - viewmats[:, :3, :3] @ to_metres[:3, 3]
    return replace(rig, viewmats=viewmats)


def beside(folder: Path, views: MultiviewSet) -> dict[str, Path]:
    """The files of the truth that are read: the matrix, "scan" and "depth/NAME" of views; {} where cameras are not in
    metres.
    """
    if not isinstance(views, RealX3DScene) or views.to_metres is None or (matrix := _matrix_file(folder)) is None:
        return {}
    place = next((place / "depth" for place in _above(folder) if (place / "depth").is_dir()), None)
    files = zip(views.names, views.files, strict=True)
    found = {} if place is None else {f"depth/{name}": place / f"{file.stem}.png" for name, file in files}
    cloud = next((place / CLOUD for place in _above(folder) if (place / CLOUD).is_file()), None)
    scan = {} if cloud is None else {"scan": cloud}
    return {"colmap2world": matrix, **scan, **{name: path for name, path in found.items() if path.is_file()}}


def read_depth(file: Path, width: int, height: int) -> NDArray[np.float32]:
    """Depth of a view at the centre of each of its pixels, m, float32 [h,w], 0: not known.

    The pictures are four times as large as those of data_4: the value in which the centre of a pixel lies is taken,
    since means across an edge are depths of nothing.

    Raises:
        ValueError: If the file is not a grey picture of 16 bits, or of another shape than the view.
    """
    codes = read_image(file, STORED)
    if codes.dtype != np.uint16 or codes.ndim != 2:
        raise ValueError(f"{file} must be a grey picture of 16 bits (millimetres), got {codes.dtype} {codes.shape}: "
                         "download it again")  # fmt: skip
    tall, wide = codes.shape
    if abs(wide / width - tall / height) > 0.01 * wide / width:
        raise ValueError(f"{file} is {wide} x {tall} px, another shape than its view of {width} x {height} px: they do "
                         "not belong together")  # fmt: skip
    rows = ((np.arange(height) + 0.5) * tall / height).astype(int)
    columns = ((np.arange(width) + 0.5) * wide / width).astype(int)
    return (codes[np.ix_(rows, columns)] * np.float32(MILLIMETRE)).astype(np.float32)
