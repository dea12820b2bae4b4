"""A user's own camera as a TOML file: the fields of `Sensor`, with [optics], [defects], ... as tables.

A file of several ISOs has a table [iso.N] of the fields that differ at each, and is named with one: mine.toml@N.
"""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from difflib import get_close_matches
from math import inf, log
from pathlib import Path
from typing import Any

import numpy as np

from sensor_model.characterisation import GainFit
from sensor_model.files.atomic import atomic
from sensor_model.files.door import opened, read_bytes
from sensor_model.files.lock import dry
from sensor_model.files.reading import reading
from sensor_model.files.records import Numbers, check_shape
from sensor_model.files.toml_file import read_toml
from sensor_model.frame import own
from sensor_model.frame.measured import Measured, middle
from sensor_model.params import CFAS, Banding, Defects, DualGain, Sensor, SensorOptics, require

PARTS: dict[str, type] = {"banding": Banding, "defects": Defects, "optics": SensorOptics, "dual_gain": DualGain}
WHOLE = {"bits", "serial", "rts_traps"}
TRUTH = {"blooming"}
TEXT = {"cfa"}
TABLES = {"psf"}
LISTS = {"rgb_response", "rgb_bias", "falloff", "sensor_shape"}
EFFECTS = "effects"
SERIES = {"iso?": {"*": dict}, "maps?": str,
          "gain_fit?": [{"isos": Numbers(2), "slope": float, "start": float, "residual": float}]}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class CameraFile:
    """A camera's file, at one ISO."""

    sensor: Sensor
    iso: float | None = None  # None: the file is of one setting
    fit: GainFit | None = None  # of the ISOs at which the pixels have the same gain; None: not known
    maps: Path | None = None  # the file of its maps


def read_sensor(path: str | os.PathLike[str]) -> Sensor:
    """The camera of `read_camera`."""
    return read_camera(path).sensor


def split_iso(path: str | os.PathLike[str]) -> tuple[str, float | None]:
    """A camera's file, and the ISO behind @ if there is one."""
    found = re.fullmatch(r"(.+\.toml)@(\d{1,9})", os.fspath(path), re.DOTALL)
    return (found[1], float(found[2])) if found else (os.fspath(path), None)


def read_camera(path: str | os.PathLike[str]) -> CameraFile:
    """Read a camera.

    Args:
        path: TOML file; keys are the fields of `Sensor`. `cfa = "none"` is a sensor without colour filter array. With
            `preset`, the name of one of `PRESETS`, the file says in what the camera differs from it. `[effects.NAME]`
            holds the settings of an effect from outside. Of a file of several ISOs: FILE.toml@ISO. Between two ISOs
            that one line of [[gain_fit]] joins, the gain is the line's, and all else is interpolated over the
            logarithm.

    Raises:
        ValueError: for text that is not TOML, an unknown or missing key, a value of the wrong type or out of range; the
            message names the file and the key. The same for a file that cannot be read.
    """
    file, iso = split_iso(path)
    with reading(file, "correct it"):
        data = read_toml(file)
        check_shape(data, SERIES, "the camera")
        data = _over(_preset(data.pop("preset")), data) if "preset" in data else data
        tables = {_iso(name): table for name, table in data.pop("iso", {}).items()}
        fits = [GainFit(**{**of, "isos": tuple(of["isos"])}) for of in data.pop("gain_fit", [])]
        fit = next((of for of in fits if iso is not None and of.isos[0] <= iso <= of.isos[-1]), None)
        data = _over(data, _at(iso, tables, fit))
        maps = data.pop("maps", None)
        sensor = sensor_from_dict(data)
        own.check(sensor)
        return CameraFile(sensor=sensor, iso=iso, fit=fit, maps=None if maps is None else Path(file).parent / maps)


def _iso(name: str) -> float:
    require(name.isdecimal() and int(name) > 0, "a table of [iso]", "named by a whole number", name)
    return float(name)


def _at(iso: float | None, tables: Mapping[float, dict[str, Any]], fit: GainFit | None) -> dict[str, Any]:
    """The fields of a camera at this ISO."""
    isos = ", ".join(f"{known:g}" for known in sorted(tables))
    if iso is None:
        require(not tables, "the ISO of this camera", f"one of {isos}", None, "write FILE.toml@ISO")
        return {}
    require(bool(tables), "a camera without tables [iso.N]", "named without @", f"@{iso:g}")
    if iso in tables:
        return tables[iso]
    low = max((known for known in tables if known < iso), default=None)
    high = min((known for known in tables if known > iso), default=None)
    if fit is None or low is None or high is None:
        raise ValueError(f"ISO must be one of {isos}, or between two that one [[gain_fit]] joins, got {iso:g}: others "
                         "may be behind a switch of the gain; measure it, or take one of these")  # fmt: skip
    share = log(iso / low) / log(high / low)
    between = _between(tables[low], tables[high], share)
    return {**{key: value for key, value in between.items() if key != "maps"}, "gain": fit.gain(iso)}


def _between(low: Any, high: Any, share: float) -> Any:
    """A value between two of a camera file: the nearer one unless both are finite numbers; a count stays whole."""
    ends = (low, high)
    if all(isinstance(end, dict) for end in ends):
        both = {
            key: _between(low.get(key), high.get(key), round(share) if key in WHOLE else share) for key in low | high
        }
        return {key: value for key, value in both.items() if value is not None}
    if all(isinstance(end, list) for end in ends) and len(low) == len(high):
        return [_between(*pair, share) for pair in zip(*ends, strict=True)]
    if low != high and all(map(_is_number, ends)) and inf not in ends:
        return low + share * (high - low)
    return low if share < 0.5 else high


def _over(fields: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
    """The fields with others in their place, in tables too: what a table does not name stays."""
    both = {key for key, value in fields.items() if isinstance(value, dict) and isinstance(others.get(key), dict)}
    return {**fields, **others, **{key: _over(fields[key], others[key]) for key in both}}


def _preset(name: Any) -> dict[str, Any]:
    """The fields of a preset."""
    from sensor_model.presets import PRESETS

    near = get_close_matches(str(name), PRESETS, n=1)
    hint = f"did you mean {near[0]!r}?" if near else "see novags list sensors"
    require(isinstance(name, str) and name in PRESETS, "preset", "the name of a camera", name, hint)
    return asdict(PRESETS[name])


def sensor_from_dict(data: Mapping[str, Any]) -> Sensor:
    """A camera from plain values: from a TOML file, or `dataclasses.asdict` of a camera after a trip through JSON.

    Raises:
        ValueError: As `read_sensor`, without the file's name.
    """
    return Sensor(**_values(Sensor, _present(data)))


def _present(data: Mapping[str, Any]) -> dict[str, Any]:
    """Without nulls, which mean the default, except for the colour filter array, whose default is another."""
    named = {key: "none" if key in TEXT and value is None else value for key, value in data.items()}
    return {key: _present(v) if isinstance(v, dict) else v for key, v in named.items() if v is not None}


def write_sensor(
    path: str | os.PathLike[str],
    sensor: Sensor | Mapping[int, Sensor],
    *,
    comment: str = "",
    overwrite: bool = True,
    fits: Sequence[GainFit] = (),
    maps: Mapping[int, str] | str | None = None,
) -> None:
    """Write a camera that `read_sensor` reads back exactly; the file appears whole or not at all, and in a dry run not.

    Args:
        path: The file.
        sensor: One camera, or one at each of several ISOs.
        comment: For its head.
        overwrite: Replace a file of other content.
        fits: The gain of the ISOs.
        maps: Names of files beside it, as `sensor`.

    Raises:
        ValueError: If the file is there with another content, unless `overwrite`.
    """
    series = sensor if isinstance(sensor, Mapping) else {}
    first = next(iter(series.values())) if isinstance(sensor, Mapping) else sensor
    shared = [line for line in _assignments(first) if all(line in _assignments(other) for other in series.values())]
    lines = [*(f"# {line}" for line in comment.splitlines()), *shared]
    lines += [f"maps = {_literal(maps)}"] if isinstance(maps, str) else []
    for name, settings in first.effects.items():
        lines += ["", f'[{EFFECTS}."{name}"]', *(f"{key} = {_literal(value)}" for key, value in settings.items())]
    for fit in fits:
        lines += ["", "[[gain_fit]]  # gain = slope ISO + start; residual: largest relative miss",
                  *(f"{key} = {_literal(value)}" for key, value in asdict(fit).items())]  # fmt: skip
    lines += [] if series else _parts(first, "")
    for iso, one in series.items():
        lines += ["", f"[iso.{iso}]", *(line for line in _assignments(one) if line not in shared)]
        lines += [f"maps = {_literal(maps[iso])}"] if isinstance(maps, Mapping) and iso in maps else []
        lines += _parts(one, f"iso.{iso}.")
    _write(Path(path), "\n".join([*lines, ""]).encode(), overwrite)


def _write(path: Path, content: bytes, overwrite: bool) -> None:
    if not overwrite and path.exists() and read_bytes(path) != content:
        raise ValueError(
            f"{path} is there with another content: choose another --out, or add --overwrite to replace it"
        )
    if not dry.get():
        with atomic(path) as temporary:
            temporary.write_bytes(content)


def read_maps(path: Path, size: tuple[int, int]) -> Measured:
    """The middle of the maps of a camera, for frames of this size.

    Raises:
        ValueError: If they are not whole, or smaller than that.
    """
    with reading(path, "measure the camera again"), opened(path) as file:
        with np.load(file, allow_pickle=False) as found:
            maps = [np.asarray(found[name], np.float32) for name in ("offset", "response")]
            time = float(found["time"]) if "time" in found else None
        for array in maps:
            fits = array.ndim == 2 and array.shape == maps[0].shape and bool(np.isfinite(array).all())
            require(fits, "maps", "finite and [h, w], both alike", array.shape)
            reaches = array.shape[0] >= size[0] and array.shape[1] >= size[1]
            require(reaches, "maps", f"of {size[0]} rows and {size[1]} columns or more", array.shape,
                    "measure the camera with a larger --window, or take smaller pictures")  # fmt: skip
        offset, response = (middle(array, size) for array in maps)
        return Measured(offset=offset, response=response, time=time)


def write_maps(path: Path, maps: Measured, *, overwrite: bool = True) -> None:
    """Write what `read_maps` reads, as `write_sensor` does."""
    assert maps.offset is not None
    assert maps.response is not None
    content = io.BytesIO()
    time: dict[str, Any] = {} if maps.time is None else {"time": maps.time}
    np.savez_compressed(content, offset=maps.offset, response=maps.response, **time)
    _write(path, content.getvalue(), overwrite)


def _parts(sensor: Sensor, prefix: str) -> list[str]:
    tables = [(part, getattr(sensor, part)) for part in PARTS if getattr(sensor, part) is not None]
    return [line for part, value in tables for line in ("", f"[{prefix}{part}]", *_assignments(value))]


def _values(kind: type, data: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    known = {field.name: field for field in fields(kind)}
    for key in sorted(data.keys() - known.keys(), key=str):
        near = get_close_matches(key, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
        require(False, "key", "a camera parameter", prefix + key, hint)
    missing = [name for name, f in known.items() if f.default is f.default_factory and name not in data]
    require(not missing, "camera", f"complete: {', '.join(prefix + m for m in missing)} missing", sorted(data))
    return {key: _value(key, value, prefix) for key, value in data.items()}


def _value(key: str, value: Any, prefix: str) -> Any:
    if key in PARTS and not prefix:
        require(isinstance(value, dict), key, "a table", value)
        return PARTS[key](**_values(PARTS[key], value, f"{key}."))
    if key == EFFECTS:
        return _effects(value)
    if key in LISTS:
        require(
            isinstance(value, (list, tuple)) and all(map(_is_number, value)), prefix + key, "a list of numbers", value
        )
        return tuple(value)
    if key in TABLES:
        ok = isinstance(value, (list, tuple)) and all(
            isinstance(r, (list, tuple)) and all(map(_is_number, r)) for r in value
        )
        require(ok, prefix + key, "a list of lists of numbers", value)
        return tuple(tuple(row) for row in value)
    if key in TRUTH:
        require(isinstance(value, bool), prefix + key, "true or false", value)
        return value
    if key in TEXT:
        require(
            value == "none" or value in CFAS, prefix + key, f"one of {', '.join(map(repr, ('none', *CFAS)))}", value
        )
        return None if value == "none" else value
    if value == "inf":  # JSON has no infinity
        return inf
    whole = key in WHOLE
    ok = _is_number(value) and (isinstance(value, int) or not whole)
    require(ok, prefix + key, "a whole number" if whole else "a number", value)
    return value if whole else float(value)


def _effects(tables: Any) -> dict[str, dict[str, Any]]:
    """The settings of each effect from outside, which checks them itself."""
    require(isinstance(tables, dict), EFFECTS, "a table", tables)
    for name, settings in tables.items():
        require(isinstance(settings, dict), f"{EFFECTS}.{name}", "a table", settings)
        for key, value in settings.items():
            ok = isinstance(value, (bool, str)) or _is_number(value)
            require(ok, f"{EFFECTS}.{name}.{key}", "a number, text, true or false", value)
    return {name: dict(settings) for name, settings in tables.items()}


def _is_number(value: Any) -> bool:
    # A whole number of TOML or JSON can have any length; beyond float64 it is as good as infinite.
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and (isinstance(value, float) or abs(value) < 10**300)


def _assignments(owner: Any) -> list[str]:
    values = {f.name: getattr(owner, f.name) for f in fields(owner) if f.name not in (*PARTS, EFFECTS)}
    # TOML has no null: fields that are None are left out, except for the colour filter array, whose default is not None
    return [f"{name} = {_literal(value)}" for name, value in values.items() if value is not None or name in TEXT]


def _literal(value: Any) -> str:
    if isinstance(value, np.generic):  # its repr, np.float64(1.5), is not TOML
        value = value.item()
    if value is None:
        return '"none"'
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_literal, value))}]"
    # JSON's text is TOML's too; repr of a float reads back exactly, and inf is TOML
    return json.dumps(value) if isinstance(value, str) else repr(value)
