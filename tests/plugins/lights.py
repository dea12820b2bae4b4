"""A scene for every emitter, and for the spectra that only lights have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.plugins import files
from tests.plugins.row import Node, Row, ball, grey, matt, stage

SHINY: Node = {"type": "roughplastic", "alpha": 0.2, "diffuse_reflectance": {"type": "rgb", "value": 0.5}}


def light(plugin: str, node: Any, note: str = "", kind: str = "emitter", paint: Node | None = None) -> Row:
    """A ball in this light; `node` makes it of (mitsuba, folder)."""
    return Row(
        kind, plugin, lambda mi, folder: stage(mi, {"light": node(mi, folder)}, thing=ball(paint or matt())), note
    )


def lamp(emitter: Node) -> Any:
    def make(mi: Any, folder: Path) -> Node:
        place = mi.ScalarTransform4f().translate([0, -1, 4]).rotate([1, 0, 0], 180).scale(0.7)
        return {"type": "rectangle", "to_world": place, "emitter": emitter}

    return make


def beam(plugin: str, **parameters: Any) -> Any:
    """A lamp at a corner that shines onto the stage."""

    def make(mi: Any, folder: Path) -> Node:
        place = mi.ScalarTransform4f().look_at(origin=[-2, -3, 3], target=[0, 0, 0.5], up=[0, 0, 1])
        return {"type": plugin, "to_world": place, **parameters}

    return make


def projector(mi: Any, folder: Path) -> Node:
    slide = {"type": "bitmap", "filename": files.picture(folder / "t.exr")}
    return beam("projector", irradiance=slide, fov=40.0, scale=10.0)(mi, folder)


def sun(plugin: str, **parameters: Any) -> Any:
    """A sky whose zenith is up here."""

    def make(mi: Any, folder: Path) -> Node:
        return {"type": plugin, "turbidity": 3.0, **parameters}

    return make


REDDISH = {
    "type": "diffuse",
    "reflectance": {"type": "spectrum", "value": [(400, 0.1), (550, 0.2), (600, 0.9), (700, 0.9)]},
}
LIGHTS = [
    light("area", lamp({"type": "area", "radiance": grey(8.0)})),
    light("constant", lambda mi, folder: {"type": "constant", "radiance": grey(1.0)}),
    light("directional", lambda mi, folder: {"type": "directional", "direction": [0, 0.5, -1], "irradiance": grey(3)}),
    light("directionalarea", lamp({"type": "directionalarea", "radiance": grey(8.0)})),
    light("envmap", lambda mi, folder: {"type": "envmap", "filename": files.picture(folder / "e.exr")}),
    light("point", lambda mi, folder: {"type": "point", "position": [0, -1, 3], "intensity": grey(20.0)}),
    light("projector", projector),
    light("spot", beam("spot", intensity=grey(30.0), cutoff_angle=30.0)),
    light("sunsky", sun("sunsky", sun_direction=[0.3, -0.5, 0.8])),
    light("timed_sunsky", sun("timed_sunsky")),
    light("blackbody", lamp({"type": "area", "radiance": {"type": "blackbody", "temperature": 2500.0}}),
          kind="spectrum", paint=REDDISH),
    light("d65", lamp({"type": "area", "radiance": {"type": "d65", "scale": 8.0}}), kind="spectrum"),
    light("srgb", lamp({"type": "area", "radiance": {"type": "rgb", "value": [8.0, 6.0, 4.0]}}), "a coloured lamp",
          kind="spectrum", paint=SHINY),
]  # fmt: skip
