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


def test_of_many_views_a_few_are_looked_at_and_of_few_all() -> None:
    """Every view has a factor of its own: those that are looked at are seen in the mean."""

    def seen(count: int) -> float:
        files = {Path(f"{i}{suffix}"): np.full((16, 16, 3), value) for i in range(count)
                 for suffix, value in ((".dng", 1.0), (".png", float(i)))}  # fmt: skip
        darkroom: Any = SimpleNamespace(linear=lambda file, i: files[file])
        raws, pictures = (tuple(file for file in files if file.suffix == kind) for kind in (".dng", ".png"))
        dark: Any = SimpleNamespace(raws=raws, files=pictures, depth="8bit")
        return clean.tone_gain(dark, darkroom)

    few, many = 2, 4 * clean.LOOKED_AT
    assert seen(few) == pytest.approx(np.mean(range(few)))
    assert seen(many) == pytest.approx(np.mean(range(0, many, 4)))


@pytest.mark.parametrize(("shape", "side"), [((40, 64), None), ((3, 50), 3), ((50, 2), 2)])
def test_light_is_averaged_over_blocks_and_of_small_pictures_over_less(
    shape: tuple[int, int], side: int | None
) -> None:
    light = np.random.default_rng(0).random((*shape, 3))
    size = side or clean.BLOCK
    found = clean._blocks(light)
    rows, columns = shape[0] // size, shape[1] // size
    expected = light[: rows * size, : columns * size].reshape(rows, size, columns, size, 3).mean((1, 3, 4))
    np.testing.assert_allclose(np.sort(found.ravel()), np.sort(expected.ravel()))


@pytest.mark.parametrize("last", [0.25, 4.0])
def test_every_view_counts_in_the_factor_of_the_long_exposures(last: float, monkeypatch: pytest.MonkeyPatch) -> None:
    factors = (1.0, 2.0, last)
    light = np.random.default_rng(0).uniform(0.1, 0.5, (3, 4, 4, 3))
    files = {Path(f"{kind}{i}.png"): factor * light[i] for i in range(3)
             for kind, factor in (("long", 1.0), ("short", factors[i]))}  # fmt: skip
    monkeypatch.setattr(clean, "depth_of", lambda file: "16bit")
    darkroom: Any = SimpleNamespace(linear=lambda file, i: files[file])
    longs, shorts = (tuple(Path(f"{kind}{i}.png") for i in range(3)) for kind in ("long", "short"))
    source = SimpleNamespace(views=SimpleNamespace(names=("a", "b", "c")))
    dark: Any = SimpleNamespace(source=source, depth="16bit", raws=(), files=shorts)
    found = clean.match_clean(dark, longs, darkroom, lambda *given: None, 0, 1)
    energy = (light**2).sum((1, 2, 3))
    assert found.gain == pytest.approx((factors * energy).sum() / energy.sum())
