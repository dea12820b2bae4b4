"""Transforms that Mitsuba 3.9 does not carry out as the scene states them; it says so in its log at most."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.loading.contents import class_of, surfaces_in

SAME = 1e-3  # relative: files have axes of three digits, and matrices of float32


def check_axis(attributes: Mapping[str, str], path: Path) -> None:
    """Refuse the `<rotate>` of a file whose axis is not of length 1: Mitsuba takes it unchanged, and stretches shapes.

    Raises:
        ValueError: If it is another length. Words that are no numbers are left to Mitsuba.
    """
    words = attributes.get("value", "").replace(",", " ").split() or [attributes.get(axis, "0") for axis in "xyz"]
    try:
        angle, axis = float(attributes.get("angle", "0")), [float(word) for word in words]
    except ValueError:
        return
    length = float(np.linalg.norm(axis * 3 if len(axis) == 1 else axis))  # one number stands for all three
    if angle % 360 and length > 0 and not abs(length - 1) <= SAME:
        raise ValueError(f"scene file {path} turns by {angle:g} degrees about the axis {' '.join(words)}, which must "
                         f"be of length 1, got {length:.4g}: Mitsuba would stretch what it turns; divide by the "
                         "length")  # fmt: skip


def check_shapes(scene: Any, mi: Any) -> None:
    """Refuse shapes of a loaded scene that Mitsuba shows, or lets shine, as if their transform were another one.

    Raises:
        ValueError: If there is one: a sphere that is stretched, a lamp on a stretched cylinder, a turned `sdfgrid`.
    """
    for shape in surfaces_in(scene, mi):
        kind = class_of(shape)
        if kind == "Sphere" or (kind == "Cylinder" and shape.emitter() is not None) or kind == "SDFGrid":
            matrix = np.array(mi.traverse(shape)["to_world"].matrix, np.float64).reshape(4, 4, -1)[:3, :3, 0]
            if problem := _problem(kind, matrix):
                raise ValueError(f"shape {shape.id() or kind!r} {problem}")


def _problem(kind: str, matrix: NDArray[np.float64]) -> str:
    """What is wrong with the linear part [3,3] of a shape's transform; "" if nothing is."""
    if not np.isfinite(matrix).all():
        return ""  # said of all shapes alike
    scales = np.linalg.norm(matrix, axis=0)
    unit = matrix / np.maximum(scales, 1e-300)
    stretched = ", ".join(f"{size:.4g}" for size in np.linalg.svd(matrix, compute_uv=False))
    if kind == "SDFGrid":
        return "" if np.abs(unit - np.eye(3)).max() <= SAME else (
            "is an 'sdfgrid' that is turned or mirrored: Mitsuba would lose parts of it; turn an instance of it"
        )  # fmt: skip
    round_ = scales if kind == "Sphere" else scales[:2]
    if np.ptp(round_) <= SAME * round_.max() and np.abs(unit.T @ unit - np.eye(3)).max() <= SAME:
        return ""
    if kind == "Sphere":
        return (f"is a sphere that is stretched by {stretched}: Mitsuba would show a ball; stretch an instance of a "
                "sphere, or take a mesh")  # fmt: skip
    return (f"is a lamp on a cylinder that is stretched by {stretched}, across or askew: Mitsuba would send a wrong "
            "amount of light; take a mesh")  # fmt: skip
