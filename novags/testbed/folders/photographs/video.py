"""Frames of a video file, through OpenCV."""

import os
from pathlib import Path

from novags.testbed.console.terminal import Update
from sensor_model.files.door import admitted
from sensor_model.files.reading import brief
from simscenes.sets.names import numbered
from simscenes.sets.pictures.image_file import MAX_PIXELS
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.bare import VIDEOS

VIDEO = 1 << 38  # bytes; a film is read frame by frame
MOST = 100_000  # frames that are counted on; a damaged header can announce any number


def is_video(path: Path) -> bool:
    """Whether a file is named like a video."""
    return path.suffix.lower() in VIDEOS and path.is_file()


def write_frames(video: Path, fps: float, folder: Path, progress: Update) -> dict[Path, str]:
    """Write the frames that are shown at times k / `fps`; returns their files, in order, with "NAME at T s" of each.

    Args:
        video: The file; frames are turned upright as it says.
        fps: Frames to take from each second; from a video with fewer, all.
        folder: Where 0000.png, ... go.
        progress: Called with (done, total, what).

    Raises:
        ValueError: If the file is not a readable video, or holds no frame.
    """
    import cv2

    # FFmpeg complains of a damaged film on standard error, in the film's own characters. Read at first use.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET
    reader = cv2.VideoCapture(admitted(video, most=VIDEO))
    try:
        rate = reader.get(cv2.CAP_PROP_FPS)
        if not reader.isOpened() or not 0 < rate < 1e5:
            raise ValueError(f"{video} is not a video that OpenCV reads: convert it (to MP4, H.264), or give a folder "
                             "of its frames")  # fmt: skip
        width, height = (reader.get(side) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if not 0 < width * height <= MAX_PIXELS:
            raise ValueError(f"{video} declares frames of {width:g} x {height:g} px, at most {MAX_PIXELS} pixels can "
                             "be read: scale it down")  # fmt: skip
        count = int(min(MOST, max(1, reader.get(cv2.CAP_PROP_FRAME_COUNT))))
        taken, k = list[tuple[Path, float]](), 0
        while len(taken) < MOST and reader.grab():
            if k / rate >= len(taken) / fps - 1e-9:  # 1e-9: 0.1 * 3 and 3 / 10 differ in the last bit
                good, frame = reader.retrieve()
                if good and frame is not None:  # of some damaged films it says good and gives none
                    path = folder / f"{len(taken):06d}.png"
                    write_png(path, frame[..., ::-1])
                    taken.append((path, k / rate))
            k += 1
            progress(min(k, count), count, f"frame {k}")
    except cv2.error as error:
        raise ValueError(f"{video} is damaged ({brief(error)}): convert it, or give a folder of its frames") from error
    finally:
        reader.release()
    if not taken:
        raise ValueError(f"{video} holds no frame that can be read: convert it, or give a folder of its frames")
    files = [folder / f"{name}.png" for name in numbered(len(taken))]
    for (old, _), new in zip(taken, files, strict=True):
        old.rename(new)
    return {file: f"{video.name} at {time:.2f} s" for file, (_, time) in zip(files, taken, strict=True)}
