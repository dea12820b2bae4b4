"""Names for the objects of a scene: the ids of a file, and made-up names to tell apart objects without an id."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any


def shape_names(shapes: Iterable[Any]) -> tuple[str, ...]:
    """A name for each shape or instance, no two alike.

    Its id; else the name of the file that it was read from; else its kind, such as "Sphere". Names that are taken get
    a number: "Sphere", "Sphere_2".
    """
    found = [_given(shape) for shape in shapes]
    taken, named = {name for name, own in found if own}, []
    used: Counter[str] = Counter()
    for name, own in found:
        used[name] += 1
        if own and used[name] == 1:
            named.append(name)
            continue
        number, free = 1, name
        while free in taken:
            number += 1
            free = f"{name}_{number}"
        taken.add(free)
        named.append(free)
    return tuple(named)


def _given(shape: Any) -> tuple[str, bool]:
    """The preferred name of a shape, and whether its scene gives it."""
    if (own := shape.id()) and not own.startswith("_unnamed"):
        return own, True
    # Mitsuba keeps the name of a mesh's file nowhere but in its printed description.
    file = re.search(r'^\s*name = "(.+)"', str(shape), re.MULTILINE)
    return (Path(file.group(1)).stem if file else shape.class_name()), False
