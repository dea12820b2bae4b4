"""A scene of the catalogue: the function that makes it, and the cameras designed for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from simscenes.rigs import Rig, forward_rig, orbit_rig

SceneMaker = Callable[..., dict[str, Any]]
RigMaker = Callable[[int, int, int], Rig]

# An arc from the open south side of the rooms in daylight.py, night.py, indoors.py and close.py.
ROOM = {"swing_deg": 8.0, "start_deg": -150.0, "sweep_deg": 120.0}


@dataclass(frozen=True)
class Scene:
    """A row of `SCENES`.

    Attributes:
        make: (seed) -> Mitsuba scene dict without sensor; a variant must be active. Its docstring says what the scene
            shows and which difficulties it poses.
        rig: (number of views, width, height) -> the cameras designed for it.
        measured_lights: Whether its lamps have measured spectra.
    """

    make: SceneMaker
    rig: RigMaker
    measured_lights: bool = False

    def __call__(self, seed: int = 0) -> dict[str, Any]:
        """The Mitsuba dict of one variation."""
        return self.make(seed)

    @property
    def text(self) -> str:
        """What the scene shows and which difficulties it poses: the docstring of `make`."""
        return self.make.__doc__ or ""


def orbit(fov_x_deg: float, **settings: Any) -> RigMaker:
    """Cameras on a ring around a target, as `orbit_rig`."""
    return lambda n_views, width, height: orbit_rig(n_views, width, height, fov_x_deg, **settings)


def forward(fov_x_deg: float, **settings: Any) -> RigMaker:
    """Cameras on a grid that look ahead, as `forward_rig`."""
    return lambda n_views, width, height: forward_rig(n_views, width, height, fov_x_deg, **settings)
