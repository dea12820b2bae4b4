"""A run on disk: the results of one method from one capture.

run.json              method, resolved configuration, capture, cameras, seconds; written last
point_cloud.ply       the scene (of a method that fits Gaussians: the standard 3DGS layout)
scene/                or of other kinds (a radiance field: scene/field.safetensors)
cameras.json          the training cameras in its frame, in the format of 3DGS viewers
viewers/              the scene in further formats, on request
enhancer.safetensors  weights of the network that made the pictures bright, of methods with one
events.jsonl          losses, one line per step
enhanced/NNNN.png     training pictures after the enhancement     denoised/NNNN.png   and what was fitted, if different
renders/NNNN.png      held-out views                              renders_train/NNNN.png    training views
exr/NNNN.exr          of every view, float32: R G B as rendered, Z (expected depth in the method's frame), alpha
explain/              where its dB are lost: a run for each ingredient that was replaced by its truth
along/NNNNNN/         renders/ and exr/ of the held-out views after so many iterations of the fit, on request
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from novags.methods.enhancers import located, why_not_here
from novags.methods.enhancers.enhancer import NETWORK
from novags.testbed.console.terminal import Console
from novags.testbed.folders import shapes
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.events import event_of
from novags.testbed.folders.exchanged import refuse_exchanged
from novags.testbed.folders.place import place_of, place_text
from novags.testbed.folders.set import Source
from novags.testbed.ledger.contents import folder_digest, read_json, refuse_damage
from sensor_model.files.door import enter, read_text
from sensor_model.files.reading import brief
from sensor_model.files.records import check_shape
from sensor_model.frame import own
from simscenes.sets.pictures.exr import read_exr
from simscenes.sets.pictures.png import read_png

RECORD = "run.json"
METRICS = "metrics.json"
EVENTS = "events.jsonl"
# Present while a run is under way: of methods of one fit, of their networks, of methods of several fits.
CHECKPOINTS = (
    "checkpoint.safetensors", "checkpoint.denoiser.safetensors", "checkpoint.enhancer.safetensors", "checkpoints",
)  # fmt: skip
ALONG = "along"
HELD = "held_out"  # in the record: training views that nothing was trained on
EXPLAINED = "explain"  # where its dB are lost, and the runs that say so
LARGEST = 1e12  # of rendered values: the sum of their squares over a picture stays within 32 bits
SCENE = "point_cloud.ply"
CAMERAS, VIEWERS = "cameras.json", "viewers"
RESULT = (
    RECORD,
    SCENE,
    CAMERAS,
    VIEWERS,
    "scene",
    NETWORK,
    EVENTS,
    "enhanced",
    "denoised",
    "renders",
    "renders_train",
    "exr",
    "depth",
    ALONG,
)
OWNS = (*RESULT, *CHECKPOINTS, METRICS, EXPLAINED, "report.html", "report.files")


@dataclass(frozen=True)
class Run:
    """A complete run folder."""

    path: Path
    record: dict[str, Any]
    at: int | None = None  # iterations after which its held-out views are shown; None: at the end

    @property
    def name(self) -> str:
        """Name of the method or of its variant."""
        return str(self.record["name"])

    @property
    def method(self) -> str:
        """Name of the method."""
        return str(self.record["method"])

    @property
    def space(self) -> str:
        """The meaning of its colours, as `Reconstruction.space`."""
        return str(self.record["space"])

    @property
    def enhancement(self) -> dict[str, Any] | None:
        """The enhancement of its training pictures, which the references need too; None for methods without one, and
        where its enhancer is not here (see `lacks`).
        """
        return None if self.lacks else self._enhancement

    @cached_property
    def lacks(self) -> str | None:
        """Why its enhancement cannot be made again here, if that is so: results on disk are shown all the same.

        The enhancer is not here, or an effect of the camera, which the noise depends on, is not.
        """
        if self._enhancement is None:
            return None
        return why_not_here(self._enhancement) or own.missing(self.record.get("effects", ()))

    @property
    def _enhancement(self) -> dict[str, Any] | None:
        found: dict[str, Any] | None = self.record["enhancement"]
        return found and located(found, self.path)

    @property
    def depth_scale(self) -> float:
        """World units per unit of the frame of the method's cameras."""
        return float((self.record.get("cameras") or {}).get("depth_scale", 1.0))

    @property
    def peak_bytes(self) -> int:
        """The most memory that its reconstruction held: of a program its own, not the memory of the process that
        waited.
        """
        return int(self.record.get("peak_bytes", self.record["stage"]["peak_bytes"]))

    @property
    def has_depth(self) -> bool:
        """Whether it gives a depth for every held-out view; programs need not."""
        return bool(self.record.get("depth", True))

    @property
    def shows_training_views(self) -> bool:
        """Whether the training views are rendered too; programs need not."""
        return (self.path / "renders_train").is_dir()

    def rendering(self, name: str) -> np.ndarray:
        """The view `name` as rendered, float32 [h,w,3]; of runs made before floats were kept, the 8-bit picture."""
        if (path := self._shown / "exr" / f"{name}.exr").exists():
            return np.stack([*_channels(path, "R", "G", "B")], -1)
        pictures = self._pictures(name)
        return read_png(next((file for file in pictures if file.exists()), pictures[0]))

    def shows(self, name: str) -> bool:
        """Whether the view `name` is rendered; programs need not render training views."""
        return any(file.exists() for file in (self._shown / "exr" / f"{name}.exr", *self._pictures(name)))

    def _pictures(self, name: str) -> list[Path]:
        return [self._shown / kind / f"{name}.png" for kind in ("renders", "renders_train")]

    @property
    def _shown(self) -> Path:
        return self.path if self.at is None else place_along(self.path, self.at)

    def depth(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Expected z-depth in the frame of the method's cameras, and alpha, of the view `name`, float32 [h,w].

        Both are 0 where the run has none.
        """
        folder = "exr" if (self.path / "exr").is_dir() else "depth"
        path = self.path / folder / f"{name}.exr"
        if not self.has_depth:
            nothing = np.zeros_like(next(iter(read_exr(path)[0].values())))
            return nothing, nothing
        depth, alpha = _channels(path, "Z", "alpha")
        return depth, alpha

    def along(self) -> "list[Run]":
        """The same run after fewer iterations, in their order, where it was asked to be shown along its fit."""
        return [replace(self, at=at) for at in self.record.get(ALONG, ())]

    @property
    def held(self) -> list[str]:
        """Training views that nothing was trained on: their dark pictures judge lengths of the fit without truth."""
        return list(self.record.get(HELD, ()))

    @property
    def iterations(self) -> int:
        """Of its fit, where it has one."""
        return int(self.record["config"]["fit"]["iterations"])

    def inputs(self, console: Console) -> tuple[Capture, Source]:
        """The capture it was made from, and the set from which that was made.

        Raises:
            ValueError: If they have moved, or they or the run itself have changed.
        """
        capture = self.capture()
        source = capture.source(console)
        self._refuse_other("set", source.content, capture.path)
        return capture, source

    def capture(self) -> Capture:
        """The capture it was made from.

        Raises:
            ValueError: If it has moved, or it or the run itself has changed.
        """
        refuse_exchanged(self.path)
        path = place_of(self.path, self.record["capture"])
        if not path.is_dir():
            raise ValueError(
                f"{self.path} was made from the capture {place_text(self.record['capture'])} (relative to it), which "
                "is not there: put it back or reconstruct again"
            )
        capture = open_capture(path)
        self._refuse_other("capture", capture.content, path)
        return capture

    def _refuse_other(self, name: str, content: str, path: Path) -> None:
        if content != self.record["stage"]["inputs"][name]:
            raise ValueError(f"{path} has changed since {self.path} was made from it: put it back or reconstruct again")

    def metrics(self) -> dict[str, Any] | None:
        """Its metrics.json; None if it has not been scored since it was made."""
        if not (self.path / METRICS).exists():
            return None
        record = dict(read_json(self.path / METRICS, shapes.METRICS))
        refuse_damage(self.path, record.get("stage", {}), "score it again")
        return record

    def scores(self) -> dict[str, Any] | None:
        """Its part of metrics.json; None if it has not been scored since it was made."""
        record = self.metrics()
        return None if record is None else dict(record["methods"]).get(self.name)

    def digest(self) -> str:
        """Hash of everything the method produced, scores excluded."""
        return folder_digest(self.path, RESULT)

    def events(self) -> list[dict[str, Any]]:
        """The losses, one dict per logged step, in order."""
        path = self.path / EVENTS
        try:
            lines = read_text(path).splitlines()
        except (OSError, ValueError) as error:
            raise ValueError(f"{path} is missing or damaged ({brief(error)}): reconstruct again") from error
        return [event_of(line, f"{path}, line {number}") for number, line in enumerate(lines, 1)]


def place_along(run: Path, iterations: int) -> Path:
    """Where a run shows its held-out views after so many iterations."""
    return run / ALONG / f"{iterations:06d}"


def _channels(path: Path, *names: str) -> list[np.ndarray]:
    """Channels of a picture that a method rendered.

    Raises:
        ValueError: If it lacks one, or one holds values that no method renders.
    """
    channels, _ = read_exr(path)
    for name in names:
        if name not in channels:
            raise ValueError(f"{path} has no channel {name}: reconstruct again")
        if wrong := int(np.count_nonzero(~(np.abs(channels[name]) <= LARGEST))):
            raise ValueError(f"{path} is damaged: {wrong} pixels of its channel {name} are not finite or beyond "
                             f"{LARGEST:g}; put back the original, or reconstruct again")  # fmt: skip
    return [channels[name] for name in names]


def open_run(path: Path) -> Run:
    """Open a run folder.

    Raises:
        ValueError: If the folder is missing, is not a run, or is unfinished.
    """
    if not path.is_dir():
        raise ValueError(f"no such run folder: {path}")
    enter(path)
    if not (path / RECORD).exists():
        raise ValueError(
            f"{path} holds no {RECORD}: it is not a run, or an unfinished one (run novags reconstruct again: it "
            "resumes)"
        )
    record = _as_written_now(read_json(path / RECORD))
    check_shape(record, shapes.RUN, f"{path / RECORD}", "reconstruct again")
    return Run(path=path, record=record)


def _as_written_now(record: dict[str, Any]) -> dict[str, Any]:
    """A record of version 0.1.0 with the entries of later versions: all methods rendered enhanced pictures then."""
    if "space" in record or "enhance" not in record:
        return record
    enhancement = {"enhancer": "guided", "pictures": record.get("dark_source"), "config": record["enhance"]}
    return {**record, "name": record.get("method"), "space": "enhanced", "enhancement": enhancement}
