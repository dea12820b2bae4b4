"""One tiny scene for each plugin: a stage that is the same for all, and what the plugin puts on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simscenes.rigs import Rig, intrinsics, look_at

Node = dict[str, Any]
SIZE = 24  # px


@dataclass(frozen=True)
class Row:
    """A scene with one plugin in it.

    Attributes:
        kind: "bsdf", "emitter", ...
        plugin: Its type.
        make: (mitsuba, folder for data files) -> a scene dict.
        note: What is special about this scene, where a plugin has several.
    """

    kind: str
    plugin: str
    make: Callable[[Any, Path], Node]
    note: str = ""

    @property
    def name(self) -> str:
        """Plugin and note."""
        return f"{self.plugin}, {self.note}" if self.note else self.plugin


def rig() -> Rig:
    """One camera, level with what stands on the stage."""
    pose = look_at((0.3, -4.0, 1.6), (0, 0, 0.5))
    return Rig(viewmats=pose[None], Ks=intrinsics(SIZE, SIZE, 40)[None], width=SIZE, height=SIZE)


def grey(value: float) -> Node:
    """A colour that is the same in RGB and in spectra."""
    return {"type": "rgb", "value": value}


def matt(value: float = 0.5) -> Node:
    return {"type": "diffuse", "reflectance": grey(value)}


def plate(mi: Any, y: float, bsdf: Node, size: float = 0.6, turned: float = 0.0) -> Node:
    """An upright plate that faces the camera, turned about its own axis by some degrees."""
    place = mi.ScalarTransform4f().translate([0, y, 0.6]).rotate([1, 0, 0], 90).rotate([0, 0, 1], turned).scale(size)
    return {"type": "rectangle", "to_world": place, "bsdf": bsdf}


def ball(bsdf: Node, **more: Any) -> Node:
    return {"type": "sphere", "center": [0, 0, 0.6], "radius": 0.5, "bsdf": bsdf, **more}


def stage(mi: Any, light: Node | None = None, **things: Any) -> Node:
    """A matt floor and wall with a lamp above, or with the lights given."""
    t = mi.ScalarTransform4f()
    upright = t.translate([0, 2, 0]).rotate([1, 0, 0], 90).scale(3)
    lamp = {
        "type": "rectangle", "to_world": t.translate([0, -1, 4]).rotate([1, 0, 0], 180).scale(0.7),
        "emitter": {"type": "area", "radiance": grey(8.0)},
    }  # fmt: skip
    return {
        "type": "scene",
        "floor": {"type": "rectangle", "to_world": t.scale(3), "bsdf": matt()},
        "wall": {"type": "rectangle", "to_world": upright, "bsdf": matt(0.6)},
        **({"lamp": lamp} if light is None else light),
        **things,
    }
