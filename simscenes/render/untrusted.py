"""Checks on scenes before they cost anything: what a file may read, and numbers no physical scene has."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

MAX_XML_BYTES = 64 << 20
MAX_INCLUDES = 15  # Mitsuba's own limit on nested files


def check_xml(path: Path, *, allow_outside: bool = False) -> None:
    """Read a scene file as plain XML and refuse it if it reaches for files outside its own folder.

    Mitsuba reads included files and spectra while it parses, so this happens before it sees the file.

    Args:
        path: The scene file.
        allow_outside: Let it name files anywhere.

    Raises:
        ValueError: If the file is not XML, is too large, declares entities, nests includes too deeply, or names a file
            outside its folder.
    """
    _check_file(path, path.parent.resolve(), {}, 0, allow_outside)


def _check_file(path: Path, root: Path, known: dict[str, str], depth: int, allow_outside: bool) -> None:
    if depth > MAX_INCLUDES:
        raise ValueError(f"scene file {path} includes files more than {MAX_INCLUDES} deep; does one include itself?")
    try:
        if path.stat().st_size > MAX_XML_BYTES:
            raise ValueError(
                f"scene file {path} is larger than {MAX_XML_BYTES >> 20} MiB; keep meshes in files of their own"
            )
        text = path.read_bytes()
        if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
            raise ValueError(f"scene file {path} declares entities, which can grow without bound; write them out")
        tree = ElementTree.fromstring(text)
    except (OSError, ElementTree.ParseError) as error:
        raise ValueError(f"scene file {path} cannot be read as XML: {error}") from error
    for element in tree.iter():
        attributes = {name: _substitute(value, known) for name, value in element.attrib.items()}
        if element.tag == "default":
            known.setdefault(attributes.get("name", ""), attributes.get("value", ""))
        for name in ("value", "filename"):
            if not allow_outside and _is_outside(attributes.get(name, ""), root):
                raise ValueError(f"scene file {path.name} names {attributes[name]!r}, outside its folder {root}; "
                                 "move the file there, or set allow_outside=True if you trust the scene")  # fmt: skip
        if element.tag == "include" and "filename" in attributes:
            _check_file(root / attributes["filename"], root, known, depth + 1, allow_outside)


def _substitute(value: str, known: dict[str, str]) -> str:
    for name in sorted(known, key=len, reverse=True):  # $ab before $a, as Mitsuba does
        value = value.replace(f"${name}", known[name])
    return value


def _is_outside(value: str, root: Path) -> bool:
    """Whether this is a path (plain words and numbers are not) that leaves the folder, also through a link."""
    if "\0" in value or len(value) > 4096 or ("/" not in value and "\\" not in value and not (root / value).exists()):
        return False
    return not (root / value.replace("\\", "/")).resolve().is_relative_to(root)


def check_parameters(params: Any, mi: Any) -> None:
    """Refuse a loaded scene whose numbers are not physical.

    Raises:
        ValueError: If a parameter is nan or infinite, a reflectance or albedo leaves 0..1, or a light is negative.
    """
    if "spectral" in mi.variant():
        return  # colours are stored there as the coefficients of fitted curves, of any sign and size
    for key in params.keys():  # noqa: SIM118  mitsuba's SceneParameters does not iterate over keys
        value = params[key]
        if isinstance(value, (str, bool, mi.Object)) or "Transform" in type(value).__name__:
            continue
        numbers = np.array(value)
        if numbers.dtype.kind != "f" or numbers.size == 0:
            continue
        lowest, highest = float(numbers.min()), float(numbers.max())  # nan in any element makes both nan
        if not np.isfinite([lowest, highest]).all():
            raise ValueError(f"scene parameter {key} must be finite, got {lowest}..{highest}")
        if ("reflectance" in key or "albedo" in key) and key.endswith(("value", "values", "data")):
            # 1e-4: spectra given as RGB are fitted by Mitsuba, and white comes out a rounding error above 1.
            if lowest < 0 or highest > 1 + 1e-4:
                raise ValueError(f"scene parameter {key} must lie in 0..1 (what is reflected of the light), "
                                 f"got {lowest:.6g}..{highest:.6g}")  # fmt: skip
        if any(word in key for word in ("radiance", "irradiance", "intensity")) and lowest < 0:
            raise ValueError(f"scene parameter {key} must be >= 0 (light), got {lowest:.6g}")
