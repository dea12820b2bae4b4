"""Whether photographs were exposed alike, as their files state it."""

from collections.abc import Sequence
from pathlib import Path

from novags.testbed.folders.photographs.raw_files import is_raw, read_exposure
from simscenes.sets.pictures.image_file import header

ALIKE = 0.02  # relative: cameras round their numbers
STATED = ("exposure time", "s"), ("ISO speed", ""), ("f-number", "")
EXIF, TAGS = 0x8769, (0x829A, 0x8827, 0x829D)  # ExposureTime, ISOSpeedRatings (PhotographicSensitivity), FNumber
OF_VIEWS = "all views must be exposed alike. Import photographs that are, or give --time SECONDS, which counts for all"
OF_CLEAN = ("all clean exposures must be exposed alike, because one factor brings them to the light of the dark "
            "pictures: give some that are, or leave out --clean")  # fmt: skip


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


def stated_of(file: Path) -> tuple[float | None, float | None, float | None]:
    """Exposure time in seconds, ISO speed and f-number, each None where the file does not say it."""
    if is_raw(file):
        return read_exposure(file)
    try:
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
