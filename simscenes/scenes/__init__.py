"""Catalogue of procedural scenes: functions that return Mitsuba dicts, and the rig each is made to be seen with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from simscenes.rigs import Rig, forward_rig, orbit_rig
from simscenes.scenes.cornell import cornell
from simscenes.scenes.courtyard import courtyard
from simscenes.scenes.tabletop import tabletop

SCENES: dict[str, Callable[..., dict[str, Any]]] = {
    "tabletop": tabletop,
    "cornell": cornell,
    "courtyard": courtyard,
}


def _tabletop_rig(n_views: int, width: int, height: int) -> Rig:
    return orbit_rig(n_views, width, height, 52.0, target=(0.02, 0.02, 0.12), radius=1.45, elevation_deg=27.0,
                     swing_deg=9.0, start_deg=-160.0, sweep_deg=220.0)  # fmt: skip


def _cornell_rig(n_views: int, width: int, height: int) -> Rig:
    return forward_rig(n_views, width, height, 58.0, position=(0.0, -1.75, 0.0), target=(0.0, 0.3, -0.15),
                       extent=(0.62, 0.5), rows=4)  # fmt: skip


def _courtyard_rig(n_views: int, width: int, height: int) -> Rig:
    return orbit_rig(n_views, width, height, 60.0, target=(0.1, 0.1, 0.95), radius=3.5, elevation_deg=14.0,
                     swing_deg=7.0, start_deg=-195.0, sweep_deg=195.0)  # fmt: skip


_RIGS: dict[str, Callable[[int, int, int], Rig]] = {
    "tabletop": _tabletop_rig,
    "cornell": _cornell_rig,
    "courtyard": _courtyard_rig,
}


def split_name(name: str) -> tuple[str, int]:
    """Split "tabletop:3" into the scene's name and its seed (0 if there is none).

    Raises:
        ValueError: If the scene is not in the catalogue or the seed is not a whole number >= 0.
    """
    scene, _, seed = name.partition(":")
    if scene not in SCENES:
        raise ValueError(f"no scene {scene!r} in the catalogue; there are {sorted(SCENES)}, or give a Mitsuba dict")
    if seed and not seed.isdecimal():
        raise ValueError(f"the seed in scene name {name!r} must be a whole number >= 0")
    return scene, int(seed or 0)


def build(name: str) -> dict[str, Any]:
    """The Mitsuba dict of a catalogue scene, "tabletop" or with a seed "tabletop:3"; a variant must be active."""
    scene, seed = split_name(name)
    return SCENES[scene](seed)


def default_rig(name: str, n_views: int, width: int, height: int) -> Rig:
    """The rig a catalogue scene is made to be seen with.

    Args:
        name: Scene name, with or without a seed.
        n_views: Number of cameras.
        width: Image width in pixels.
        height: Image height in pixels.
    """
    return _RIGS[split_name(name)[0]](n_views, width, height)
