"""Numbers that people write, in a command line or a file: values that are refused, whatever they stand for."""

import math
from typing import Any

from sensor_model.files.reading import brief
from sensor_model.files.records import WHOLE  # seeds need all of it

FLOAT = 3.4e38  # and others below this, the largest of 32 bits: pictures and scenes are computed in such
KINDS: dict[Any, str] = {int: "a whole number", float: "a number"}


# The largest count: far above any use, far below a count that exhausts a machine before it is looked at.
VIEWS, SIDE, PIXELS = 100_000, 65_536, 2**29  # pixels: of a picture, as many as one is read with
STEPS, SAMPLES, POINTS = 10**9, 2**24, 10**8
SETTING = 2**31  # of any other setting: kernels count in 32 bits
SSIM_WINDOW = 11  # px; smaller images have no SSIM


def number(value: Any, kind: Any) -> Any:
    """A number of a kind, `int` or `float`, of one of the other kind or of text.

    Raises:
        ValueError: If it is none, or loses its fraction.
        OverflowError: If it is not finite, or too large.
    """
    digits = isinstance(value, str) and value.strip().lstrip("+-").isdecimal()
    try:
        if isinstance(value, bool):
            raise ValueError
        found = kind(value)
        if not isinstance(value, str) and found != value == value:
            raise ValueError
        fits = abs(found) < (WHOLE if kind is int else FLOAT)
    except (ValueError, TypeError, OverflowError) as error:
        if not (digits or isinstance(error, OverflowError)):  # Python reads no whole number of 4300 digits
            raise ValueError(f"must be {KINDS[kind]}, got {shown(value)}") from None
        fits = False
    if not fits:
        rule = "a whole number below 2**64" if kind is int else f"a finite number below {FLOAT:g}"
        raise OverflowError(f"must be {rule}, got {shown(value)}")
    return found


def check_range(name: str, value: float, least: float, most: float, unit: str = "") -> None:
    """Refuse a number that is not in a range, ends included.

    Raises:
        ValueError: If it is not; names it.
    """
    if not least <= value <= most:
        rule = f"<= {most:.12g}" if value > most else f">= {least:g}"
        raise ValueError(f"{name} must be {rule}{unit}, got {shown(value)}")


def shown(value: Any) -> str:
    """A number, or what stands for one, for a message: digits of a long one are cut off."""
    if isinstance(value, int) and abs(value) >= 10**40:  # Python writes none of 4300 digits
        return f"one of about {math.log10(abs(value)):.0f} digits"
    text = brief(value, 60)
    return repr(text) if isinstance(value, str) else text
