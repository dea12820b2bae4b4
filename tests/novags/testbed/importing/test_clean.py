"""Long exposures beside dark pictures: the one factor between their light."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed.importing import clean


def test_what_the_long_exposure_cuts_off_does_not_say_how_light_matches(monkeypatch: pytest.MonkeyPatch) -> None:
    long, short = Path("long.png"), Path("short.png")
    light = np.array([0.2, 0.5, 0.9, 3.0])[:, None, None] * np.ones((1, 4, 3))
    files = {long: np.minimum(light, 1.0), short: 0.1 * light}
    monkeypatch.setattr(clean, "depth_of", lambda file: "16bit")
    darkroom: Any = SimpleNamespace(linear=lambda file, i: files[file])
    source = SimpleNamespace(views=SimpleNamespace(names=("0000",)))
    dark: Any = SimpleNamespace(source=source, depth="16bit", raws=(), files=(short,))
    found = clean.match_clean(dark, [long], darkroom, lambda *given: None, 0, 1)
    assert found.gain == pytest.approx(0.1)
    assert found.white_share == 0.25
