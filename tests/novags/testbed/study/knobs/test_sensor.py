"""Claims about the knobs of the sensor model: their seeds, and settings that are exact."""

from typing import Any

import pytest

from novags.testbed.study.knobs import sensor as knobs
from novags.testbed.study.knobs.sensor import sensor
from sensor_model import expose

KNOBS = {knob.name: knob for knob in sensor(24).knobs}


def error(name: str, setting: object, seed: int) -> float:
    return float(KNOBS[name].measure(setting, seed, None).error)


@pytest.mark.parametrize(
    ("name", "exact"), [("light", "float64"), ("precision", "float64"), ("plan's tolerance", None)]
)
def test_what_an_error_is_measured_against_has_none_with_any_seed(name: str, exact: object) -> None:
    assert [error(name, exact, seed) for seed in (0, 5)] == [0, 0]


@pytest.mark.parametrize(
    ("name", "setting"), [("shot noise at 20 e-", "normal"), ("shot noise at 20 e-", "poisson"),
                          ("plan's tolerance", 0.2), ("demosaicing", "bilinear")],
)  # fmt: skip
def test_another_seed_measures_another_frame_and_the_same_seed_the_same(name: str, setting: object) -> None:
    first, again, other = (error(name, setting, seed) for seed in (3, 3, 4))
    assert first == again != other


def test_the_exact_frame_of_shot_noise_varies_with_the_seed_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: with one exact frame for all, the spread over the seeds is too small."""
    seen: dict[int, set[int]] = {3: set(), 4: set()}
    for seed, found in seen.items():

        def watched(*args: Any, seed: int, found: set[int] = found, **options: Any) -> Any:
            found.add(seed)
            return expose(*args, seed=seed, **options)

        monkeypatch.setattr(knobs, "expose", watched)
        error("shot noise at 20 e-", "normal", seed)
    assert [len(found) for found in seen.values()] == [2, 2]
    assert not seen[3] & seen[4]
