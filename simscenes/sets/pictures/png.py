"""PNG files in and out, RGB [h,w,3]: integer codes (uint8, uint16) or float32 in 0..1."""

from pathlib import Path

import numpy as np

from sensor_model.files.atomic import atomic
from simscenes.sets.pictures.image_file import DEEP_COLOR, read_image


def read_png(path: Path) -> np.ndarray:
    """Read an RGB image as float32 [h,w,3] in 0..1 (code divided by the largest code).

    Raises:
        ValueError: If the file is missing, unreadable, or not 8 or 16 bits deep.
    """
    codes = read_codes(path)
    return codes.astype(np.float32) / np.float32(np.iinfo(codes.dtype).max)


def read_codes(path: Path) -> np.ndarray:
    """Read an RGB image as stored, uint8 or uint16 [h,w,3].

    Raises:
        ValueError: If the file is missing, unreadable, or of a different depth.
    """
    try:
        bgr = read_image(path, DEEP_COLOR)
    except ValueError as error:
        raise ValueError(f"{error}: run the stage that makes it again") from error
    if bgr.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path} must hold 8- or 16-bit codes, got {bgr.dtype}")
    return np.ascontiguousarray(bgr[..., ::-1])


def write_png(path: Path, image: np.ndarray) -> None:
    """Write [h,w,3] or, with alpha, [h,w,4]: integer codes unchanged, floats in 0..1 as 8-bit ones, clipped.

    Raises:
        OSError: If the file cannot be written.
    """
    if image.dtype.kind == "f":
        image = np.round(np.clip(image, 0.0, 1.0) * 255).astype(np.uint8)
    order = [2, 1, 0, *range(3, image.shape[2])]  # OpenCV's: blue, green, red, alpha
    write_codes(path, np.ascontiguousarray(image[..., order]))


def write_codes(path: Path, codes: np.ndarray) -> None:
    """Write codes [h,w] or [h,w,c], channels in OpenCV's order. Python writes the file: it says why it could not.

    Raises:
        OSError: If the file cannot be written.
    """
    import cv2

    encoded = cv2.imencode(".png", codes)[1]
    with atomic(path) as temporary:
        temporary.write_bytes(encoded.tobytes())
