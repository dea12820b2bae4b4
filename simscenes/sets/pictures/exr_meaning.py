"""EXR files of strangers: one whole picture of linear light in the colours of sRGB, or a refusal by name.

Source: OpenEXR's "Standard Attributes". Programs add attributes of their own, of cameras, dates and samples; what those
say of colours is found by the words in their names.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sensor_model.files.door import PICTURE, admitted
from sensor_model.files.reading import brief, some

SRGB = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # x, y of red, green, blue and white
ALIKE = 0.005  # of these: programs round them
# Names that mean linear light in the colours of sRGB, by the attributes of OpenEXR 3.4, OpenImageIO and Nuke.
LINEAR = {"lin_rec709_scene", "lin_rec709", "lin_srgb", "lin_srgb_scene", "linear", "scene_linear", "linear srgb",
          "data", "linear rec.709", "linear rec.709 (srgb)", "linear bt.709",
          "linear bt.709 i-d65", "utility - linear - srgb", "raw", "unknown", "none", "1", "1.0", ""}  # fmt: skip
SPEAK = ("colorspace", "colourspace", "colorinteropid", "gamma", "transfer", "primaries", "lookmodtransform",
         "renderingtransform")  # fmt: skip
DEEP = ("deepscanline", "deeptile")
OPAQUE = 0.999  # of alpha: float16 holds 1 exactly, and filters of renderers miss it by less


def refuse_foreign(path: Path) -> dict[str, Any]:
    """The header of a stranger's EXR file that is one whole picture.

    Raises:
        ValueError: If it is not: of several parts, deep, a panorama or stereo, a part of its picture, or with other
            colours than those of sRGB.
    """
    import OpenEXR

    try:
        with OpenEXR.File(admitted(path, most=PICTURE), header_only=True) as image:
            headers = [dict(part.header) for part in image.parts]
    except Exception as error:  # OpenEXR raises several types
        raise ValueError(f"{path} is not a readable EXR file ({brief(error)})") from error
    if len(headers) > 1:
        names = some([str(header.get("name", "")) for header in headers], 4)
        raise ValueError(f"{path} is an EXR file of {len(headers)} parts ({names}), of which only the first is read: "
                         "save each as a file of its own")  # fmt: skip
    header = headers[0]
    if problem := _window(header) or _kind(header) or _colours(header):
        raise ValueError(f"{path} {problem}")
    return header


def refuse_pixels(channels: dict[str, Any], path: Path) -> None:
    """Raise ValueError if R, G, B of a file are not light at every pixel: integers, fewer pixels, or transparent."""
    light = [channels[name] for name in "RGB"]
    if bad := [name for name, part in zip("RGB", light, strict=True) if part.dtype.kind != "f"]:
        raise ValueError(f"{path} must hold light as half or float numbers, got integers in {bad[0]}: write R, G and B "
                         "again")  # fmt: skip
    shapes = [channels[name].shape for name in "RGBA" if name in channels]
    if len(set(shapes)) > 1:
        raise ValueError(f"{path} must hold R, G, B and A at every pixel, got {shapes}: write them without subsampling")


def refuse_clear(channels: dict[str, Any], path: Path) -> None:
    """Raise ValueError if pixels are transparent: the light behind them is unknown, and colours count only a share."""
    alpha = channels.get("A")
    if alpha is not None and (count := int((alpha < OPAQUE).sum())):
        raise ValueError(f"{path} must be opaque, got {count} of {alpha.size} pixels with A below 1: its colours are "
                         "multiplied by A, and the light behind them is not known; render it before a background, and "
                         "save it without A")  # fmt: skip


def _window(header: dict[str, Any]) -> str:
    (low, high), whole = header["dataWindow"], header["displayWindow"]
    if np.array_equal((low, high), whole):
        return ""  # a part has another principal point than its camera
    return (f"holds a part of its picture, or more than it (data window {np.asarray(low).tolist()} to "
            f"{np.asarray(high).tolist()}, display window {np.asarray(whole[0]).tolist()} to "
            f"{np.asarray(whole[1]).tolist()}): save whole pictures")  # fmt: skip


def _kind(header: dict[str, Any]) -> str:
    kind = str(getattr(header.get("type"), "name", header.get("type", "")))
    if kind in DEEP:
        return f"is a deep EXR file ({kind}), of several surfaces a pixel, which is not read: flatten it"
    if "envmap" in header:
        return "is a panorama (envmap), not the picture of a camera: render views"
    if abs((ratio := float(header.get("pixelAspectRatio", 1))) - 1) > ALIKE:
        return (
            f"has pixels that are not square (pixelAspectRatio {ratio:g}), which are not read: save it with square ones"
        )
    if header.get("multiView"):
        views = some([str(v) for v in header["multiView"]], 4)
        return f"holds several views ({views}), of which only one is read: save each as a file of its own"
    return ""


def _colours(header: dict[str, Any]) -> str:
    stated = header.get("chromaticities")
    found = None if stated is None else np.ravel(np.asarray(stated, np.float64))
    if found is not None and (found.shape != (8,) or np.abs(found - SRGB).max() > ALIKE):
        return (f"states colours of other primaries than sRGB's (chromaticities {found.round(4).tolist()}), which are "
                "not read: convert it to linear sRGB (Rec. 709)")  # fmt: skip
    if header.get("acesImageContainerFlag") == 1:
        return "states the colours of ACES (acesImageContainerFlag), which are not read: convert it to linear sRGB"
    for name, value in header.items():
        bare = name.lower().replace("_", "").replace(" ", "").replace(".", "").replace(":", "").replace("/", "")
        if any(word in bare for word in SPEAK) and str(value).strip().lower() not in LINEAR:
            return (f"states {name} = {str(value)[:60]!r}, which may mean another curve or other colours than linear "
                    "sRGB and is not read: convert it to linear sRGB (Rec. 709)")  # fmt: skip
    return ""
