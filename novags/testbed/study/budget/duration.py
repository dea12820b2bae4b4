"""How people write a time."""

import re

from sensor_model.files.reading import brief

UNITS = {"": 1.0, "s": 1.0, "sec": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
LONGEST = 1e9  # s, thirty years
NUMBER = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*([a-z]*)")


def seconds_of(text: str) -> float:
    """The seconds that a time stands for: 120s, 120, 2min, 2.5m, 1h, 1h30min. A number without a unit stands alone.

    Raises:
        ValueError: If the text is not a time, or the time is not above 0.
    """
    rest, total = text.strip().lower(), 0.0
    parts = NUMBER.findall(rest)
    whole = "".join(NUMBER.sub("", rest).split())
    bare = len(parts) > 1 and any(not unit for _, unit in parts)  # 1h30: minutes for people, seconds for `UNITS`
    if whole or bare or not parts or any(unit not in UNITS for _, unit in parts):
        raise ValueError(f"a budget is a time like 120s, 2min or 1h30min, got {brief(repr(text), 60)}")
    for number, unit in parts:
        total += float(number) * UNITS[unit]
    if not 0 < total <= LONGEST:
        raise ValueError(f"a budget must be more than no time and at most {LONGEST:g}s, got {brief(repr(text), 60)}")
    return total
