"""OBJ meshes that Mitsuba 3.9 misreads: corners without a texture coordinate or a normal, and indices from the end.

Its reader allocates a value for every vertex as soon as the file has a single `vt` or `vn`, and fills in only the
values that a corner names. Old content of the memory then bends normals, moves textures and changes from run to run.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sensor_model.files.door import read_bytes

LISTS = (b"v", b"vt", b"vn")


@contextmanager
def completed(files: Sequence[Path]) -> Iterator[Path]:
    """The scene file to load: the one given, or while this lasts a copy of it beside complete copies of OBJ files.

    Corners get the texture coordinate (0, 0) and the normal of their face where the file has such values for others;
    values that no corner names are dropped. A warning says so.

    Args:
        files: The scene file and the files it names, absolute. OBJ files outside its folder are left alone.
    """
    scene, root = files[0], files[0].parent
    with TemporaryDirectory(prefix="novags-obj-") as temporary:
        folder = Path(temporary)
        for file in files:
            if file.suffix.lower() == ".obj" and file.is_file() and file.is_relative_to(root):
                content = read_bytes(file)
                if (whole := complete(content)) is not content:
                    _write(folder / file.relative_to(root), whole)
                    # Mitsuba searches the folder of the scene file before all others.
                    _write(folder / scene.name, read_bytes(scene))
                    warnings.warn(
                        f"mesh file {file}: not every corner of its faces names a normal and a texture coordinate, or "
                        "some are counted from the end; missing normals become the normal of the face, texture "
                        "coordinates 0",
                        stacklevel=2,
                    )
        yield folder / scene.name if (folder / scene.name).exists() else scene


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def complete(content: bytes) -> bytes:
    """An OBJ file in which every corner names all kinds of values in the file; the very same object if it is so
    already.
    """
    has = [bool(re.search(rb"^[ \t]*" + name + rb"[ \t]", content, re.MULTILINE)) for name in LISTS]
    if _is_complete(content, has[1], has[2]):
        return content
    lists: dict[bytes, list[bytes]] = {name: [] for name in LISTS}
    rest: list[list[list[int]] | bytes] = []  # faces by their corners, other lines unchanged
    for line in content.splitlines():
        words = line.split(b"#", 1)[0].split()
        if words and words[0] in lists:
            lists[words[0]].append(line)
        elif words and words[0] == b"f":
            counts = [len(lists[name]) for name in LISTS]
            try:
                rest.append([_corner(word, counts) for word in words[1:]])
            except ValueError:
                return content  # not a face: Mitsuba says so
        else:
            rest.append(line)
    return _written(lists, rest)


def _is_complete(content: bytes, coordinates: bool, normals: bool) -> bool:
    named, free = rb"/\d+", rb"(?:/\d*)?"
    corner = rb"\d+" + (named if coordinates else free if not normals else rb"/\d*") + (named if normals else free)
    return not re.search(
        rb"^[ \t]*f[ \t]+(?!(?:" + corner + rb"[ \t\r]+)*" + corner + rb"[ \t\r]*$)", content, re.MULTILINE
    )


def _corner(word: bytes, counts: list[int]) -> list[int]:
    """Indices of position, texture coordinate and normal, from 1; 0 for none. Negative ones count from the end."""
    indices = [int(part) if part else 0 for part in word.split(b"/")]
    found = [*indices, 0, 0][:3]
    return [index if index >= 0 else count + 1 + index for index, count in zip(found, counts, strict=True)]


def _written(lists: dict[bytes, list[bytes]], rest: list[list[list[int]] | bytes]) -> bytes:
    faces = [face for face in rest if isinstance(face, list)]
    used = {name: any(corner[k] for face in faces for corner in face) for k, name in enumerate(LISTS)}
    for name in LISTS[1:]:
        if not used[name]:
            lists[name] = []
    if used[b"vt"] and any(not corner[1] for face in faces for corner in face):
        lists[b"vt"].append(b"vt 0 0")
        for face in faces:
            for corner in face:
                corner[1] = corner[1] or len(lists[b"vt"])
    if used[b"vn"]:
        for face in faces:
            if any(not corner[2] for corner in face):
                lists[b"vn"].append(_normal(face, lists[b"v"]))
                for corner in face:
                    corner[2] = corner[2] or len(lists[b"vn"])
    lines = [line for name in LISTS for line in lists[name]]
    for part in rest:
        lines.append(part if isinstance(part, bytes) else b"f " + b" ".join(map(_spelled, part)))
    return b"\n".join(lines) + b"\n"


def _spelled(corner: list[int]) -> bytes:
    return "/".join(str(index) if index else "" for index in corner).rstrip("/").encode()


def _normal(face: list[list[int]], positions: list[bytes]) -> bytes:
    """The normal of a face; of one without area, or of corners that are not there, any."""
    normal = np.array([0.0, 0.0, 1.0])
    try:
        a, b, c = (np.array(positions[corner[0] - 1].split()[1:4], np.float64) for corner in face[:3])
        across = np.cross(b - a, c - a)
        if (length := np.linalg.norm(across)) > 0 and np.isfinite(length):
            normal = across / length
    except (ValueError, IndexError):
        pass  # Mitsuba refuses such a face
    return b"vn " + " ".join(f"{x:.9g}" for x in normal).encode()
