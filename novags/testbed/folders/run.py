"""A run on disk: what one method made of one capture.

run.json              method, resolved configuration, capture, seconds; written last
point_cloud.ply       the Gaussians, standard 3DGS layout       events.jsonl    losses, one line a step
enhanced/NNNN.png     training images after the enhancement     denoised/NNNN.png    and after the denoiser, if any
renders/NNNN.png      held-out views                            renders_train/NNNN.png    training views
depth/NNNN.exr        Z (expected depth) and alpha of every view
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.methods.enhancers.guided import EnhanceConfig
from novags.testbed.cache import folder_digest, read_json
from novags.testbed.console import Console
from novags.testbed.folders.capture import Capture, DarkSource, open_capture
from novags.testbed.folders.set import Source

RECORD = "run.json"
METRICS = "metrics.json"
EVENTS = "events.jsonl"
CHECKPOINTS = ("checkpoint.safetensors", "checkpoint.denoiser.safetensors")  # there while a run is under way
RESULT = (
    RECORD,
    *CHECKPOINTS,
    "point_cloud.ply",
    EVENTS,
    "enhanced",
    "denoised",
    "renders",
    "renders_train",
    "depth",
)
OWNS = (*RESULT, METRICS, "report.html")


@dataclass(frozen=True)
class Run:
    """A complete run folder."""

    path: Path
    record: dict[str, Any]

    @property
    def method(self) -> str:
        """Name of the method."""
        return str(self.record["method"])

    @property
    def dark_source(self) -> DarkSource:
        """Which of the capture's pictures the method saw."""
        source: DarkSource = self.record["dark_source"]
        return source

    @property
    def enhance_config(self) -> EnhanceConfig:
        """The enhancement that its training images went through, and that the references have to go through."""
        return EnhanceConfig(**self.record["enhance"])

    def inputs(self, console: Console) -> tuple[Capture, Source]:
        """The capture it was made from, and the set that this was made of.

        Raises:
            ValueError: If they are no longer where they were, or no longer what they were.
        """
        path = (self.path / self.record["capture"]).resolve()
        if not path.is_dir():
            raise ValueError(
                f"{self.path} was made from the capture {self.record['capture']} (relative to it), which is not there: "
                "put it back or reconstruct again"
            )
        capture = open_capture(path)
        source = capture.source(console)
        if {"capture": capture.digest(), "set": source.digest()} != self.record["stage"]["inputs"]:
            raise ValueError(f"{path} has changed since {self.path} was made from it: put it back or reconstruct again")
        return capture, source

    def scores(self) -> dict[str, Any] | None:
        """Its part of metrics.json; None if it was not scored since it was made."""
        return read_json(self.path / METRICS)["methods"][self.method] if (self.path / METRICS).exists() else None

    def digest(self) -> str:
        """Hash of all that the method made, scores not included."""
        return folder_digest(self.path, RESULT)

    def events(self) -> list[dict[str, Any]]:
        """The losses, one dict per logged step, in order."""
        path = self.path / EVENTS
        try:
            return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        except (OSError, ValueError) as error:
            raise ValueError(f"{path} is missing or damaged ({error}): reconstruct again") from error


def open_run(path: Path) -> Run:
    """Open a run folder.

    Raises:
        ValueError: If the folder is missing, no run, or an unfinished one.
    """
    if not path.is_dir():
        raise ValueError(f"no such run folder: {path}")
    if not (path / RECORD).exists():
        raise ValueError(
            f"{path} holds no {RECORD}: it is no run, or an unfinished one (run novags reconstruct again, it resumes)"
        )
    record = read_json(path / RECORD)
    if missing := [key for key in ("method", "capture", "dark_source", "enhance", "stage") if key not in record]:
        raise ValueError(f"{path / RECORD} lacks {', '.join(missing)}: reconstruct again")
    return Run(path=path, record=record)
