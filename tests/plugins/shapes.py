"""A scene for every shape."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tests.plugins import files
from tests.plugins.row import Node, Row, matt, stage


def shape(plugin: str, node: Any, note: str = "") -> Row:
    """A matt thing of this shape; `node` makes it of a folder."""
    return Row(
        "shape", plugin, lambda mi, folder: stage(mi, thing={"type": plugin, "bsdf": matt(), **node(mi, folder)}), note
    )


def plain(**parameters: Any) -> Any:
    return lambda mi, folder: parameters


def raised(mi: Any, folder: Path) -> Node:
    return {"to_world": mi.ScalarTransform4f().translate([0, 0, 0.6]).rotate([1, 0.3, 0], 60).scale(0.5)}


def copies(mi: Any, folder: Path) -> Node:
    group = {"type": "shapegroup", "ball": {"type": "sphere", "center": [0, 0, 0.6], "radius": 0.4, "bsdf": matt()}}
    return stage(mi, group=group, copy={"type": "instance", "group": {"type": "ref", "id": "group"}})


def field(mi: Any, folder: Path) -> Node:
    z, y, x = np.mgrid[:8, :8, :8] / 7 - 0.5
    grid = mi.TensorXf(np.float32(np.sqrt(x**2 + y**2 + z**2) - 0.4)[..., None])
    return {"grid": grid, "to_world": mi.ScalarTransform4f().translate([-0.5, -0.5, 0.1])}


def splats(mi: Any, folder: Path) -> Node:
    one = np.float32([[0, 0, 0.6]])
    tensor = mi.TensorXf
    return {"centers": tensor(one), "scales": tensor(np.float32([[0.2, 0.1, 0.2]])),
            "quaternions": tensor(np.float32([[0, 0, 0, 1]]))}  # fmt: skip


def merged(mi: Any, folder: Path) -> Node:
    return {"a": {"type": "cube", "bsdf": matt(), **raised(mi, folder)}}


def pyramid(plugin: str, name: str) -> Row:
    written = files.serialized if plugin == "serialized" else files.mesh
    return shape(plugin, lambda mi, folder: {"filename": written(folder / name)})


SHAPES = [
    shape("bsplinecurve", lambda mi, folder: {"filename": files.curve(folder / "c.txt")}),
    shape("linearcurve", lambda mi, folder: {"filename": files.curve(folder / "c.txt")}),
    shape("cube", raised), shape("cylinder", raised), shape("disk", raised), shape("rectangle", raised),
    shape("sphere", plain(center=[0, 0, 0.6], radius=0.5)),
    shape("ellipsoids", splats), shape("ellipsoidsmesh", splats), shape("sdfgrid", field),
    pyramid("obj", "m.obj"), pyramid("ply", "m.ply"), pyramid("serialized", "m.serialized"),
    Row("shape", "shapegroup", copies, "by its `instance`"), Row("shape", "instance", copies),
    Row("shape", "merge", lambda mi, folder: stage(mi, thing={"type": "merge", **merged(mi, folder)})),
]  # fmt: skip
