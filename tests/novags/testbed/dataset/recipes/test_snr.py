"""Claims about the signal-to-noise ratio of a capture."""

from dataclasses import replace
from math import log10
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed.dataset.recipes.recipe import Group
from novags.testbed.dataset.recipes.snr import dark_dn, snr_db
from novags.testbed.folders.capture import Capture


def test_it_is_the_power_of_the_signal_over_the_squared_error_of_the_raw_frames(mosaic: Group, chips: Group) -> None:
    """The noise that the frames have, drawn once, agrees within five standard errors."""
    for level in (*mosaic.levels, *chips.levels):
        capture = level.capture
        black = capture.levels[1]
        clean, variance = (np.stack([capture.truth(i, kind) for i in range(5)]).astype(float)
                           for kind in ("clean", "variance"))  # fmt: skip
        taken = np.stack([capture.raw(i) for i in range(5)])
        squares = (taken - clean) ** 2
        noise = np.sum((clean - black) ** 2) / 10 ** (level.snr_db / 10)
        # Of a normal number the square has twice its squared variance; a Poisson number adds its own.
        assert squares.sum() == pytest.approx(noise, abs=5 * np.sqrt(2.5 * np.sum(variance**2)))
        assert level.snr_db == pytest.approx(10 * log10(np.sum((clean - black) ** 2) / squares.sum()), abs=0.3)


def test_more_light_gives_more_and_a_dark_capture_is_below_zero(mosaic: Group) -> None:
    found = [level.snr_db for level in mosaic.levels]
    assert found == sorted(found)
    assert found[0] < 0 < found[1]


def known(**planes: float) -> Any:
    """A capture of one view of 4 x 4 px with equal pixels, whose camera has dark current."""
    sensor = SimpleNamespace(black_level=100, gain=2.0, dark_e=lambda exposure: 3.0)
    truth = {name: np.full((4, 4), value, np.float32) for name, value in planes.items()}
    plan = {
        "effects": [{"name": "dsnu", "on": False}, {"name": "dark_current", "on": True}, {"name": "prnu", "on": False}]
    }
    record = SimpleNamespace(exposure=None, simulated=SimpleNamespace(plan=plan))
    return SimpleNamespace(path=Path("capture"), names=("0",), sensor=sensor, record=record,
                           truth=lambda i, kind: truth[kind])  # fmt: skip


def test_dark_current_is_no_signal_and_a_fixed_pattern_is_noise() -> None:
    capture = known(clean=146.0, mean=149.0, variance=7.0)  # 40 of light, 6 of dark current; 3 off
    assert dark_dn(capture) == 106
    assert snr_db(capture) == pytest.approx(10 * log10(40**2 / (7 + 3**2)))
    effects = capture.record.simulated.plan["effects"]
    effects[1]["on"] = False
    assert dark_dn(capture) == 100
    for _ in effects:  # wherever it stands
        effects.append(effects.pop(0))
        assert dark_dn(capture) == 100
    capture.record.simulated.plan = None  # all is simulated
    assert dark_dn(capture) == 106


@pytest.mark.parametrize(("planes", "said"), [
    ({"clean": 106.0, "mean": 107.0, "variance": 7.0}, r"the signal must have power > 0 .*, got 0 DN\*\*2: the scene"),
    ({"clean": 146.0, "mean": 146.0, "variance": 0.0}, r"the noise must have power > 0 .*, got 0 DN\*\*2: all is sat"),
])  # fmt: skip
def test_a_ratio_without_a_value_is_refused(planes: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        snr_db(known(**planes))


def test_it_is_measured_once_for_a_capture(mosaic: Group, monkeypatch: pytest.MonkeyPatch) -> None:
    level = replace(mosaic.levels[0])
    first = level.snr_db
    monkeypatch.setattr(Capture, "truth", None)
    assert level.snr_db == first
