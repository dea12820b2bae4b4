"""Fixtures of pytest. This file is imported with pytest itself: heavy modules are imported when a test asks for
them.
"""

from pathlib import Path
from typing import Any, Protocol

import pytest

from novags.testing.known import DarkCapture


class MakeDarkCapture(Protocol):
    """The function behind the fixture `dark_capture`."""

    def __call__(self, scene: str | None = None, electrons: float = 20.0, **settings: Any) -> DarkCapture:
        """See the fixture."""
        ...


@pytest.fixture(scope="session")
def novags_store(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder in which captures are kept from one session to the next: pytest's cache, or a temporary one without it.

    Override it to keep them elsewhere. `pytest --cache-clear` removes them.
    """
    cache = getattr(pytestconfig, "cache", None)
    return tmp_path_factory.mktemp("novags") if cache is None else Path(cache.mkdir("novags"))


@pytest.fixture(scope="session")
def dark_capture(novags_store: Path) -> MakeDarkCapture:
    """A function (scene, electrons, **settings) -> DarkCapture: a scene rendered, then photographed in the dark.

    Small by default: nine views of 48 x 48 px, two of them held out. Equal arguments give equal pictures; they are made
    once, and kept in `novags_store` until the code that makes them changes. `settings` are keys of a study file
    (`novags help studies`): views, width, height, spp, sensor, seed, max_size, **{"render.max_depth": 3}, ...
    `scene` is cornell if not given; it may also be a Mitsuba file or a folder of posed photographs. Of photographs
    without cameras, `photos` among the settings, a set is made first.
    """

    def make(scene: str | None = None, electrons: float = 20.0, **settings: Any) -> DarkCapture:
        from novags.testing.making import make_capture

        return make_capture(novags_store, scene, electrons, settings)

    return make
