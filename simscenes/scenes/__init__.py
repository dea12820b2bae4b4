"""Catalogue of procedural scenes. A row is loaded when it is asked for: a new scene needs a file, and a line here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sensor_model.files.reading import brief, meant
from sensor_model.files.registry import Registry
from simscenes.rigs import Rig
from simscenes.scenes.scene import Scene

SCENES: Registry[Scene] = Registry(
    {
        "tabletop": "simscenes.scenes.tabletop:TABLETOP",
        "cornell": "simscenes.scenes.cornell:CORNELL",
        "courtyard": "simscenes.scenes.courtyard:COURTYARD",
        "studio": "simscenes.scenes.daylight:STUDIO",
        "gallery": "simscenes.scenes.daylight:GALLERY",
        "hall": "simscenes.scenes.daylight:HALL",
        "street": "simscenes.scenes.night:STREET",
        "market": "simscenes.scenes.night:MARKET",
        "lantern": "simscenes.scenes.night:LANTERN",
        "glassware": "simscenes.scenes.close:GLASSWARE",
        "bookshop": "simscenes.scenes.indoors:BOOKSHOP",
        "busts": "simscenes.scenes.indoors:BUSTS",
        "thicket": "simscenes.scenes.close:THICKET",
        "sofa": "simscenes.scenes.unseen:SOFA",
        "bicycle": "simscenes.scenes.unseen:BICYCLE",
    },
    "novags.scenes",
    Scene,
)
DIGITS = 18  # of a scene's seed, at most: it is part of file names


def split_name(name: str) -> tuple[str, int]:
    """Split "tabletop:3" into the scene's name and its seed, which is 0 if the name has no number.

    Raises:
        ValueError: If the scene is not in the catalogue or the seed is not a whole number >= 0.
    """
    scene, _, seed = name.partition(":")
    if scene not in SCENES:
        raise ValueError(
            f"no scene {brief(repr(name), 100)} in the catalogue{_what_it_is(name)}; "
            f"{meant(name.partition(':')[0], SCENES)}available: {sorted(SCENES)}. "
            "scene files end in .xml, .gltf or .glb"
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
    """Which other thing has this name."""
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
    return SCENES[split_name(name)[0]].rig(n_views, width, height)
