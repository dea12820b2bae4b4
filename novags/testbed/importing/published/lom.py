"""LOM, the data set of Aleth-NeRF: low/ and high/ of the same names, cameras and split in transforms_*.json.

A scene, as the README of github.com/cuiziteng/Aleth-NeRF lists it: low/ (dark), high/ (lit), over_exp/, colmap_sparse/,
transforms_train.json (frames in low/), transforms_val.json and transforms_test.json (frames in high/). The cameras of
both files were found in the lit pictures. Poses of the JSON files are camera-to-world in OpenGL axes; the model in
colmap_sparse/ has another frame, lenses with distortion and sparse points, and counts where it has every view, as in
the loader of Luminance-GS.
"""

import warnings
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from novags.testbed.importing.split import Split
from sensor_model.files.reading import some
from simscenes.rigs import opengl_to_opencv
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.readers.colmap import colmap_lens, colmap_views, is_model
from simscenes.sets.readers.nerf_synthetic import PARTS
from simscenes.sets.readers.photographs import FrameEntry, Photographs, collect, transforms_frames, transforms_lens
from simscenes.sets.readers.resized import sorted_pictures

DARK, LIT, MODEL = "low", "high", "colmap_sparse"
SAME_POSE = 1e-6  # entries of a pose that two files list; they are copies, in decimal digits


@dataclass(frozen=True, kw_only=True)
class LomScene(MultiviewSet):
    """The dark pictures of a scene; `colmap` is the model that its cameras are from."""

    colmap: Path | None = None

    def model(self) -> tuple[Path, Path] | None:
        """As `MultiviewSet.model`."""
        return None if self.colmap is None else (self.path / DARK, self.colmap)


@dataclass
class _View:
    """The entry of one picture in the JSON files."""

    frame: FrameEntry
    pose: NDArray[np.float64]  # camera-to-world [4,4], OpenGL axes
    source: Path
    parts: set[str] = field(default_factory=set)


def is_scene(folder: Path) -> bool:
    """Whether a folder is a scene of LOM."""
    return (folder / PARTS[0]).is_file() and (folder / DARK).is_dir() and (folder / LIT).is_dir()


def open_scene(folder: Path, split: Split) -> MultiviewSet:
    """The dark pictures of a scene with their cameras.

    Of the published split, views that are for validation alone are left out, as in the loaders of both programs; a
    scene without a test file is tested on them.

    Raises:
        ValueError: If a file is damaged, two files list different poses of a picture, no listed picture exists, or
            nothing is left to train on.
    """
    views, dark = _listed(folder), {file.stem: file for file in sorted_pictures(folder / DARK)}
    tested_part = next((part for part in PARTS[1:] if any(part in view.parts for view in views.values())), "")
    tested = {stem for stem, view in views.items() if tested_part in view.parts}
    if twice := sorted(stem for stem in tested if split == "own" and PARTS[0] in views[stem].parts):
        warnings.warn(f"{folder} lists {len(twice)} pictures for training and for testing ({some(twice, 4)}): they are "
                      "held out", stacklevel=2)  # fmt: skip
    if split == "own":
        views = {stem: view for stem, view in views.items() if stem in tested or PARTS[0] in view.parts}
    found, model = _photographs(folder, views, dark)
    if split == "own":
        found = found.holding_out({dark[stem] for stem in tested if stem in dark}, folder)
    lenses = found.lenses if any(any(lens.distortion) for lens in found.lenses) else None
    return LomScene(
        path=folder, names=found.names, rig=found.rig, kind="photographs", meta={}, files=found.files, lenses=lenses,
        held_out=found.held_out, colmap=model,
    )  # fmt: skip


def _listed(folder: Path) -> dict[str, _View]:
    """Every picture that the JSON files list, by its stem."""
    views: dict[str, _View] = {}
    for part in PARTS:
        if not (source := folder / part).is_file():
            continue
        for frame, pose in zip(*transforms_frames(source), strict=True):
            stem = Path(frame.file_path).stem
            view = views.setdefault(stem, _View(frame, pose, source))
            if np.abs(view.pose - pose).max() > SAME_POSE:
                raise ValueError(f"{view.source} and {source} list different poses of {stem}: download the scene again")
            view.parts.add(part)
    return views


def _photographs(folder: Path, views: dict[str, _View], dark: dict[str, Path]) -> tuple[Photographs, Path | None]:
    """The listed views with the cameras of the model, if it has all of them, else with the cameras of the JSON
    files.
    """
    files = [dark.get(stem) for stem in views]
    model = next((path for path in (folder / MODEL / "0", folder / MODEL) if is_model(path)), None)
    if model is not None:
        names, viewmats, cameras = colmap_views(model)
        posed = {Path(name).stem: i for i, name in enumerate(names)}
        if not (lacking := sorted(views.keys() - posed.keys())):
            own = [posed[stem] for stem in views]
            viewmats, cameras = [viewmats[i] for i in own], [cameras[i] for i in own]
            return collect(files, viewmats, cameras, model, partial(colmap_lens, source=model)), model
        warnings.warn(f"{model} lacks {len(lacking)} of {len(views)} listed views ({some(lacking, 4)}): cameras are "
                      f"taken from {PARTS[0]}, and there are no first points", stacklevel=2)  # fmt: skip
    viewmats = [opengl_to_opencv(view.pose) for view in views.values()]
    cameras, source = [view.frame.camera for view in views.values()], folder / PARTS[0]
    return collect(files, viewmats, cameras, source, partial(transforms_lens, source=source)), None
