"""A flight through the reconstruction of a run, on a smooth path through its training cameras."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from novags.methods.nerf.scene import FILE
from novags.methods.problem import encode
from novags.splats.views import Views
from novags.testbed.console.terminal import Console
from novags.testbed.flight.film import check_path, film
from novags.testbed.flight.panels import CaptionedPicture, frame
from novags.testbed.flight.path import SAME, fly
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.references import pictured, references
from novags.testbed.folders.run import CAMERAS, SCENE, Run
from novags.testbed.folders.set import Source
from novags.testbed.ledger.dry import planned
from novags.testbed.report.look.pictures import LONG, TRUTHS
from novags.testbed.viewer.splats import scene_of
from novags.testbed.viewer.world import own_cameras
from sensor_model.files.records import read_record

LENSES = [{"fx": float, "fy": float}]
LONGEST = 20_000  # frames of one film


@dataclass
class Beside:
    """The places of a flight that have pictures: the training views.

    Attributes:
        run: The run.
        capture: Its capture.
        lit: The set that was made from.
        names: Of the training views with a camera, as `Flight.nearest` counts them.
    """

    run: Run
    capture: Capture
    lit: Source
    names: list[str]
    _kept: dict[int, list[tuple[np.ndarray, str]]] = field(default_factory=dict)

    def panels(self, nearest: int, distance: float) -> list[CaptionedPicture]:
        """The truth, where one is known, and the dark picture of the nearest training view."""
        view = self.names[nearest]
        if nearest not in self._kept:
            self._kept[nearest] = self._pictures(self.capture.names.index(view))
        where = f"view {view}" if distance <= SAME else f"no picture from here; nearest: view {view}"
        return [CaptionedPicture(image, title, where) for image, title in self._kept[nearest]]

    def _pictures(self, i: int) -> list[tuple[np.ndarray, str]]:
        found = []
        if truths := references(self.run, self.capture, self.lit, i):
            kind, image = next(iter(truths.items()))
            told = LONG[kind] if self.capture.imported and kind in LONG else TRUTHS[kind]
            found.append((encode(image) if kind == "linear" else image, told[0]))
        return [*found, (self.capture.srgb8(i), "Dark input")]


@dataclass(frozen=True)
class Course:
    """Where a flight through a run leads: its training cameras, in its own frame.

    Attributes:
        names: Of the training views with a camera.
        viewmats: World to camera [C, 4, 4] float64.
        K: Intrinsics of all frames [3, 3]: the median focal lengths, the principal point of the capture.
    """

    names: list[str]
    viewmats: np.ndarray
    K: np.ndarray

    @staticmethod
    def of(run: Run, capture: Capture) -> "Course":
        """The course through a run's cameras.

        Raises:
            ValueError: If they are missing or damaged, or name views that the capture does not have.
        """
        if (found := own_cameras(run)) is None:
            raise ValueError(f"{run.path} has no {CAMERAS}: reconstruct again")
        names, viewmats = found
        if unknown := [name for name in names if name not in capture.names]:
            raise ValueError(
                f"{run.path / CAMERAS} names {unknown[0]}, which is not a view of {capture.path}: reconstruct again"
            )
        lenses = read_record(run.path / CAMERAS, LENSES, "reconstruct again")
        K = np.median(np.asarray(capture.cameras.rig.Ks, np.float64), axis=0)
        K[0, 0], K[1, 1] = (float(np.median([lens[side] for lens in lenses])) for side in ("fx", "fy"))
        return Course(names, viewmats.numpy(), K)


def check_length(seconds: float, fps: float) -> None:
    """Refuse a film of no frames, or of more than anybody will look at.

    Raises:
        ValueError: If it would be one.
    """
    if not (0 < seconds and 0 < fps <= 240 and seconds * fps <= LONGEST):
        raise ValueError(f"a film takes > 0 seconds at up to 240 frames a second (fps), and at most {LONGEST} frames, "
                         f"got {seconds:g} s at {fps:g} frames a second")  # fmt: skip


def make_video(run: Run, out: Path, console: Console, *, seconds: float, fps: float) -> int:
    """Film the flight; returns the number of frames.

    Raises:
        ValueError: If the run holds neither Gaussians nor a field, its cameras or its capture cannot be read, or a
            number is refused.
        OSError: If the file cannot be written.
    """
    check_path(out)
    check_length(seconds, fps)
    if (scene := scene_of(run)) is None:
        raise ValueError(f"{run.path} has neither {SCENE} nor {FILE}: only Gaussians and fields can be rendered from "
                         f"new places, and {run.method} has made neither")  # fmt: skip
    capture, lit = run.inputs(console)
    course = Course.of(run, capture)
    flight = fly(course.viewmats, max(2, round(seconds * fps)))
    beside, rig = Beside(run, capture, lit, course.names), capture.cameras.rig
    K = torch.from_numpy(course.K).float()[None]
    planned(console, "video", [out])
    with console.progress("video") as progress, film(out, fps, len(flight.viewmats)) as made:
        for k, viewmat in enumerate(flight.viewmats):
            view = Views(torch.from_numpy(viewmat).float()[None], K, rig.width, rig.height)
            image = scene.render(view)[0][0].cpu().numpy()
            own = CaptionedPicture(pictured(run, capture, image), run.name, "reconstruction")
            made.add(frame([own, *beside.panels(int(flight.nearest[k]), float(flight.distance[k]))]))
            progress(k + 1, len(flight.viewmats), f"frame {k + 1}")
    return len(flight.viewmats)
