"""Differences between a finished result and the present request, in a few words."""

import json
from collections.abc import Mapping
from typing import Any

from sensor_model.files.reading import brief

SHOWN = 4  # differences that one line can hold


def flat(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Every value of nested mappings by its dotted name."""
    found: dict[str, Any] = {}
    for name, value in config.items():
        found |= flat(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {f"{prefix}{name}": value}
    return found


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Each setting that differs between two configurations (JSON values), as "name was A, is B"."""
    a, b = flat(before), flat(now)
    return [
        f"{brief(name, 100)} was {_shown(a, name)}, is {_shown(b, name)}"
        for name in dict.fromkeys((*a, *b))
        if (name in a, a.get(name)) != (name in b, b.get(name))
    ]


def from_request(stage: Mapping[str, Any], config: Mapping[str, Any], inputs: Mapping[str, str]) -> list[str]:
    """How a finished result differs from the request.

    Args:
        stage: The entry "stage" of its record.
        config: The resolved configuration that is asked for.
        inputs: Content hash of each input that is known.
    """
    before = stage.get("inputs", {})
    others = [f"another {name}" for name, content in inputs.items() if before.get(name) != content]
    return [*differences(stage.get("config", {}), config), *others]


def listed(found: list[str]) -> str:
    """The first few of them, and how many more there are."""
    more = len(found) - SHOWN
    return ", ".join([*found[:SHOWN], *([f"{more} more"] if more > 0 else [])])


def _shown(config: Mapping[str, Any], name: str) -> str:
    if name not in config:
        return "absent"
    value = config[name]
    text = value if isinstance(value, str) else "none" if value is None else json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
