"""Scores of pictures from anywhere: held-out views of a set or a capture, against a reference that is chosen."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from novags.methods.problem import encode
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import RECORD, Capture, open_capture
from novags.testbed.folders.exchanged import refuse_exchanged
from novags.testbed.folders.imported import MISSING
from novags.testbed.folders.references import LINEAR, true_depth
from novags.testbed.folders.set import Source, open_source, say_stated
from novags.testbed.importing.pictures import ForeignPicture, find_renders, read_picture
from novags.testbed.ledger.dry import NOT_DONE, planned
from novags.testbed.metrics import missing, networks, protocol_of
from novags.testbed.metrics.geometry import geometry_scores
from novags.testbed.metrics.images import image_scores, mean_scores
from novags.testbed.metrics.linear import exposure_gain, is_black, linear_psnr
from novags.testbed.metrics.picture import Image
from novags.testbed.stages.scores.doubts import Doubts
from sensor_model.files.lock import dry

Reference = Literal["lit", "linear", "clean", "linear_demosaiced", "clean_demosaiced"]
MEANING = {
    "lit": "the views in good light, sRGB",
    "linear": "the light of the scene, linear, after one gain for all views",
    "clean": "the dark exposures without noise, sRGB",
    "linear_demosaiced": "the noise-free mosaics, interpolated, linear, after one gain for all views",
    "clean_demosaiced": "the noise-free mosaics, interpolated, sRGB",
}


@dataclass(frozen=True)
class Truth:
    """The truth about the held-out views of a set or a capture.

    Attributes:
        path: Of the set or the capture.
        lit: The set.
        capture: The capture, if `path` is one.
        indices: Of the held-out views.
        names: Of these.
    """

    path: Path
    lit: Source
    capture: Capture | None
    indices: tuple[int, ...]
    names: tuple[str, ...]

    @staticmethod
    def of(path: Path, console: Console) -> "Truth":
        """Open a set or a capture.

        Raises:
            ValueError: If it is neither, cannot be read, or holds no view out.
        """
        if not path.is_dir():
            raise ValueError(f"the set {path} does not exist")
        capture = open_capture(path) if (path / RECORD).is_file() else None
        lit = open_source(path, console) if capture is None else capture.source(console)
        views = lit.views if capture is None else capture.cameras
        indices = tuple(views.test_indices)
        if not indices:
            raise ValueError(f"{path} holds no view out: nothing can be scored")
        return Truth(path, lit, capture, indices, tuple(views.names[i] for i in indices))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the views, px."""
        rig = self.lit.rig if self.capture is None else self.capture.cameras.rig
        return rig.width, rig.height

    def reader(self, reference: Reference) -> Callable[[int], Image]:
        """A reader of the reference of a view, float32 [h,w,3].

        Raises:
            ValueError: If there is no such reference here.
        """
        if reference not in get_args(Reference):
            raise ValueError(f"reference must be one of {', '.join(get_args(Reference))}, got {reference!r}")
        if reference == "lit":
            if not self.lit.lit_known:
                raise ValueError(f"{self.path}: {MISSING['lit']}")
            return self.lit.lit
        demosaiced = reference.endswith("_demosaiced")
        if self.capture is None:
            if reference != "linear":
                raise ValueError(
                    f"the reference {reference} is of a dark capture, and {self.path} is a set: name a capture"
                )
            exposure = np.float32(self.lit.views.meta.get("exposure_scale", 1.0))  # 1 is white then
            matrix = np.eye(3) if self.lit.color_matrix is None else self.lit.color_matrix  # of the set's own filters
            return lambda i: (self.lit.radiance(i) @ matrix.T).astype(np.float32) * exposure
        if not self.capture.holds("truth"):
            raise ValueError(f"{self.path}: {MISSING['truth']}")
        if demosaiced and not self.capture.demosaiced:
            raise ValueError(f"the reference {reference} belongs to a simulated camera with a colour filter array, and "
                             f"the camera of {self.path} is another: use {reference.partition('_')[0]}")  # fmt: skip
        read = self.capture.clean_linear if reference in LINEAR else self.capture.clean
        return partial(read, demosaiced=demosaiced)


def score_renders(
    folder: Path, truth: Truth, reference: Reference, console: Console, out: Path | None = None
) -> dict[str, Any]:
    """Scores of the pictures in `folder` of all held-out views.

    Files of 8 bits are sRGB-encoded. Files of 16 bits and EXR files are encoded like the reference: sRGB-encoded values
    for "lit" and "clean", linear light for "linear", the same for references of mosaics; files that state their curve
    are read by it. EXR files with a channel Z (and alpha) are scored in depth too.

    Args:
        folder: Of the pictures.
        truth: The truth about the views.
        reference: The pictures they are compared with.
        console: Where progress goes.
        out: Where the scores will be written, for a dry run to say.

    Returns:
        `mean` and `views` by reference as in metrics.json, `geometry` (None without depth), and `about`: the two sides
        of the comparison.

    Raises:
        ValueError: If pictures are missing, cannot be read or are not as a run of ours wrote them, or the reference is
            not known.
    """
    read, (width, height) = truth.reader(reference), truth.size
    renders = find_renders(folder, truth.names)
    refuse_exchanged(folder)
    if renders.ignored:
        console.note(f"{folder}: {len(renders.ignored)} pictures are of no test view and are left out "
                     f"({renders.ignored[0]}{', ...' * (len(renders.ignored) > 1)})")  # fmt: skip

    def pictures() -> Any:
        for i, name in zip(truth.indices, truth.names, strict=True):
            yield i, name, read_picture(renders.files[name], width, height, linear=reference in LINEAR)

    kinds = sorted({picture.kind for _, _, picture in pictures()})  # all are read before anything is computed
    if dry.get():
        console.note(f"score: {len(truth.names)} test views of {folder} to be scored against {reference} {NOT_DONE}")
    planned(console, "score", [] if out is None else [out])
    gain = _gain(read, pictures) if reference in LINEAR else None
    lacking = missing(width, height)
    dataset = None if truth.capture is None else truth.capture.record.dataset
    asked = set[str]() if reference in LINEAR else protocol_of(dataset) | networks() - lacking.keys()
    views, depths, doubts = {}, [], Doubts()
    with console.progress(f"score {folder.name}") as progress:
        for done, (i, name, picture) in enumerate(pictures()):
            views[name] = _view(picture, right := read(i), gain, asked)
            say_stated(renders.files[name], folder, console)
            doubts.add(picture, right, linear=reference in LINEAR)
            if picture.depth is not None and (known := true_depth(truth.lit, i)) is not None:
                doubts.add_depth(picture.depth, known, truth.lit.rig.Ks[i])
                depths.append(geometry_scores(np.maximum(picture.depth, 0.0), picture.alpha, known))
            progress(done + 1, len(truth.indices), f"view {name}")
    for doubt in doubts.notes(reference):
        console.warn(f"{folder}: {doubt}")
    return {
        "mean": {reference: mean_scores(list(views.values()))},
        "views": {name: {reference: scores} for name, scores in views.items()},
        "geometry": mean_scores(depths) if len(depths) == len(views) else None,
        "about": {"reference": reference, "meaning": MEANING[reference], "pictures": kinds, "gain": gain},
    }


def _gain(read: Callable[[int], Image], pictures: Callable[[], Any]) -> float:
    pairs = ((picture.values, read(i)) for i, _, picture in pictures())
    return exposure_gain(pairs)


def _view(picture: ForeignPicture, truth: Image, gain: float | None, asked: Collection[str]) -> dict[str, Any]:
    """Scores of one view; in linear light also those of the pictures that both would be shown as."""
    if gain is None:
        return dict(image_scores(picture.values, truth, asked))
    light = picture.values * np.float32(gain)
    found = None if is_black(truth) else linear_psnr(picture.values, truth, gain)
    return {"linear_psnr": found, **image_scores(encode(light), encode(truth))}
