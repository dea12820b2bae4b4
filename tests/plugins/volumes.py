"""A scene for every medium, phase function and volume."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.plugins import files
from tests.plugins.row import Node, Row, ball, grey, stage

ALBEDO = grey(0.8)


def cloud(kind: str, plugin: str, medium: Any, note: str = "", skin: Node | None = None) -> Row:
    """A ball filled with a medium; `medium` makes it of a folder."""
    return Row(kind, plugin, lambda mi, folder: stage(
        mi, thing=ball(skin or {"type": "null"}, interior=medium(folder))), note)  # fmt: skip


def homogeneous(**more: Any) -> Any:
    return lambda folder: {"type": "homogeneous", "sigma_t": 2.0, "albedo": ALBEDO, **more}


def heterogeneous(folder: Path) -> Node:
    grid = {"type": "gridvolume", "filename": files.volume(folder / "g.vol")}
    return {"type": "heterogeneous", "sigma_t": grid, "albedo": ALBEDO, "scale": 3.0}


def fibres(folder: Path) -> Node:
    grid = {"type": "gridvolume", "filename": files.volume(folder / "s.vol", 6)}
    return {"type": "homogeneous", "sigma_t": 2.0, "albedo": ALBEDO, "phase": {"type": "sggx", "S": grid}}


COLORED = {"type": "spectrum", "value": [(400, 0.1), (550, 0.3), (600, 3.0), (700, 3.0)]}
MEDIA = [
    cloud("medium", "homogeneous", homogeneous()),
    cloud("medium", "homogeneous", homogeneous(albedo=grey(0.999), scale=8.0),
          "dense and white"),
    cloud("medium", "homogeneous", homogeneous(sigma_t=COLORED), "a measured spectrum"),
    cloud("medium", "homogeneous", homogeneous(scale=5.0, albedo=grey(0.99)), "under glass", {"type": "dielectric"}),
    cloud("medium", "heterogeneous", heterogeneous),
    cloud("phase", "hg", homogeneous(phase={"type": "hg", "g": 0.7})),
    cloud("phase", "isotropic", homogeneous(phase={"type": "isotropic"})),
    cloud("phase", "rayleigh", homogeneous(phase={"type": "rayleigh"})),
    cloud("phase", "sggx", fibres),
    cloud("phase", "tabphase", homogeneous(phase={"type": "tabphase", "values": "0.5, 1.0, 2.0"})),
    cloud("phase", "blendphase", homogeneous(phase={
        "type": "blendphase", "weight": 0.5, "a": {"type": "hg", "g": 0.7}, "b": {"type": "isotropic"}})),
    cloud("volume", "constvolume", homogeneous(sigma_t={"type": "constvolume", "value": 2.0})),
    cloud("volume", "gridvolume", heterogeneous),
]  # fmt: skip
