"""Photographs without poses, videos, and the NeRF-synthetic layout."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np

from tests.fuzz.case import Reader
from tests.fuzz.readers.text import read_transforms, some_rig


def make_layout(folder: Path) -> None:
    from PIL import Image

    from simscenes.rigs import opencv_to_opengl

    rng = np.random.default_rng(0)
    poses = iter(opencv_to_opengl(some_rig(5).viewmats))
    for part, count in (("train", 3), ("test", 2)):
        (folder / part).mkdir()
        frames = []
        for i in range(count):
            Image.fromarray(rng.integers(0, 255, (18, 24, 4), np.uint8)).save(folder / part / f"r_{i}.png")
            frames.append({"file_path": f"./{part}/r_{i}", "transform_matrix": next(poses).tolist()})
        content = {"camera_angle_x": 0.69, "frames": frames}
        (folder / f"transforms_{part}.json").write_text(json.dumps(content))


def make_llff(folder: Path) -> None:
    from PIL import Image

    from tests.miniatures import RIG, VIEWS, dark_picture, poses_bounds

    (folder / "images").mkdir()
    for i in range(VIEWS):
        Image.fromarray(dark_picture(i)).save(folder / "images" / f"{i}.png")
    poses_bounds(folder / "poses_bounds.npy", RIG)


def make_bare(folder: Path) -> None:
    from PIL import Image

    rng = np.random.default_rng(0)
    for i in range(3):
        exif = Image.Exif()
        exif[0x0110], exif[0x0112] = "camera", 6
        exif.get_ifd(0x8769)[0xA405] = 28
        exif.get_ifd(0x8769)[0x920A] = 4.2
        Image.fromarray(rng.integers(0, 255, (19, 33, 3), np.uint8)).save(folder / f"{i}.jpg", exif=exif)
    Image.fromarray(rng.integers(0, 255, (33, 19, 4), np.uint8)).save(folder / "upright.png")


def read_bare(folder: Path, file: Path) -> object:
    from simscenes.sets.readers.bare import picture_files, survey

    bare, _ = survey(picture_files(folder), 20)
    return [one.pixels() for one in bare]


def make_video(folder: Path) -> None:
    import cv2

    rng = np.random.default_rng(0)
    for name, code in (("walk.avi", "MJPG"), ("walk.mp4", "mp4v")):
        writer = cv2.VideoWriter(str(folder / name), cv2.VideoWriter_fourcc(*code), 10, (32, 24))
        for _ in range(6):
            writer.write(rng.integers(0, 255, (24, 32, 3), np.uint8))
        writer.release()


def read_video(folder: Path, file: Path) -> object:
    from novags.testbed.folders.photographs.video import write_frames

    with tempfile.TemporaryDirectory() as frames:
        write_frames(file, 4.0, Path(frames), lambda *_: None)
        return [path.read_bytes() for path in sorted(Path(frames).rglob("*.*")) if path.is_file()]


def _sets() -> None:
    import PIL.Image  # noqa: F401
    import pycolmap  # noqa: F401

    import novags.testbed.folders.set  # noqa: F401


def _pictures() -> None:
    import cv2

    import novags.testbed.folders.photographs.video  # noqa: F401
    import simscenes.sets.readers.bare  # noqa: F401

    cv2.setNumThreads(0)


READERS = [
    Reader("NeRF-synthetic layout", make_layout, read_transforms, ("transforms_*.json",), share=4, prepare=_sets),
    Reader("LLFF layout", make_llff, read_transforms, ("poses_bounds.npy",), share=4, prepare=_sets),
    Reader("photographs without poses", make_bare, read_bare, ("*.jpg", "*.png"), share=4, prepare=_pictures),
    Reader("video", make_video, read_video, ("walk.*",), share=0.7, prepare=_pictures),
]
