"""A choice with settings in one word of a command line: `name`, or `name:setting=value,setting=value`."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints


def parse_settings(text: str, choices: Mapping[str, type[Any]], what: str) -> Any:
    """The configuration that `text` spells.

    Args:
        text: A name of `choices`, and settings of its dataclass. A path must not hold a comma.
        choices: Dataclasses by name, with fields of type bool, int, float, str, Path or Literal.
        what: What is chosen, for messages.

    Raises:
        ValueError: If the name or a setting is unknown, a setting is given twice or without value or is missing, or a
            value does not fit.
    """
    name, _, rest = text.partition(":")
    name = name.strip()
    if name not in choices:
        raise ValueError(f"unknown {what} {name!r}{_meant(name, choices)}; there are {', '.join(choices)}")
    config, found = choices[name], dict[str, Any]()
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
        found[key] = _value(value, kinds[key], f"{what} {name}: {key}")
    required = [f.name for f in fields(config) if f.default is MISSING and f.default_factory is MISSING]
    if missing := [key for key in required if key not in found]:
        raise ValueError(f"{what} {name} needs {missing[0]}: write {name}:{missing[0]}=VALUE")
    return config(**found)


def spell_settings(config: Any, choices: Mapping[str, type[Any]]) -> str:
    """The shortest text that `parse_settings` makes this configuration of: settings at their defaults are left out."""
    name = next(name for name, kind in choices.items() if type(config) is kind)
    given = [f"{f.name}={getattr(config, f.name)}" for f in fields(config) if getattr(config, f.name) != f.default]
    return f"{name}:{','.join(given)}" if given else name


def _meant(word: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def _value(text: str, kind: Any, where: str) -> Any:
    if get_origin(kind) is Literal:
        if text not in (known := get_args(kind)):
            raise ValueError(f"{where} must be one of {', '.join(known)}, got {text!r}{_meant(text, known)}")
        return text
    if kind is bool:
        if text.lower() not in ("true", "false"):
            raise ValueError(f"{where} must be true or false, got {text!r}")
        return text.lower() == "true"
    if kind is Path:
        return Path(text).expanduser()
    try:
        return kind(text)
    except ValueError:
        names = {int: "a whole number", float: "a number"}
        raise ValueError(f"{where} must be {names.get(kind, kind.__name__)}, got {text!r}") from None
