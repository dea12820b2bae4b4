"""Machine code of kernels, kept in this user's cache between runs and found by every copy of the same sources.

Numba's own cache lies beside each source and goes by its time and place: a second clone, a reinstall or a changed
comment compile everything anew, and a change of a file that a kernel takes its constants from is not noticed. Here the
name of the folder says what the kernels are compiled from. Importing this module does not import numba.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from sensor_model.files.own import cache_folder, own_folder

KEEP_DAYS = 30


def digest_of(sources: Iterable[Path]) -> str:
    """Of what Python files do: comments, docstrings, places and names of files do not count."""
    digest = hashlib.sha256(sys.version.encode())
    for path in sources:
        digest.update(_statements(path.read_bytes()))
    return digest.hexdigest()[:16]


def _statements(source: bytes) -> bytes:
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module) and ast.get_docstring(node, clean=False):
            node.body = node.body[1:]
    return ast.dump(tree).encode()


def folder_for(sources: Iterable[Path]) -> Path | None:
    """The folder of the kernels that are compiled from these sources; one of other sources goes after KEEP_DAYS unused.

    In NUMBA_CACHE_DIR if that is set. None if no folder can be this user's alone: code that is found there is run.
    """
    from numba import config

    name = f"kernels-{digest_of(sources)}"
    folder = Path(config.CACHE_DIR, name) if config.CACHE_DIR else cache_folder(name)
    with suppress(OSError):
        own_folder(folder)
        _keep(folder)
        return folder
    return None


def _keep(folder: Path) -> None:
    """Mark a folder as used, and remove folders of other sources that have long been unused."""
    with suppress(OSError):  # root's
        os.utime(folder)
    for other in folder.parent.glob(f"kernels-{'[0-9a-f]' * 16}"):
        with suppress(OSError):  # somebody else's, or another process was faster
            if other != folder and other.lstat().st_mtime < time.time() - KEEP_DAYS * 86400:
                shutil.rmtree(other)


def compiled(function: Callable[..., Any], folder: Path | None, **options: Any) -> Any:
    """`numba.njit(**options)`, whose machine code is kept in the folder; None keeps nothing."""
    from numba import njit

    dispatcher = njit(**options)(function)
    if folder is not None:
        # not public in numba: a release that arranges its cache otherwise compiles in every process, and runs
        with suppress(ImportError, AttributeError, TypeError):
            dispatcher._cache = _cache_in(folder)(function)
    return dispatcher


@cache
def _cache_in(folder: Path) -> Any:
    """The class of caches of functions in a folder."""
    from numba.core import caching

    class Place(caching._CacheLocator):
        """One folder for all sources."""

        def __init__(self, function: Callable[..., Any]) -> None:
            self.function = function

        @classmethod
        def from_function(cls, function: Callable[..., Any], _: str) -> Place:
            """The place of any function."""
            return cls(function)

        def get_cache_path(self) -> str:
            """The folder."""
            return str(folder)

        def get_source_stamp(self) -> str:
            """Of the function's own source, which need not be one of the folder's."""
            return _own(Path(inspect.getfile(self.function)))

        def get_disambiguator(self) -> str:
            """The module: a line number would change with a comment above."""
            return str(self.function.__module__)

    class Code(caching.CompileResultCacheImpl):
        """What is kept of a function."""

        _locator_classes = [Place]

    class Cache(caching.FunctionCache):
        """The code of one function."""

        _impl_class = Code

    return Cache


@cache
def _own(source: Path) -> str:
    return digest_of([source])
