"""A digest of what a reader returned, by which two results are told to be the same."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

DEEPEST = 12


def digest(value: Any) -> str:
    """Of arrays, numbers, texts, records and objects of such. The order of keys and names of files do not count."""
    found = hashlib.sha256()
    _add(found, value, 0)
    return found.hexdigest()


def _add(found: Any, value: Any, depth: int) -> None:
    found.update(type(value).__name__.encode() if not isinstance(value, PurePath) else b"path")
    if isinstance(value, bytes):
        found.update(value)
    elif isinstance(value, (str, int, float, complex, type(None))):
        found.update(repr(value).encode("utf-8", "surrogatepass"))
    elif isinstance(value, PurePath):
        pass  # it may be resolved: a link inside the folder is read under another name
    elif (plain := _array(value)) is not None:
        found.update(f"{plain.dtype} {plain.shape}".encode() + np.ascontiguousarray(plain).tobytes())
    elif depth >= DEEPEST:
        return
    elif isinstance(value, Mapping):
        for key in sorted(value, key=repr):
            _add(found, str(key) if isinstance(key, PurePath) else key, depth + 1)
            _add(found, value[key], depth + 1)
    elif isinstance(value, (set, frozenset)):
        found.update(repr(sorted(value, key=repr)).encode())
    elif isinstance(value, (list, tuple)):
        for each in value:
            _add(found, each, depth + 1)
    elif not callable(value):
        for name, part in sorted(_parts(value).items()):
            found.update(name.encode())
            _add(found, part, depth + 1)


def _array(value: Any) -> np.ndarray[Any, Any] | None:
    if isinstance(value, (np.ndarray, np.generic)):
        return np.asarray(value) if np.asarray(value).dtype != object else None
    if type(value).__module__.startswith("torch") and hasattr(value, "detach"):
        return np.asarray(value.detach().cpu().numpy())
    return None


def _parts(value: Any) -> dict[str, Any]:
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return dict(getattr(value, "__dict__", {}))
