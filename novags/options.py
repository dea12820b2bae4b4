"""Types and groups of options that commands share."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

PresetName = Literal["demo", "small", "paper", "paper-160"]
Device = Literal["auto", "cpu", "cuda"]
Listed = Literal[
    "all", "scenes", "sensors", "methods", "levels", "presets", "cameras", "enhancers", "metrics", "effects"
]
Folder = Annotated[Path, tyro.conf.Positional]
Folders = Annotated[tuple[Path, ...], tyro.conf.Positional]
Name = Annotated[str, tyro.conf.Positional]
Repeated = Annotated[tuple[str, ...], tyro.conf.UseAppendAction]
Define = Annotated[tuple[str, ...], tyro.conf.arg(aliases=("-D",)), tyro.conf.UseAppendAction]


def absent(metavar: str, instead: str = "") -> Any:
    """How help shows an option that need not be given: its text, or `instead`, says what holds then, not "None"."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=instead)


@dataclass(frozen=True)
class LightOptions:
    """How light gets from the lamps to the sensor."""

    variant: str = "auto"
    """Mitsuba variant."""
    on: tuple[str, ...] = ()
    """Effects of light to simulate whatever the plan says, by the names that `novags plan` prints."""
    off: tuple[str, ...] = ()
    """Effects of light to leave out."""
    max_depth: Annotated[int | None, absent("INT")] = None
    """Longest path of light, as Mitsuba counts; the plan chooses if not given."""
    aperture_radius: Annotated[float | None, absent("FLOAT")] = None
    """Radius of the lens opening in scene units; 0 for a pinhole. If not given: a file's own lens, else a pinhole."""
    focus_distance: Annotated[float | None, absent("FLOAT")] = None
    """Depth in focus, in scene units."""
    motion: Annotated[float | None, absent("FLOAT")] = None
    """How far the cameras travel during the exposure, as a fraction of the way to the next view."""
    response: Annotated[str | None, absent("STR")] = None
    """Measured colour sensitivities of a camera, by colour-science's name ("Nikon 5100 (NPL)"): the set then holds what
    its filters see instead of linear sRGB, from spectra where the scene needs them."""
    define: Define = ()
    """What a parameter of a Mitsuba file stands for, NAME=VALUE; may be given several times."""
    sensor_index: int = 0
    """Which of the sensors of a Mitsuba file the cameras are placed around, from 0."""
    own_cameras: bool = False
    """Take all sensors of a Mitsuba file as the views, instead of cameras around one of them."""
    allow_outside: bool = False
    """Trust a Mitsuba file: let it read files outside its folder."""

    def settings(self) -> dict[str, Any]:
        """As `RenderConfig` takes them."""
        from simscenes.optics import Optics

        lens = {"aperture_radius": self.aperture_radius, "focus_distance": self.focus_distance}
        return {
            "variant": self.variant, "on": self.on, "off": self.off, "max_depth": self.max_depth,
            "allow_outside": self.allow_outside, "parameters": self.define, "sensor_index": self.sensor_index,
            "own_cameras": self.own_cameras, "optics": Optics(**lens, motion=self.motion, camera=self.response),
        }  # fmt: skip


Light = Annotated[LightOptions, tyro.conf.arg(name=""), tyro.conf.OmitArgPrefixes]
LIGHT = LightOptions()


@dataclass(frozen=True)
class ClusterOptions:
    """The Ray cluster of --engine ray."""

    address: Annotated[str | None, absent("STR")] = None
    """HOST:PORT of the cluster. If not given: RAY_ADDRESS, one that runs on this machine, or else one started here."""
    needs: tuple[str, ...] = ()
    """What tasks take: "cpus=2,memory=8GB" for all, "run:gpus=1" or "set:cpus=8" for one kind of set, capture, run."""
    retries: int = 3
    """Times that a task is tried again after its process or its node was lost."""
    scratch: Annotated[str | None, absent("STR")] = None
    """Folder on each node for files fetched from a store at a URL; in its folder for temporary files if not given."""


Cluster = Annotated[ClusterOptions, tyro.conf.arg(name=""), tyro.conf.OmitArgPrefixes]
CLUSTER = ClusterOptions()
