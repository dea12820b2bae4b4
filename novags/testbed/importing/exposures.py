"""Whether photographs were exposed alike, as their files state it, and whether they are dark."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from novags.testbed.console.terminal import Console
from novags.testbed.folders.photographs.raw_files import is_raw, read_exposure
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.pictures.exr_meaning import refuse_foreign
from simscenes.sets.pictures.image_file import header

ALIKE = 0.02  # relative: cameras round their numbers
UNEVEN = 4.0  # ratio of two exposures that none lies between: a camera that sets them by itself goes by small steps
DARK = 0.2  # sRGB-encoded, 0..1: photographs are dark if nine of ten pixels of the median one are below
LOOKED_AT = 9  # photographs, to know whether all are dark
STATED = ("exposure time", "s"), ("ISO speed", ""), ("f-number", "")
EXIF, TAGS = 0x8769, (0x829A, 0x8827, 0x829D)  # ExposureTime, ISOSpeedRatings (PhotographicSensitivity), FNumber
OF_EXR = "expTime", "isoSpeed", "aperture"  # OpenEXR's standard attributes
OF_VIEWS = "all views must be exposed alike. Import photographs that are, or give --time SECONDS, which counts for all"
OF_CLEAN = ("all clean exposures must be exposed alike, because one factor brings them to the light of the dark "
            "pictures: give some that are, or leave out --clean")  # fmt: skip
OF_FRAMES = ("dark and flat frames must be of the camera's one ISO, as gain and noise are: give such frames, or "
             "correct the name of their folder")  # fmt: skip
OF_CAMERA = ("gain and noise are of one ISO: give the camera at that of the pictures (a preset, or FILE.toml@ISO), or "
             "leave out --sensor")  # fmt: skip
LARGEST_ISO = 65535  # that EXIF holds: cameras state it for all above


def check_exposed_alike(files: Sequence[Path], rule: str = OF_VIEWS) -> None:
    """Refuse pictures that are not of one exposure: a method would take that for noise, or for another surface.

    Args:
        files: The pictures.
        rule: The rule they break, for the message.

    Raises:
        ValueError: If two of them state different exposure times, ISO speeds or f-numbers.
    """
    first: dict[str, tuple[float, Path]] = {}
    for file in files:
        for (what, unit), value in zip(STATED, stated_of(file), strict=True):
            if value is None:
                continue
            other, name = first.setdefault(what, (value, file))
            if abs(value - other) > ALIKE * other:
                raise ValueError(
                    f"{file.name} states the {what} {value:g} {unit}".rstrip() + f", {name.name} {other:g}: {rule}"
                )


def check_iso(files: Sequence[Path], rule: str, iso: float | None = None, of: str = "") -> float | None:
    """The ISO speed of pictures, None where neither a file nor anything else says it.

    Args:
        files: The pictures.
        rule: The rule they break, for the message.
        iso: The speed that they must have; None: the first file's.
        of: What has it, for the message.

    Raises:
        ValueError: If a file states another one.
    """
    for file in files:
        if (stated := stated_of(file)[1]) is None:
            continue
        iso, of = (stated, str(file)) if iso is None else (iso, of)
        if abs(stated - min(iso, LARGEST_ISO)) > ALIKE * iso:
            raise ValueError(f"{file} states the ISO speed {stated:g}, {of} {iso:g}: {rule}")
    return iso


def say_time(what: str, taken: float, time: float, console: Console) -> None:
    """A note where something of the dark was exposed for another time, in seconds, than the capture is for."""
    if abs(taken - time) > ALIKE * taken:
        console.note(f"{what} exposed for {taken:g} s, and the capture is for {time:g} s: dark current and hot pixels "
                     "are those of the frames")  # fmt: skip


def exposure_doubts(files: Sequence[Path]) -> list[str]:
    """A doubt where photographs in good light state exposures in groups that are `UNEVEN` times apart.

    A camera that sets them by itself, on a walk around one thing, goes up to 25 times the least, step by step.
    """
    stated = [(stated_of(file), file) for file in files]
    light = sorted((time * (iso or 1) / (aperture or 1) ** 2, file) for (time, iso, aperture), file in stated if time)
    alike = len({(iso is None, aperture is None) for (time, iso, aperture), _ in stated if time}) == 1
    steps = [(more / less, file, other) for (less, other), (more, file) in pairwise(light)]
    step, bright, dark = max(steps, default=(1.0, Path(), Path()))
    return [] if not alike or step <= UNEVEN else [
        f"photographs were exposed unevenly: by its exposure time, ISO speed and f-number {bright.name} got "
        f"{step:.3g} times the exposure of {dark.name}, and none lies between them, so that one surface has several "
        "brightnesses; take photographs with one exposure for all"
    ]  # fmt: skip


def are_dark(picture: Callable[[int], np.ndarray], count: int) -> bool:
    """Whether so many photographs are dark, by the 8-bit pictures of some of them."""
    some_of_them = np.linspace(0, count - 1, min(count, LOOKED_AT)).round().astype(int)
    levels = [np.quantile(picture(k).mean(-1), 0.9) for k in some_of_them]
    return bool(np.median(levels) < 255 * DARK)


def dark_doubts(views: MultiviewSet) -> list[str]:
    """A doubt where 8-bit photographs that shall be made dark are dark already."""
    file = views.files[0]
    linear = is_raw(file) or file.suffix.lower() == ".exr" or views.is_deep(0)
    return [] if linear or not are_dark(views.image, len(views)) else [
        f"pictures are dark already: nine of ten pixels of the median one are below code {255 * DARK:.0f}, and with "
        "their noise they count as the scene in good light here; take photographs from the dark to novags import"
    ]  # fmt: skip


def stated_of(file: Path) -> tuple[float | None, float | None, float | None]:
    """Exposure time in seconds, ISO speed and f-number, each None where the file does not say it."""
    if is_raw(file):
        return read_exposure(file)
    try:
        if file.suffix.lower() == ".exr":
            found = refuse_foreign(file)
            time, iso, aperture = (_number(found.get(name)) for name in OF_EXR)
            return time, iso, aperture
        with header(file) as image:
            exif = image.getexif().get_ifd(EXIF)
    except ValueError:  # PIL does not know all that OpenCV reads, 16-bit TIFFs for one
        return None, None, None
    time, iso, aperture = (_number(exif.get(tag)) for tag in TAGS)
    return time, iso, aperture


def _number(value: object) -> float | None:
    """The value of a tag, if it is a positive number: some cameras write 0/0, or a list, for unknown values."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if 0 < number < float("inf") else None
