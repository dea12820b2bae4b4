"""Poses: photographs or a video with unknown cameras in, a multiview set of undistorted pictures out."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from novags.cameras.doubts import LARGE_ERROR, camera_doubts, few_views, lens_doubts, same_photographs
from novags.cameras.motion.registration import PLACED, Observed, Registered, Shot, register
from novags.testbed.console.terminal import Console
from novags.testbed.folders.photographs.raw_files import SUFFIXES as RAW
from novags.testbed.folders.photographs.video import is_video, write_frames
from novags.testbed.folders.set import left_out, say_stated
from novags.testbed.importing.exposures import are_dark, exposure_doubts
from novags.testbed.ledger.contents import folder_digest
from novags.testbed.ledger.stage import run_stage
from novags.testbed.stages.configs.posing import PosesConfig
from novags.testbed.stages.layouts import RECORD, SET_FILES
from novags.testbed.stages.paths import keep_apart
from novags.testbed.stages.seen import SEEN
from sensor_model.files.reading import some
from sensor_model.files.scratch import scratch
from simscenes.rigs import Rig
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.names import file_of, view_names
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.bare import SUFFIXES, Bare, picture_files, survey, without_masks
from simscenes.sets.writers.camera_files import write_cameras

BETTER = "take them with more overlap, from places that differ, sharp, with texture and little noise"


def poses(
    out: Path, config: PosesConfig, console: Console, *, stale: Sequence[Path] = (), overwrite: bool = False
) -> dict[str, Any]:
    """Find the cameras of photographs and write the set folder `out`; returns set.json.

    Raises:
        ValueError: If there are no photographs, a file cannot be read, too few find a place, or `out` holds other
            things or, unless `overwrite`, a finished result of another request.
        BlockingIOError: If another process is writing to `out`.
    """
    files = photographs_of(config.photographs)
    if masks := masks_among(config.photographs):
        console.warn(f"{len(masks)} masks among the photographs of {config.photographs} are left out: "
                     f"{some(masks)}; all pixels of a photograph count")  # fmt: skip
    if config.photographs.is_dir():
        keep_apart(out, config.photographs)
        for file in files.values():
            say_stated(file, config.photographs, console)
    record = run_stage(
        "poses",
        out,
        RECORD,
        code=config.code,
        inputs=lambda: {"photographs": folder_digest(config.photographs.parent, (), beside=files)},
        config=config.resolved(),
        owns=SET_FILES,
        prepare=lambda: files,
        work=lambda found: place(found, out, config, console),
        console=console,
        stale=stale,
        overwrite=overwrite,
    )
    console.note(f"poses: {record['registered']} of {record['photographs']} photographs have a place")
    if missing := left_out(record["unregistered"], record["photographs"]):
        console.warn(missing)
    if record.get("dark") and config.pictures == "auto":
        console.note(f"poses: the photographs are dark: cameras are from {record['pictures']} pictures; "
                     "--pictures raw looks at the photographs as they are")  # fmt: skip
    for doubt in record.get("doubts", ()):
        console.warn(doubt)
    return record


def photographs_of(source: Path) -> dict[str, Path]:
    """The photographs of a folder by their names relative to it, or a video by its name; without masks.

    Raises:
        ValueError: If it is neither, or holds fewer than make a set.
    """
    if is_video(source):
        return {source.name: source}
    if not source.is_dir():
        raise ValueError(f"{source} is neither a folder of photographs nor a video file")
    files, _ = without_masks(picture_files(source))
    if len(files) < PLACED:
        raise ValueError(
            f"{source} holds {len(files)} photographs ({', '.join(SUFFIXES)}), at least {PLACED} are needed"
            f"{_others(source)}"
        )
    return {file.relative_to(source).as_posix(): file for file in files}


def masks_among(source: Path) -> list[str]:
    """Masks that lie among the photographs of a folder, by their names relative to it."""
    masks = [] if is_video(source) else without_masks(picture_files(source))[1]
    return [file.relative_to(source).as_posix() for file in masks]


def _others(folder: Path) -> str:
    """Which other files a folder holds, by their suffixes, and programs that make photographs of them."""
    others = (path for path in folder.rglob("*") if path.is_file() and path.suffix.lower() not in SUFFIXES)
    shown = (path for path in others if not any(part.startswith(".") for part in path.relative_to(folder).parts))
    counts = Counter(path.suffix.lower() for path in shown if path.suffix)
    if not counts:
        return ""
    named = some([f"{count} {suffix}" for suffix, count in counts.most_common()], 8)
    raw = "develop camera raw files, " if counts.keys() & set(RAW) else ""
    return f"; it also holds {named}: {raw}convert pictures to PNG or JPEG"


def place(files: dict[str, Path], out: Path, config: PosesConfig, console: Console) -> dict[str, Any]:
    """Find the cameras and write everything but the record.

    Returns:
        The body of set.json.

    Raises:
        ValueError: If a file cannot be read, or too few find a place.
    """
    with scratch("poses") as folder:
        if video := is_video(config.photographs):
            (folder / "frames").mkdir()
            with console.progress("poses: frames") as update:
                frames = write_frames(config.photographs, config.frames_a_second, folder / "frames", update)
            files = {label: file for file, label in frames.items()}
        bare, size = survey(list(files.values()), config.max_size)
        shots = [Shot(f"{k:06d}.png", one.camera, one.focal) for k, one in enumerate(bare)]
        pictures, mapper = config.search(dark := are_dark(lambda k: bare[k].pixels(), len(bare)))
        looked_at = SEEN[pictures](Encoded(bare), config.seed)
        with console.progress(f"poses: {pictures} pictures") as update:
            for k, (shot, picture) in enumerate(zip(shots, looked_at, strict=True)):
                write_png(folder / shot.name, picture)
                update(k + 1, len(shots), "")
        with console.progress("poses") as update:
            found = register(
                folder, shots, max_features=config.max_features, peak_threshold=config.peak_threshold, mapper=mapper,
                in_order=video, seed=config.seed, progress=update,
            )  # fmt: skip
        if found is None:
            hidden = dark and pictures == "raw"
            remedy = "they are dark: look at denoised ones (--pictures denoised), or " if hidden else ""
            raise ValueError(f"fewer than {PLACED} of the {len(bare)} photographs of {config.photographs} fit "
                             f"together: {remedy}{BETTER}")  # fmt: skip
        if not len(found.points):  # a camera that only turned: all of it fits, and nothing has a depth
            raise ValueError(
                f"{len(found.indices)} photographs of {config.photographs} fit together without a single point in "
                "common that has a depth, as if the camera only turned: take them from places that differ"
            )
        names = write_set(out, list(files.values()), bare, levelled(found), size, config.name)
    searched = {"dark": dark, "pictures": pictures, "mapper": mapper}
    return _facts(config.name, list(files), bare, found, size, names) | searched


@dataclass(frozen=True)
class Encoded(Sequence[torch.Tensor]):
    """Photographs, sRGB-encoded, 0..1 [h, w, 3], each read when it is asked for."""

    bare: Sequence[Bare]

    def __len__(self) -> int:
        return len(self.bare)

    def __getitem__(self, k: Any) -> Any:
        return torch.from_numpy(self.bare[k].pixels()).float() / 255


def levelled(found: Registered) -> Registered:
    """The same turned so that z is up, as in all sets: up is the upward direction of the mean photograph.

    COLMAP's world is turned like its first pair of pictures. Cameras that agree on no up keep theirs.
    """
    up = -found.viewmats[:, 1, :3].mean(0)
    if np.linalg.norm(up) < 1e-3:  # its direction would be rounding
        return found
    turn, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])
    world = np.eye(4)
    world[:3, :3] = turn.as_matrix()
    return replace(found, viewmats=found.viewmats @ world.T, points=found.points @ world[:3, :3].T)


def write_set(
    out: Path, files: Sequence[Path], bare: Sequence[Bare], found: Registered, size: tuple[int, int], scene: str
) -> list[str]:
    """Write undistorted pictures, cameras and points; returns the name of each view, in the order of `found`."""
    width, height = size
    names = view_names([files[i] for i in found.indices])
    Ks = np.empty((len(names), 3, 3))
    colors, count = np.zeros((len(found.points), 3)), np.zeros(len(found.points))
    for k, i in enumerate(found.indices):
        pixels = bare[i].pixels()
        h, w = pixels.shape[:2]
        seen = found.seen[k]
        x, y = np.clip(seen.pixels.astype(int), 0, (w - 1, h - 1)).T
        np.add.at(colors, seen.points, pixels[y, x])
        np.add.at(count, seen.points, 1)
        lens = found.lenses[k]
        try:
            pinhole = lens.pinhole(w, h)
        except ValueError as error:
            raise ValueError(f"the {len(names)} photographs of {scene} that fit together do so only through a lens "
                             f"whose distortion cannot be undone: {BETTER} ({error})") from error  # fmt: skip
        left, top = (w - width) // 2, (h - height) // 2
        picture = lens.undistort(pixels, pinhole)[top : top + height, left : left + width]
        write_png(out / "images" / file_of(names[k]), np.ascontiguousarray(picture))
        Ks[k] = pinhole - [[0, 0, left], [0, 0, top], [0, 0, 0]]
    if not (Ks[:, (0, 1), (0, 1)] > 0).all():  # a model that fits a few chance matches need not be a lens
        raise ValueError(f"the {len(names)} photographs of {scene} that fit together do so only through a lens whose "
                         f"distortion cannot be undone: {BETTER}")  # fmt: skip
    order = sorted(range(len(names)), key=lambda k: file_of(names[k]))
    rig = Rig(viewmats=found.viewmats[order], Ks=Ks[order], width=width, height=height)
    shown = np.round(colors / np.maximum(count, 1)[:, None])
    points = replace(SparsePoints.untracked(found.points, shown), error=np.zeros(len(shown)))
    tracked = _tracked(points, [found.seen[k] for k in order], rig)
    write_cameras(out, [names[k] for k in order], rig, points=tracked, scene=scene)
    return names


def _tracked(points: SparsePoints, seen: Sequence[Observed], rig: Rig) -> SparsePoints:
    """The points with the observations of each view, at the pixels that the pinholes of `rig` have there."""
    view = np.concatenate([np.full(len(one.points), i) for i, one in enumerate(seen)])
    pixels = [one.rays * np.diag(K)[:2] + K[:2, 2] for one, K in zip(seen, rig.Ks, strict=True)]
    return points.observed(rig, view, np.concatenate([one.points for one in seen]), np.concatenate(pixels))


def _facts(
    scene: str, labels: list[str], bare: Sequence[Bare], found: Registered, size: tuple[int, int], names: list[str]
) -> dict[str, Any]:
    """The body of set.json."""
    placed = set(found.indices)
    return {
        "kind": "photographs",
        "scene": scene,
        "photographs": len(labels),
        "registered": len(placed),
        "unregistered": [label for i, label in enumerate(labels) if i not in placed],
        "doubts": _doubts(labels, bare, found, size),
        "turned": [label for label, one in zip(labels, bare, strict=True) if one.turned],
        "files_of_views": {name: labels[i] for name, i in sorted(zip(names, found.indices, strict=True))},
        "width": size[0],
        "height": size[1],
        "points": len(found.points),
        "reprojection_error_px": found.error,
        "lenses": [
            {"K": lens.K, "distortion": lens.distortion}
            for lens in {bare[i].camera: lens for i, lens in zip(found.indices, found.lenses, strict=True)}.values()
        ],
    }


def _doubts(labels: list[str], bare: Sequence[Bare], found: Registered, size: tuple[int, int]) -> list[str]:
    """Doubts about the cameras, and changes of pictures, in words for the user."""
    own = [labels[i] for i in found.indices]
    focals = np.array([lens.K[0, 0] / max(bare[i].size) for i, lens in zip(found.indices, found.lenses, strict=True)])
    seen = [len(one.points) for one in found.seen]
    doubts = [*few_views(len(own)), *lens_doubts(np.stack([lens.K for lens in found.lenses]), bare[0].size)]
    doubts += camera_doubts(own, found.viewmats, focals, points=found.points, seen=seen)
    if found.error > LARGE_ERROR:
        doubts.append(f"points are {found.error:.2g} px from where the cameras see them, of at most {LARGE_ERROR:g}: "
                      "cameras are wrong, or something moved between the photographs")  # fmt: skip
    doubts += [*same_photographs([one.file for one in bare]), *exposure_doubts([one.file for one in bare])]
    turned = [label for label, one in zip(labels, bare, strict=True) if one.turned]
    cropped = [label for label, one in zip(labels, bare, strict=True) if one.size != size]
    if turned:
        doubts.append(f"{len(turned)} of {len(labels)} photographs are turned by 90 degrees to lie like the others: "
                      f"{some(turned)}")  # fmt: skip
    if cropped:
        doubts.append(f"{len(cropped)} of {len(labels)} photographs are of another shape and are cropped to "
                      f"{size[0]} x {size[1]} px: {some(cropped)}")  # fmt: skip
    return doubts
