"""Frames into a video file: MP4 (MPEG-4), or an animated WebP, which browsers show as a picture."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from sensor_model.files.atomic import atomic
from sensor_model.files.door import admitted

SUFFIXES = (".mp4", ".webp")
LARGEST = 2_000_000_000  # bytes of the frames of a WebP


class Film(Protocol):
    """Takes frames."""

    def add(self, frame: np.ndarray) -> None:
        """Add a frame: uint8 RGB [h,w,3], all of one size, even in both directions."""
        ...


@contextmanager
def film(path: Path, fps: float, count: int) -> Iterator[Film]:
    """A video file of so many frames that appears when the block ends without an error.

    Raises:
        ValueError: If the suffix is neither .mp4 nor .webp, this OpenCV cannot write MP4, or the frames of a WebP,
            which are encoded together, would not fit into memory.
        OSError: If the file cannot be written.
    """
    check_path(path)
    with atomic(path) as temporary:
        made: Any = _Mp4(temporary, fps) if path.suffix == ".mp4" else _WebP(temporary, fps, count)
        try:
            yield made
            made.finish()
        finally:
            made.release()
        if not made.is_whole():
            raise OSError(f"{path}: not all of it was written; is the disk full?")


def check_path(path: Path) -> None:
    """Raise ValueError where no film can be written: a folder, or a file of another kind."""
    if path.is_dir():
        raise ValueError(f"a video is a file, and {path} is a folder: choose another --out")
    if path.suffix not in SUFFIXES:
        raise ValueError(f"a video must be called {' or '.join(SUFFIXES)}, got {path.name}: choose another --out")


class _Mp4:
    def __init__(self, path: Path, fps: float) -> None:
        self._path, self._fps, self._frames = path, fps, 0
        self._writer: Any = None

    def add(self, frame: np.ndarray) -> None:
        import cv2

        if self._writer is None:
            self._path.touch()  # raises with the system's reason; OpenCV gives none
            size = (frame.shape[1], frame.shape[0])
            self._writer = cv2.VideoWriter(str(self._path), cv2.VideoWriter.fourcc(*"mp4v"), self._fps, size)
            if not self._writer.isOpened():
                raise ValueError(f"this OpenCV cannot write {self._path.suffix}: give --out a name that ends in .webp")
        self._writer.write(np.ascontiguousarray(frame[..., ::-1]))
        self._frames += 1

    def finish(self) -> None:
        """Complete the file."""
        self.release()

    def release(self) -> None:
        """Close open files; an unfinished film is lost."""
        if self._writer is not None:
            self._writer.release()

    def is_whole(self) -> bool:
        """Whether the file lists every frame: OpenCV says nothing of a full disk, and the list is written last."""
        import cv2

        reader = cv2.VideoCapture(admitted(self._path))
        count = int(reader.get(cv2.CAP_PROP_FRAME_COUNT)) if reader.isOpened() else 0
        reader.release()
        return count == self._frames > 0


class _WebP:
    def __init__(self, path: Path, fps: float, count: int) -> None:
        self._path, self._fps, self._count, self._frames = path, fps, count, list[Any]()

    def add(self, frame: np.ndarray) -> None:
        from PIL import Image

        if not self._frames and self._count * frame.nbytes > LARGEST:
            raise ValueError(f"{self._count} frames of {frame.shape[1]} x {frame.shape[0]} are too many for a WebP: "
                             f"they have to be in memory together ({self._count * frame.nbytes / 1e9:.1f} GB). Give "
                             "--out a name that ends in .mp4, or fewer seconds or frames a second")  # fmt: skip
        self._frames.append(Image.fromarray(frame))

    def finish(self) -> None:
        """Encode all frames, which takes long."""
        if self._frames:
            first, *rest = self._frames
            # Whole milliseconds between rounded times: rounded durations would make a film up to a tenth too long.
            times = [round(1000 * k / self._fps) for k in range(len(self._frames) + 1)]
            durations = [after - before for before, after in pairwise(times)]
            first.save(self._path, "webp", save_all=True, append_images=rest, duration=durations, loop=0, quality=80,
                       method=2)  # fmt: skip

    def release(self) -> None:
        """Let go of the frames."""
        self._frames.clear()

    def is_whole(self) -> bool:
        """Whether there is a file: Pillow raises where it cannot write all of it."""
        return self._path.exists() and self._path.stat().st_size > 0
