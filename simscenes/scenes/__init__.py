"""Catalogue of procedural scenes: functions that return Mitsuba dicts, and the rig designed for each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from sensor_model.files.reading import brief
from simscenes.rigs import Rig, forward_rig, orbit_rig
from simscenes.scenes.close import glassware, thicket
from simscenes.scenes.cornell import cornell
from simscenes.scenes.courtyard import courtyard
from simscenes.scenes.daylight import gallery, hall, studio
from simscenes.scenes.indoors import bookshop, busts
from simscenes.scenes.night import lantern, market, street
from simscenes.scenes.tabletop import tabletop

RigMaker = Callable[[int, int, int], Rig]


def _orbit(fov_x_deg: float, **settings: Any) -> RigMaker:
    return lambda n_views, width, height: orbit_rig(n_views, width, height, fov_x_deg, **settings)


def _forward(fov_x_deg: float, **settings: Any) -> RigMaker:
    return lambda n_views, width, height: forward_rig(n_views, width, height, fov_x_deg, **settings)


# An arc from the open south side of the rooms in daylight.py, night.py and close.py.
_ROOM = {"swing_deg": 8.0, "start_deg": -150.0, "sweep_deg": 120.0}

_CATALOGUE: dict[str, tuple[Callable[..., dict[str, Any]], RigMaker]] = {
    "tabletop": (tabletop, _orbit(52.0, target=(0.02, 0.02, 0.12), radius=1.45, elevation_deg=27.0, swing_deg=9.0,
                                  start_deg=-150.0, sweep_deg=140.0)),
    "cornell": (cornell, _forward(58.0, position=(0, -1.75, 0), target=(0, 0.3, -0.15), extent=(0.62, 0.5), rows=4)),
    "courtyard": (courtyard, _orbit(60.0, target=(0.1, 0.1, 0.95), radius=3.5, elevation_deg=14.0, swing_deg=7.0,
                                    start_deg=-195.0, sweep_deg=195.0)),
    "studio": (studio, _orbit(52.0, target=(0.05, 0.1, 0.35), radius=1.8, elevation_deg=24.0, **_ROOM)),
    "gallery": (gallery, _orbit(66.0, target=(0.0, 0.2, 0.8), radius=1.7, elevation_deg=10.0, **_ROOM)),
    "hall": (hall, _orbit(60.0, target=(0.0, 0.5, 0.5), radius=1.9, elevation_deg=16.0, **_ROOM)),
    "street": (street, _forward(62.0, position=(0, -1.6, 1.5), target=(0, 3.5, 1.1), extent=(0.9, 0.45), rows=4)),
    "market": (market, _orbit(56.0, target=(0.0, 0.2, 0.75), radius=1.7, elevation_deg=20.0, **_ROOM)),
    "lantern": (lantern, _orbit(62.0, target=(0.05, 0.4, 0.95), radius=1.8, elevation_deg=12.0, **_ROOM)),
    "glassware": (glassware, _orbit(48.0, target=(0.05, 0.05, 0.2), radius=1.5, elevation_deg=22.0, **_ROOM)),
    "bookshop": (bookshop, _orbit(58.0, target=(0.05, 1.3, 1.2), radius=1.9, elevation_deg=9.0, **_ROOM)),
    "busts": (busts, _orbit(50.0, target=(0.1, 0.3, 0.85), radius=1.75, elevation_deg=12.0, **_ROOM)),
    "thicket": (thicket, _orbit(52.0, target=(0.0, 0.0, 0.45), radius=1.7, elevation_deg=18.0, **_ROOM)),
}  # fmt: skip

DIGITS = 18  # of a scene's seed, at most: it is part of file names
SCENES: dict[str, Callable[..., dict[str, Any]]] = {name: make for name, (make, _) in _CATALOGUE.items()}
MEASURED_LIGHTS = frozenset({"market"})  # scenes whose lamps have measured spectra


def split_name(name: str) -> tuple[str, int]:
    """Split "tabletop:3" into the scene's name and its seed, which is 0 if the name has no number.

    Raises:
        ValueError: If the scene is not in the catalogue or the seed is not a whole number >= 0.
    """
    scene, _, seed = name.partition(":")
    if scene not in SCENES:
        raise ValueError(
            f"no scene {brief(repr(name), 100)} in the catalogue{_what_it_is(name)}; available: {sorted(SCENES)}. "
            "Mitsuba files end in .xml"
        )
    if seed and not (seed.isdecimal() and len(seed) <= DIGITS):
        raise ValueError(f"the seed in scene name {brief(repr(name), 100)} must be a whole number >= 0 of at most "
                         f"{DIGITS} digits")  # fmt: skip
    return scene, int(seed or 0)


def canonical_name(name: str) -> str:
    """The one spelling of a catalogue scene: "cornell" for "cornell:0", "tabletop:1" for "tabletop:01".

    Raises:
        ValueError: As `split_name`.
    """
    scene, seed = split_name(name)
    return f"{scene}:{seed}" if seed else scene


def _what_it_is(name: str) -> str:
    """What else the name is that of."""
    try:
        if Path(name).is_dir():
            return " (it is a folder; a set that is there need not be rendered: novags capture)"
        return " (it is a file)" if Path(name).is_file() else ", and no set folder of that name"
    except (OSError, ValueError):  # too long for a path, or with a zero byte
        return ""


def build(name: str) -> dict[str, Any]:
    """The Mitsuba dict of a catalogue scene, "tabletop" or with a seed "tabletop:3"; a variant must be active."""
    scene, seed = split_name(name)
    return SCENES[scene](seed)


def default_rig(name: str, n_views: int, width: int, height: int) -> Rig:
    """The rig designed for a catalogue scene.

    Args:
        name: Scene name, with or without a seed.
        n_views: Number of cameras.
        width: Image width in pixels.
        height: Image height in pixels.
    """
    return _CATALOGUE[split_name(name)[0]][1](n_views, width, height)
