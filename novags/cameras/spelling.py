"""A choice with settings in one word of a command line: `name`, or `name:setting=value,setting=value`."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from typing import Any, get_type_hints

from novags.cameras.source import CameraSource
from novags.settings import converted
from sensor_model.files.reading import brief


def parse_settings(text: str, choices: Mapping[str, CameraSource], what: str) -> Any:
    """The configuration that `text` denotes.

    Args:
        text: A name of `choices`, and settings of its dataclass. A path must not hold a comma.
        choices: Sources by name, of whose configurations the fields have type bool, int, float, str, Path or Literal.
            Only the named source is looked at.
        what: The kind of thing chosen, for messages.

    Raises:
        ValueError: If the name or a setting is unknown, a setting is given twice, has no value or is missing, or a
            value does not fit.
    """
    name, rest = source_named(text), text.partition(":")[2]
    if name not in choices:
        raise ValueError(
            f"unknown {what} {brief(repr(name), 100)}{_meant(name, choices)}; available: {', '.join(choices)}"
        )
    config, found = choices[name].config, dict[str, Any]()
    kinds = get_type_hints(config)
    for part in filter(None, (part.strip() for part in rest.split(","))):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if key not in kinds:
            raise ValueError(
                f"{what} {name} has no setting {key!r}{_meant(key, kinds)}; it has {', '.join(kinds) or 'none'}"
            )
        if not equals or not value:
            raise ValueError(f"{what} {name}: write {key}=VALUE, got {part!r}")
        if key in found:
            raise ValueError(f"{what} {name}: {key} is given twice")
        found[key] = converted(value, kinds[key], f"{what} {name}: {key}")
    required = [f.name for f in fields(config) if f.default is MISSING and f.default_factory is MISSING]
    if missing := [key for key in required if key not in found]:
        raise ValueError(f"{what} {name} needs {missing[0]}: write {name}:{missing[0]}=VALUE")
    return config(**found)


def source_named(text: str) -> str:
    """The name in front of the settings."""
    return text.partition(":")[0].strip()


def spell_settings(config: Any, choices: Mapping[str, CameraSource]) -> str:
    """The shortest text that `parse_settings` turns into this configuration: defaults are left out."""
    name = next(name for name, source in choices.items() if type(config) is source.config)
    given = [f"{f.name}={getattr(config, f.name)}" for f in fields(config) if getattr(config, f.name) != f.default]
    return f"{name}:{','.join(given)}" if given else name


def _meant(word: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""
