"""One frame of a flight: the reconstruction, the truth and the dark picture side by side, with words below."""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

HEIGHT = 320  # px that a picture has at least in the film; small ones are enlarged by whole numbers
LARGEST = 8190  # px of either side of a frame, the most that MPEG-4 can write; larger pictures are shrunk
GAP, BAR = 8, 52  # px between panels, and below them for two lines
INK, DIM, GROUND = (236, 236, 232), (160, 164, 172), (19, 20, 23)


@dataclass(frozen=True)
class CaptionedPicture:
    """A picture with two lines of text.

    Attributes:
        image: sRGB code, 0..1, [h,w,3].
        title: Its caption.
        note: Where it comes from.
    """

    image: np.ndarray
    title: str
    note: str


def frame(panels: list[CaptionedPicture]) -> np.ndarray:
    """The panels beside each other, uint8 [h,w,3], both sides even (video formats want that)."""
    enlarged = _fitted([_enlarged(panel.image) for panel in panels])
    height = max(image.shape[0] for image in enlarged)
    width = sum(image.shape[1] for image in enlarged) + GAP * (len(panels) - 1)
    canvas = np.empty((height + BAR + (height + BAR) % 2, width + width % 2, 3), np.uint8)
    canvas[:] = GROUND
    left = 0
    for panel, image in zip(panels, enlarged, strict=True):
        rows, columns = image.shape[:2]
        canvas[:rows, left : left + columns] = image
        canvas[height : height + BAR, left : left + columns] = _words(panel.title, panel.note, columns)
        left += columns + GAP
    return canvas


def _fitted(images: list[np.ndarray]) -> list[np.ndarray]:
    """Pictures that have room beside each other in a frame: unchanged, or all shrunk alike."""
    wide, high = sum(image.shape[1] for image in images), max(image.shape[0] for image in images)
    share = min((LARGEST - GAP * len(images)) / wide, (LARGEST - BAR) / high)
    if share >= 1:
        return images
    import cv2

    sizes = [(max(1, int(share * image.shape[1])), max(1, int(share * image.shape[0]))) for image in images]
    return [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image, size in zip(images, sizes, strict=True)]


def _enlarged(image: np.ndarray) -> np.ndarray:
    times = max(1, math.ceil(HEIGHT / image.shape[0]))
    codes = np.round(np.clip(image, 0.0, 1.0) * 255).astype(np.uint8)
    return codes.repeat(times, 0).repeat(times, 1)


@cache
def _words(title: str, note: str, width: int) -> np.ndarray:
    from PIL import Image, ImageDraw

    picture = Image.new("RGB", (width, BAR), GROUND)
    draw = ImageDraw.Draw(picture)
    for text, y, ink, size in ((title, 6, INK, 17), (note, 30, DIM, 14)):
        draw.text((10, y), _fitting(text, width - 16, size), fill=ink, font=_font(size))
    return np.asarray(picture)


@cache
def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size=size)


def _fitting(text: str, width: int, size: int) -> str:
    """The text, or as much of its beginning as there is room for."""
    if _font(size).getlength(text) <= width:
        return text
    while text and _font(size).getlength(f"{text}...") > width:
        text = text[:-1]
    return f"{text}..."
