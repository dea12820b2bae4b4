"""Whether two scenes are the same: a hash of how they are written and of every number that resulted from it."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

import numpy as np

from sensor_model.files.door import read_bytes


def content_digest(description: dict[str, Any] | tuple[Path, ...], params: Any) -> str:
    """Hash a scene (sha256, 64 hex digits).

    The description counts because Mitsuba does not list everything as a parameter: the wrap mode of a texture, the type
    of a phase function; the parameters count because a description may name files elsewhere.

    Args:
        description: A scene dict, or the files that make up an XML scene, in order.
        params: The parameters that `mi.traverse` finds in the loaded scene.
    """
    digest = hashlib.sha256()
    if isinstance(description, dict):
        _feed(digest, description)
    else:
        for file in description:
            digest.update(f"{file.stat().st_size}:".encode() + read_bytes(file))
    # Mitsuba names an object without an id by its address, which differs from load to load.
    names = {key: re.sub(r"object_\d+", "object", key).encode() for key in params.keys()}
    for part in sorted(hashlib.sha256(name + b":" + _content(params[key])).digest() for key, name in names.items()):
        digest.update(part)
    return digest.hexdigest()


def _feed(digest: Any, node: Any) -> None:
    """In the order as written: it is the order of the lights, and so part of the noise."""
    if isinstance(node, (dict, list, tuple)):
        digest.update(f"{type(node).__name__}:{len(node)}:".encode())
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            digest.update(f"{key!r}:".encode())
            _feed(digest, value)
    else:
        digest.update(f"{_kind(node)}:".encode())
        digest.update(_content(node))


def _kind(value: Any) -> str:
    """The name of a value's class, the same whichever variants of Mitsuba the process loaded.

    `mi.ScalarTransform4f` calls itself `AffineTransform4f` where a scalar variant was the first, else
    `ScalarAffineTransform4f`; points, vectors and colours likewise.
    """
    kind = type(value)
    numbers = re.fullmatch(r"(?:Scalar)?(\w+\d[a-z])", kind.__name__) if kind.__module__ == "mitsuba" else None
    return f"Scalar{numbers[1]}" if numbers else kind.__name__


def _content(value: Any) -> bytes:
    """Numbers as their bytes; other objects, such as a mesh, by their printed description."""
    if "Transform" in type(value).__name__:
        value = value.matrix
    numbers = np.ascontiguousarray(np.array(value))
    if numbers.dtype.kind in "OU":  # the bytes of an object would be its address
        return str(value).encode()
    return f"{numbers.dtype}{numbers.shape}".encode() + numbers.tobytes()
