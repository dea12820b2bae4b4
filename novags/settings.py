"""Settings of nested configurations by dotted name: `fit.iterations`, `denoiser.network.widths`.

A configuration is a frozen dataclass whose fields are values or further configurations. Values may come as text, from
the command line or a file: `none`, `true`, `0.5`, `16,32,64`.

Neither msgspec 0.22 nor pydantic 2.14 makes values of such text: of 26 that were tried, 15 come out differently with
either, `none` and lists by commas as errors, `nan` and 1e300 as numbers. And neither knows dotted names, parts that are
switched on by naming a setting of theirs, or checks of the outcome alone, of which most of this file is.
"""

import dataclasses
import types
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from novags.numbers import KINDS, SETTING, check_range, number
from sensor_model.files.reading import brief

Config = TypeVar("Config")


def flattened(config: Any, prefix: str = "") -> dict[str, Any]:
    """Every value of a configuration by its dotted name; a part that is switched off is None."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), f"{prefix}{field.name}"
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            found |= flattened(value, f"{name}.")
        else:
            found[name] = value
    return found


def files_among(config: Any) -> dict[str, tuple[Path, ...]]:
    """The files that a configuration names, by dotted name."""
    listed = {name: value if isinstance(value, tuple) else (value,) for name, value in flattened(config).items()}
    return {name: value for name, value in listed.items() if value and all(isinstance(path, Path) for path in value)}


def refuse_lost_files(config: Any, what: str) -> None:
    """Refuse a configuration that names a file that is not there.

    Raises:
        ValueError: Of one line that begins with `what`.
    """
    refuse_lost(files_among(config), what)


def refuse_lost(files: Mapping[str, tuple[Path, ...]], what: str) -> None:
    """As `refuse_lost_files`, of files that `files_among` has found."""
    for name, paths in files.items():
        if lost := [path for path in paths if not path.is_file()]:
            raise ValueError(f"{what}: {name} is {lost[0]}, but that file does not exist: correct the path")


def starting_at(folder: Path, settings: Mapping[str, Any], config: Any) -> dict[str, Any]:
    """Settings with files by their whole path, as text; relative ones start at a folder.

    Args:
        folder: The folder of the file in which the settings stand.
        settings: By dotted name.
        config: The configuration that they make.
    """
    whole = {name: [str(folder / path) for path in paths]
             for name, paths in files_among(config).items() if name in settings}  # fmt: skip
    return {**settings, **{name: paths[0] if len(paths) == 1 else paths for name, paths in whole.items()}}


def has_setting(config: Any, name: str) -> bool:
    """Whether a configuration has a field of this dotted name, and no part above it is switched off."""
    head, _, rest = name.partition(".")
    if not dataclasses.is_dataclass(config) or head not in {f.name for f in dataclasses.fields(config)}:
        return False
    return not rest or has_setting(getattr(config, head), rest)


def changed(config: Config, settings: Mapping[str, Any], *, what: str = "setting") -> Config:
    """The configuration with some settings changed, all at once, so that the checks see the outcome alone.

    Args:
        config: A frozen dataclass.
        settings: Dotted name -> value, or text that stands for it. A configuration that is None is made with its
            defaults by naming one of its settings, or by "default".
        what: Named in errors.

    Raises:
        ValueError: If there is no such setting, a value has the wrong type, or the configuration refuses it.
    """
    own: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}
    for name, value in settings.items():
        head, _, rest = name.partition(".")
        if rest:
            nested.setdefault(head, {})[rest] = value
        else:
            own[head] = value
    values = {head: _own(config, head, value, what) for head, value in own.items()}
    for head, inner in nested.items():
        part = _part(config, head, values.get(head, getattr(config, head, None)), inner, what)
        values[head] = changed(part, inner, what=what)
    return dataclasses.replace(config, **values)  # type: ignore[type-var]  # a dataclass, as said above


def check_types(config: Any, settings: Mapping[str, Any], *, what: str = "setting") -> None:
    """Refuse settings that a configuration does not have, or of another type; whether it takes the values is not asked.

    Raises:
        ValueError: As `changed`, for these reasons alone.
    """
    for name, value in settings.items():
        head, _, rest = name.partition(".")
        if rest:
            part = _part(config, head, getattr(config, head, None), {rest: value}, what)
            check_types(part, {rest: value}, what=what)
        else:
            _own(config, head, value, what)


def _own(config: Any, head: str, value: Any, what: str) -> Any:
    """A value of the type of a field."""
    found = converted(value, _hint(config, head, what), f"{what} {head}")
    for part in found if isinstance(found, tuple) else (found,):
        if isinstance(part, int) and head != "seed":
            check_range(f"{what} {head}", part, -SETTING, SETTING)
    return found


def _part(config: Any, head: str, part: Any, inner: Mapping[str, Any], what: str) -> Any:
    """The configuration in a field, with its defaults where it is switched off."""
    hint = _hint(config, head, what)
    if part is None:
        part = _default(hint, f"{what} {head}")
    if not dataclasses.is_dataclass(part):
        raise ValueError(f"{what}: {head} is a single value and has no setting {next(iter(inner))!r}")
    return part


def _hint(config: Any, head: str, what: str) -> Any:
    """What a field is declared with."""
    known = [f.name for f in dataclasses.fields(config)]
    if head not in known:
        near = get_close_matches(head, known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"available: {', '.join(known)}"
        raise ValueError(f"{what}: {type(config).__name__} has no setting {head!r}; {hint}")
    return _hints(type(config))[head]  # type: ignore[arg-type]  # classes are hashable


def check_seed(seed: int) -> None:
    """Refuse a seed that generators of random numbers do not take, before anything is computed with it.

    Raises:
        ValueError: If it does not fit 64 bits without a sign.
    """
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed must be >= 0 and < 2**64, got {brief(seed, 60)}")


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)  # which takes a millisecond


def converted(value: Any, hint: Any, what: str) -> Any:
    """A value of the type that a field is declared with, from that type or from text.

    Raises:
        ValueError: If it cannot be one.
    """
    options = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    off = value is None or (isinstance(value, str) and value.lower() == "none")
    if off and type(None) in options:
        return None
    for option in options:
        if option is not type(None):
            try:
                return _as(value, option)
            except (ValueError, TypeError):
                continue
            except OverflowError as error:  # a number, and too large a one
                raise ValueError(f"{what} {error}") from error
    choices = [str(choice) for option in options if get_origin(option) is Literal for choice in get_args(option)]
    near = get_close_matches(str(value), choices, 1)
    raise ValueError(
        f"{what} must be {_words(options)}, got {brief(repr(value))}{f' (did you mean {near[0]}?)' if near else ''}"
    )


def _as(value: Any, kind: Any) -> Any:
    origin = get_origin(kind)
    if origin is Literal:
        return {str(choice): choice for choice in get_args(kind)}[str(value)] if _chosen(value, kind) else _no()
    if origin is tuple:
        parts = value.split(",") if isinstance(value, str) else list(value)
        return tuple(_as(part, get_args(kind)[0]) for part in parts)
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return kind() if value == "default" else value if isinstance(value, kind) else _no()
    if kind is bool:
        words = {"true": True, "yes": True, "false": False, "no": False}
        return value if isinstance(value, bool) else words[str(value).lower()] if str(value).lower() in words else _no()
    if kind in (int, float):
        return number(value, kind)
    if kind is str and isinstance(value, str):
        return value
    if kind is Path and isinstance(value, str | Path):
        return Path(value).expanduser()
    return value if kind is Any else _no()


def _chosen(value: Any, kind: Any) -> bool:
    return str(value) in {str(choice) for choice in get_args(kind)}


def _no() -> Any:
    raise ValueError


def _default(hint: Any, what: str) -> Any:
    options = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    made = [option for option in options if dataclasses.is_dataclass(option)]
    if not made:
        raise ValueError(f"{what} is a single value and has no settings of its own")
    return made[0]()  # type: ignore[operator]  # mypy takes is_dataclass for an instance


def _words(options: tuple[Any, ...]) -> str:
    names = {
        **KINDS,
        bool: "true or false",
        str: "text",
        Path: "a path",
        type(None): "none",
    }
    words = []
    for option in options:
        if get_origin(option) is Literal:
            words.append(f"one of {', '.join(map(str, get_args(option)))}")
        elif get_origin(option) is tuple:
            words.append("values separated by commas")
        else:
            words.append(names.get(option, "default, or settings of its own"))
    return " or ".join(dict.fromkeys(words))
