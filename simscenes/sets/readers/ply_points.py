"""First points that a transforms.json names (`ply_file_path`): a PLY file of points in the frame of its cameras.

nerfstudio writes it with the same turn as its cameras (`applied_transform` tells of both), so no turn is due here. Any
PLY of points is read, in text or binary: x, y, z, and a colour where there is one. Other columns are left alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.door import opened
from sensor_model.files.reading import PLY_TYPES, some
from sensor_model.files.records import read_record
from simscenes.sets.geometry.tracks import SparsePoints

ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
HEADER_LINES = 1000
COLOURS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
HARMONICS = tuple(f"f_dc_{i}" for i in range(3))  # of Gaussians: colour is .5 + .28209 f
MOST = 50_000  # points kept; a mesh of a telephone has millions, and a fit starts from some thousands
GREY = 128
SOURCES = ("transforms.json", "transforms_train.json")  # camera files that may name one
REMEDY = "export the points again, or remove the entry"


@dataclass(frozen=True)
class _Header:
    form: str
    count: int
    columns: list[tuple[str, str]]  # name and type of numpy
    skipped: list[tuple[int, list[str]]]  # elements before the points: how many, and their types


def listed_points(folder: Path) -> Path | None:
    """The file of points that the camera file of a folder names; None: none, or it is not there."""
    source = next((path for name in SOURCES if (path := folder / name).is_file()), None)
    named = None if source is None else read_record(source, {"ply_file_path?": (str, None)}).get("ply_file_path")
    file = None if not named else folder / named.replace("\\", "/")
    return file if file is not None and file.is_file() else None


def is_ours(folder: Path) -> bool:
    """Whether nb-info.json says, as our writer does, that the cameras of a folder are in the frame of its COLMAP model.

    nerfbaselines writes a file of that name into the data sets of others.
    """
    file = folder / "nb-info.json"
    info = read_record(file, {"loader_kwargs?": (dict, None)}) if file.is_file() else {}
    return info.get("id") == "novags" and "colmap_path" in (info.get("loader_kwargs") or {})


def notes_on_points(content: dict[str, Any], source: Path) -> list[str]:
    """That points which lie beside a camera file are not read, and why.

    Args:
        content: Of the camera file.
        source: The file.
    """
    folder = source.parent
    if source.name not in SOURCES or is_ours(folder):
        return []
    if named := content.get("ply_file_path"):
        found = listed_points(folder) is not None
        return [] if found else [f"{source} names a file of first points that is not there ({named}): first points "
                                 "are found in the pictures"]  # fmt: skip
    files = sorted(file.name for file in folder.glob("*.ply"))
    models = [place for place in ("sparse/0", "colmap/sparse/0") if (folder / place).is_dir()]
    if files:
        return [f"{folder} holds points ({some(files)}) that {source.name} does not name: they are not used, since "
                f"their frame is not known; if it is the frame of the cameras, name one as ply_file_path"]  # fmt: skip
    if models:
        return [f"{folder} holds a COLMAP model ({models[0]}) beside {source.name}: its points are not used, since the "
                "cameras of the latter may lie in another frame; move one of them away, or write the points as PLY in "
                "the frame of the cameras (ply_file_path)"]  # fmt: skip
    return []


def read_ply_points(path: Path, most: int | None = MOST) -> SparsePoints:
    """The points of a PLY file, of which nobody said who sees them; of more than `most` an even choice (None: all).

    Raises:
        ValueError: If it is not a PLY file of points, is cut short, or has a coordinate that is not finite.
    """
    try:
        with opened(path) as file:
            header = _header(file, path)
            table = _text(file, header, path) if header.form == "ascii" else _binary(file, header, path)
    except OSError as error:
        raise ValueError(f"cannot read the points {path}: {error.strerror or error}; {REMEDY}") from error
    lacking = [axis for axis in "xyz" if axis not in table]
    if lacking:
        raise ValueError(f"{path} must have points with x, y and z, it has {some(list(table), 8)}; {REMEDY}")
    xyz = np.stack([table[axis] for axis in "xyz"], -1).astype(np.float64)
    if bad := int((~np.isfinite(xyz).all(-1)).sum()):
        raise ValueError(f"{path}: coordinates of points must be finite, {bad} of {len(xyz)} are not; {REMEDY}")
    rgb = _colours(table, len(xyz))
    if most is not None and len(xyz) > most:
        chosen = np.sort(np.random.default_rng(0).choice(len(xyz), most, replace=False))
        xyz, rgb = xyz[chosen], rgb[chosen]
    return SparsePoints.untracked(xyz, rgb)


def _header(file: BinaryIO, path: Path) -> _Header:
    if file.readline(100).strip() != b"ply":
        raise ValueError(f"{path} is not a PLY file (its first line is not 'ply'); {REMEDY}")
    form, count, before = "", -1, []
    columns: list[tuple[str, str]] = []
    element, types = "", []  # type: str, list[str]
    for _ in range(HEADER_LINES):
        words = file.readline(1000).decode("ascii", "replace").split()
        if words[:1] == ["format"] and len(words) == 3:
            form = words[1]
        elif words[:1] == ["element"] and len(words) == 3 and words[2].isdecimal() and len(words[2]) < 12:
            element, number = words[1], int(words[2])
            if element == "vertex":
                count = number
            elif count < 0:
                types = []
                before.append((number, types))
        elif words[:1] == ["property"] and len(words) >= 3:
            if element == "vertex":
                columns.append((words[-1], "list" if words[1] == "list" else PLY_TYPES.get(words[1], words[1])))
            elif count < 0:
                types.append("list" if words[1] == "list" else PLY_TYPES.get(words[1], words[1]))
        elif words[:1] == ["end_header"]:
            break
        elif words and words[0] not in ("comment", "obj_info"):
            raise ValueError(f"{path}: the header of a PLY file has a line that is not understood: "
                             f"{' '.join(words)[:60]!r}; {REMEDY}")  # fmt: skip
    odd = [kind for _, kind in columns if kind not in PLY_TYPES.values()]
    if form not in ORDERS or count < 0 or not columns or odd:
        got = some([f"{name} {kind}" for name, kind in columns], 8) or "no properties"
        raise ValueError(
            f"{path} must be a PLY file of points (format {', '.join(ORDERS)}; element vertex with plain properties), "
            f"got format {form or 'none'}, {max(count, 0)} points, {got}; {REMEDY}"
        )
    return _Header(form, count, columns, before)


def _binary(file: BinaryIO, header: _Header, path: Path) -> dict[str, NDArray[Any]]:
    order = ORDERS[header.form]
    for number, types in header.skipped:
        if any(kind not in PLY_TYPES.values() for kind in types):
            raise ValueError(f"{path}: points must come before elements of lists; {REMEDY}")
        file.seek(number * sum(np.dtype(kind).itemsize for kind in types), 1)
    row = np.dtype([(f"{i}", order + kind) for i, (_, kind) in enumerate(header.columns)])
    data = file.read(row.itemsize * header.count)
    if len(data) < row.itemsize * header.count:
        raise ValueError(f"{path} is cut short: it announces {header.count} points and has "
                         f"{len(data) // row.itemsize}; {REMEDY}")  # fmt: skip
    table = np.frombuffer(data, row)
    return {name: table[f"{i}"] for i, (name, _) in enumerate(header.columns)}


def _text(file: BinaryIO, header: _Header, path: Path) -> dict[str, NDArray[Any]]:
    lines = [line for line in file.read().splitlines() if line.strip()]
    start = sum(number for number, _ in header.skipped)
    rows = [line.split() for line in lines[start : start + header.count]]
    if len(rows) < header.count:
        raise ValueError(f"{path} is cut short: it announces {header.count} points and has {len(rows)}; {REMEDY}")
    width = len(header.columns)
    if (short := next((i for i, row in enumerate(rows) if len(row) < width), None)) is not None:
        raise ValueError(f"{path}: point {short} must have {width} numbers, got {len(rows[short])}; {REMEDY}")
    try:
        values = np.array([row[:width] for row in rows], np.float64).reshape(-1, width)
    except ValueError as error:
        raise ValueError(f"{path}: points must be numbers ({error}); {REMEDY}") from error
    return {
        name: values[:, i].astype(kind if kind[0] == "u" else "f8") for i, (name, kind) in enumerate(header.columns)
    }


def _colours(table: dict[str, NDArray[Any]], count: int) -> NDArray[np.uint8]:
    for names in COLOURS:
        if all(name in table for name in names):
            rgb = np.stack([table[name] for name in names], -1)
            largest = float(np.nan_to_num(rgb).max(initial=0))  # floats are shares, or codes of 8 bits
            most = {"u1": 255.0, "u2": 65535.0}.get(rgb.dtype.str[1:], 1.0 if largest <= 1 else 255.0)
            return np.round(np.clip(np.nan_to_num(rgb / most), 0, 1) * 255).astype(np.uint8)
    if all(name in table for name in HARMONICS):
        light = 0.5 + 0.28209479177387814 * np.stack([table[name] for name in HARMONICS], -1)
        return np.round(np.clip(np.nan_to_num(light), 0, 1) * 255).astype(np.uint8)
    return np.full((count, 3), GREY, np.uint8)
