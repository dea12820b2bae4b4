"""Whether a COLMAP model is whole, before pycolmap sees it: cut files and absurd counts make that hang or fill memory.

Every count is compared with the bytes that are left in its file, and every reference with the entries that exist. The
formats: https://colmap.github.io/format.html, and for rigs and frames COLMAP 3.12.
"""

from __future__ import annotations

import mmap
import shutil
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from struct import Struct
from struct import error as StructError
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.atomic import write_text
from sensor_model.files.door import admitted, opened, read_text
from sensor_model.files.reading import reading

NEEDED = ("cameras", "images")
PARTS = (*NEEDED, "points3D")
NONE = 2**64 - 1  # the number of no point; -1 in text
REMEDY = "download or export the model again"
POINT2D = np.dtype([("xy", "<f8", 2), ("point", "<u8")])
TRACK = np.dtype([("image", "<u4"), ("index", "<u4")])


@dataclass
class Model:
    """The entries that must agree between the files."""

    cameras: set[int] = field(default_factory=set)
    seen: dict[int, NDArray[np.uint64]] = field(default_factory=dict)  # image -> point (or NONE) of each 2D point
    names: dict[int, str] = field(default_factory=dict)
    poses: dict[int, list[float]] = field(default_factory=dict)  # quaternion (w first) and translation, world to camera
    points: set[int] = field(default_factory=set)

    def add_camera(self, number: int, width: int, height: int, params: Any) -> None:
        """A camera."""
        _require(number not in self.cameras, f"has two cameras {number}")
        _require(0 < width < 1e7 and 0 < height < 1e7, f"has a camera of {width} x {height} pixels")
        _require(np.isfinite(params).all(), f"has parameters that are not finite in camera {number}")
        self.cameras.add(number)

    def add_image(self, number: int, camera: int, name: str, pose: list[float], seen: NDArray[np.uint64]) -> None:
        """An image; `pose` is quaternion and translation."""
        _require(number not in self.seen, f"has two images {number}")
        _require(camera in self.cameras, f"names camera {camera} in image {name!r}, which the file of cameras lacks")
        _require(np.isfinite(pose).all() and any(pose[:4]), f"has a pose that is not finite or zero in image {name!r}")
        self.seen[number] = seen
        self.names[number] = name
        self.poses[number] = pose

    def add_points(self, numbers: NDArray[np.uint64], xyz: NDArray[np.float64], tracks: NDArray[Any]) -> None:
        """All points, and the elements of all their tracks."""
        self.points = set(numbers.tolist())
        _require(len(self.points) == len(numbers) and NONE not in self.points, "has a point twice, or one of no number")
        _require(np.isfinite(xyz).all(), "has coordinates that are not finite")
        images = np.unique(tracks["image"])
        absent = set(images.tolist()) - self.seen.keys()
        _require(not absent, f"has tracks through image {min(absent, default=0)}, which is not there")
        counts = np.array([len(self.seen[i]) for i in images.tolist()], np.int64)
        if len(tracks):
            short = tracks["index"] >= counts[np.searchsorted(images, tracks["image"])]
            _require(not short.any(), "has tracks through 2D points that are not there")

    def check_observations(self) -> None:
        """Names differ, and every 2D point is of a point that is there, or of none."""
        _require(len(set(self.names.values())) == len(self.names), "has an image twice")
        every = np.unique(np.concatenate([np.array([NONE], np.uint64), *self.seen.values()])).tolist()
        absent = [number for number in every if number != NONE and number not in self.points]
        _require(not absent, f"shows point {absent[:1]} (and {len(absent) - 1} more) that points3D does not have")


def check_model(folder: Path) -> Model:
    """Refuse a model that is cut short, or whose parts do not belong together.

    Args:
        folder: With cameras, images and points3D, all .bin or all .txt (rigs and frames may be there as well). A model
            of no points may lack points3D.

    Returns:
        Its entries. pycolmap ends a name in a text file at the first space.

    Raises:
        ValueError: Naming the file and its fault.
    """
    return _read_binary(folder) if model_suffix(folder) == "bin" else _read_text(folder)


def model_suffix(folder: Path) -> str:
    """Suffix of a model's files: "bin" or "txt", whichever is more nearly whole.

    Raises:
        ValueError: If cameras or images are missing.
    """
    here = {suffix: [part for part in PARTS if (folder / f"{part}.{suffix}").is_file()] for suffix in ("bin", "txt")}
    suffix = max(here, key=lambda suffix: (set(NEEDED) <= set(here[suffix]), len(here[suffix])))
    if lacking := [f"{part}.{suffix}" for part in NEEDED if part not in here[suffix]]:
        raise ValueError(f"{folder} is not a whole COLMAP model, it lacks {', '.join(lacking)}; {REMEDY}")
    return suffix


@contextmanager
def with_points(folder: Path) -> Iterator[Path]:
    """A folder that pycolmap reads as this model: itself, or a copy with an empty file of points where it has none, and
    without byte-order marks, of which pycolmap knows nothing.
    """
    suffix = model_suffix(folder)
    files = [file for part in (*PARTS, "rigs", "frames") if (file := folder / f"{part}.{suffix}").is_file()]
    marked = [file for file in files if suffix == "txt" and _is_marked(file)]
    if not marked and (folder / f"points3D.{suffix}").is_file():
        yield folder
        return
    with TemporaryDirectory() as scratch:
        (Path(scratch) / f"points3D.{suffix}").write_bytes(_U64.pack(0) if suffix == "bin" else b"")
        for file in files:
            if file in marked:
                write_text(Path(scratch) / file.name, read_text(file))
            else:
                shutil.copyfile(admitted(file), Path(scratch) / file.name)
        yield Path(scratch)


def _is_marked(file: Path) -> bool:
    with opened(file) as content:
        return content.read(len(BOM_UTF8)) == BOM_UTF8


def count_images(folder: Path) -> int:
    """How many images a model has, without reading all of it; 0 if it is damaged."""
    with suppress(OSError, ValueError, StructError):
        if model_suffix(folder) == "bin":
            with opened(folder / "images.bin") as file:
                (count,) = _U64.unpack(file.read(_U64.size))
                return int(count) if count * LEAST_IMAGE <= (folder / "images.bin").stat().st_size else 0
        return len(_image_lines(folder / "images.txt"))
    return 0


def _require(ok: bool | np.bool_, what: str) -> None:
    if not ok:
        raise ValueError(what)


def _read_binary(folder: Path) -> Model:
    model = Model()
    steps: tuple[tuple[str, Callable[[_Bytes, Model], None]], ...] = (
        ("rigs", _rigs), ("cameras", _cameras), ("frames", _frames), ("images", _images), ("points3D", _points),
    )  # fmt: skip
    for part, step in steps:
        if (path := folder / f"{part}.bin").is_file():
            with reading(path, REMEDY), opened(path) as file:
                _require(path.stat().st_size >= 8, "is cut short: it has no count")
                with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                    data = _Bytes(content)
                    step(data, model)
                    _require(data.left == 0, f"has {data.left} bytes after its last record")
    with reading(folder / "images.bin", REMEDY):
        model.check_observations()
    return model


class _Bytes:
    """A place in a file."""

    def __init__(self, content: mmap.mmap) -> None:
        self.content, self.at = content, 0

    @property
    def left(self) -> int:
        return len(self.content) - self.at

    def take(self, form: Struct) -> tuple[Any, ...]:
        """The next numbers."""
        _require(form.size <= self.left, f"is cut short: it ends after {len(self.content)} bytes inside a record")
        self.at += form.size
        return form.unpack_from(self.content, self.at - form.size)

    def count(self, form: Struct, least: int, what: str) -> int:
        """A number of things of at least `least` bytes each."""
        (number,) = self.take(form)
        _require(number * least <= self.left, f"is cut short or damaged: it announces {number} {what} of at least "
                 f"{least} bytes, and {self.left} bytes are left")  # fmt: skip
        return int(number)

    def skip(self, size: int) -> bytes:
        """The next bytes."""
        self.at += size
        return self.content[self.at - size : self.at]

    def text(self) -> str:
        """Up to the next zero byte."""
        end = self.content.find(b"\0", self.at)
        _require(end >= 0, "is cut short: it ends inside a name")
        return self.skip(end + 1 - self.at)[:-1].decode()


_U32, _U64, _POSE = Struct("<I"), Struct("<Q"), Struct("<7d")
_CAMERA, _IMAGE, _POINT, _SENSOR = Struct("<IiQQ"), Struct("<I7dI"), Struct("<Q3d3Bd"), Struct("<iI")
LEAST_IMAGE = _IMAGE.size + 9  # bytes, with an empty name and no 2D points
_FRAME, _DATUM, _BYTE = Struct("<II7d"), Struct("<iIQ"), Struct("<B")


def _cameras(data: _Bytes, model: Model) -> None:
    for _ in range(data.count(_U64, _CAMERA.size, "cameras")):
        number, kind, width, height = data.take(_CAMERA)
        model.add_camera(number, width, height, data.take(Struct(f"<{_params_of(kind)}d")))


def _images(data: _Bytes, model: Model) -> None:
    for _ in range(data.count(_U64, LEAST_IMAGE, "images")):
        number, *pose, camera = data.take(_IMAGE)
        name = data.text()
        count = data.count(_U64, POINT2D.itemsize, "2D points")
        seen = np.frombuffer(data.skip(count * POINT2D.itemsize), POINT2D)
        model.add_image(number, camera, name, pose, seen["point"].copy())


def _points(data: _Bytes, model: Model) -> None:
    numbers, places, tracks = [], [], []
    for _ in range(data.count(_U64, _POINT.size + 8, "points")):
        number, x, y, z, *_ = data.take(_POINT)
        numbers.append(number)
        places.append((x, y, z))
        tracks.append(data.skip(TRACK.itemsize * data.count(_U64, TRACK.itemsize, "elements of a track")))
    xyz = np.array(places, np.float64).reshape(-1, 3)
    model.add_points(np.array(numbers, np.uint64), xyz, np.frombuffer(b"".join(tracks), TRACK))


def _rigs(data: _Bytes, model: Model) -> None:
    del model
    for _ in range(data.count(_U64, 8, "rigs")):
        data.take(_U32)
        for k in range(data.count(_U32, _SENSOR.size, "sensors")):
            data.take(_SENSOR)
            if k and data.take(_BYTE)[0]:  # the first one is the rig's own frame
                data.take(_POSE)


def _frames(data: _Bytes, model: Model) -> None:
    del model
    for _ in range(data.count(_U64, _FRAME.size + 4, "frames")):
        _, _, *pose = data.take(_FRAME)
        _require(np.isfinite(pose).all() and any(pose[:4]), "has a pose that is not finite or zero")
        data.skip(_DATUM.size * data.count(_U32, _DATUM.size, "images of a frame"))


@cache
def _params_of(kind: int | str) -> int:
    """Number of parameters of a camera model."""
    import pycolmap

    try:
        known = pycolmap.CameraModelId(kind) if isinstance(kind, int) else getattr(pycolmap.CameraModelId, kind)
        return len(pycolmap.Camera.create_from_model_id(1, known, 1.0, 1, 1).params)
    except Exception as error:  # of pycolmap's own
        raise ValueError(f"has the camera model {kind!r}, which pycolmap does not know") from error


def _read_text(folder: Path) -> Model:
    model = Model()
    with reading(folder / "cameras.txt", REMEDY):
        for words in _lines(folder / "cameras.txt", "cameras"):
            params = list(map(float, words[4:]))
            _require(len(params) == _params_of(words[1]), f"has {len(params)} parameters in camera {words[0]}")
            model.add_camera(int(words[0]), int(words[2]), int(words[3]), params)
    with reading(folder / "images.txt", REMEDY):
        for line, points_line in _image_lines(folder / "images.txt"):
            head, seen = line.split(maxsplit=9), points_line.split()  # the name, which is last, keeps its spaces
            _require(len(head) >= 10 and len(seen) % 3 == 0, f"has an incomplete line for image {head[0]}")
            np.array(seen, np.float64)  # raises for text that is no number
            points = np.array([int(word) % 2**64 for word in seen[2::3]], np.uint64)
            model.add_image(int(head[0]), int(head[8]), head[9], list(map(float, head[1:8])), points)
    if (folder / "points3D.txt").is_file():
        with reading(folder / "points3D.txt", REMEDY):
            rows = _lines(folder / "points3D.txt", "points")
            _require(all(len(row) >= 8 and len(row) % 2 == 0 for row in rows), "has an incomplete line")
            elements = [(int(a), int(b)) for row in rows for a, b in zip(row[8::2], row[9::2], strict=True)]
            xyz = np.array([row[1:8] for row in rows], np.float64).reshape(-1, 7)[:, :3]
            numbers = np.array([int(row[0]) for row in rows], np.uint64)
            model.add_points(numbers, xyz, np.array(elements, TRACK).reshape(-1))
    for part in ("rigs", "frames"):
        if (path := folder / f"{part}.txt").is_file():
            with reading(path, REMEDY):
                _require(bool(_lines(path, part) or not model.names), f"is cut short: it has no {part}")
    with reading(folder / "images.txt", REMEDY):
        model.check_observations()
    return model


def _lines(path: Path, what: str) -> list[list[str]]:
    """Words of each line that is neither empty nor a comment."""
    lines = _stripped(path, may_be_empty=what == "points")
    used = [line.split() for line in lines if line and not line.startswith("#")]
    _require_announced(lines, what, len(used))
    return used


def _image_lines(path: Path) -> list[tuple[str, str]]:
    """The line of each image with the line of its 2D points, which may be empty; COLMAP skips other empty lines."""
    lines = _stripped(path)
    rest = (line for line in lines if not line.startswith("#"))
    pairs = [(line, next(rest, None)) for line in rest if line]
    whole = [(line, points) for line, points in pairs if points is not None]
    _require(len(whole) == len(pairs), "has an image without its line of 2D points")
    _require_announced(lines, "images", len(whole))
    return whole


def _stripped(path: Path, *, may_be_empty: bool = False) -> list[str]:
    """All lines. A file of no points may have none: COLMAP asks for an empty one where poses are known."""
    text = read_text(path)
    _require(text.endswith("\n") or (may_be_empty and not text), "is cut short: its last line does not end (add a line "
             "break if it is whole)")  # fmt: skip
    return [line.strip() for line in text.split("\n")[:-1]]


def _require_announced(lines: list[str], what: str, found: int) -> None:
    """COLMAP states in a comment how many things there are."""
    for line in lines:
        if line.startswith("# Number of ") and ":" in line:
            stated = int(line.split(":")[1].split(",")[0])
            _require(found == stated, f"is cut short: it announces {stated} {what} and has {found}")
