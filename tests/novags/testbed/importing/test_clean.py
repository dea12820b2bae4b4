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


def test_the_light_of_pictures_beside_raw_files_is_compared_in_the_brightest_parts_of_several_views() -> None:
    """Expectation: views count by their light; noise cut off at black, and so too bright, does not count."""
    rng = np.random.default_rng(0)
    files = dict[Path, np.ndarray]()
    for i, (factor, level) in enumerate(((2.0, 0.9), (2.0, 0.6), (3.0, 0.7))):
        light = rng.uniform(0.0, 0.1, (16, 160, 1)).repeat(3, -1)
        light[:, :16] = level
        files[Path(f"{i}.dng")], files[Path(f"{i}.png")] = light, np.where(light > 0.5, factor * light, 0.2)
    darkroom: Any = SimpleNamespace(linear=lambda file, i: files[file])
    raws, pictures = (tuple(file for file in files if file.suffix == kind) for kind in (".dng", ".png"))
    dark: Any = SimpleNamespace(raws=raws, files=pictures, depth="8bit")
    assert clean.tone_gain(dark, darkroom) == pytest.approx((2 * 0.9 + 2 * 0.6 + 3 * 0.7) / 2.2)
    assert clean.tone_gain(SimpleNamespace(raws=raws, files=raws, depth="raw"), darkroom) == 1  # type: ignore[arg-type]
