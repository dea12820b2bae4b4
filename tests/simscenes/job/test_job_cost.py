"""What a job costs: seconds per stage, the prediction from a few samples, and the time left that is told on the way."""

import sys
from contextlib import nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simscenes import Rig, orbit_rig
from simscenes.job import cost
from simscenes.job.cost import Stopwatch, peak_bytes, predict_seconds, versions
from simscenes.render import radiance
from simscenes.render.radiance import FirstSamples

RIG = orbit_rig(12, 6, 4, 40, radius=3.0)


class Clock:
    """Time that passes only when it is told to."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(cost, "time", SimpleNamespace(perf_counter=made))
    return made


def test_seconds_add_up_by_stage_also_over_failures_and_earlier_calls(clock: Clock) -> None:
    watch = Stopwatch()
    with watch.stage("load"):
        clock.now += 2
    with watch.stage("render"):
        clock.now += 3
    with suppress(KeyboardInterrupt), watch.stage("load"):
        clock.now += 5
        raise KeyboardInterrupt
    assert watch.seconds == {"load": 7, "render": 3}
    watch.earlier = {"render": 10, "plan": 1}
    assert watch.with_earlier() == {"render": 13, "plan": 1, "load": 7}


@pytest.mark.parametrize(("spp", "numbers"), [(64, [3, 5, 6, 8, 11]), (3000, list(range(12))), (2, [7])])
def test_even_samples_are_predicted_from_a_part_of_a_view(
    spp: int, numbers: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the first view that is missing, from a 64th of the job's samples."""
    found = []

    class Fresh:
        def __init__(self, method: Any, rig: Rig, i: int) -> None:
            assert (method, rig, i) == ("any", RIG, numbers[0])

        def seconds(self, spp: int, part: float) -> float:
            found.append((spp, part))
            return spp / 8

    monkeypatch.setattr(cost, "RenderedView", Fresh)
    predicted = predict_seconds("any", RIG, dict.fromkeys(numbers), spp, None)  # type: ignore[arg-type]
    assert predicted == pytest.approx(len(numbers) * spp / 8)
    assert found == [(spp, pytest.approx(len(numbers) / 64))]


def test_towards_a_target_error_three_pilots_say_how_many() -> None:
    """Of views 2, 3, 5, 8, 11 the first, the middle and the last; what they need per pixel, in seconds of their own."""

    def waiting(needed: dict[int, tuple[int, float]]) -> dict[int, Any]:
        return {
            i: SimpleNamespace(pilot=FirstSamples(0.2, each), predict_spp=lambda e, n=n: round(n / e))
            for i, (n, each) in needed.items()
        }

    views = waiting({2: (3, 0.5), 3: (999, 9), 5: (5, 0.25), 8: (999, 9), 11: (13, 2.0)})
    predicted = predict_seconds("any", RIG, views, None, 0.1)  # type: ignore[arg-type]
    assert predicted == pytest.approx((30 * 0.5 + 50 * 0.25 + 130 * 2.0) / 3 * 5)
    assert predict_seconds("any", RIG, waiting({4: (7, 0.5)}), None, 0.1) == pytest.approx(35)  # type: ignore[arg-type]


def test_an_error_out_of_reach_is_refused_with_the_nearest_that_is_not() -> None:
    """0.8 (25.6 / 0.05)^2 = 209,715 samples; 65,536 bring 25.6 down to 0.0894."""
    pilots = {0: FirstSamples(3.0, 0.5), 4: FirstSamples(25.6, 0.5)}
    views: Any = {i: SimpleNamespace(pilot=one, predict_spp=lambda e: 7) for i, one in pilots.items()}
    said = "error of 0.05 is out of reach: view 4 would take about 209,715 .* 104,858 s, .* 65,536; .* Ask for 0.09 or"
    with pytest.raises(ValueError, match=said):
        predict_seconds("any", RIG, views, None, 0.05)  # type: ignore[arg-type]
    assert predict_seconds("any", RIG, views, None, 0.09) == pytest.approx(7)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("variant", "part", "drawn", "quarter"),
    [("llvm", 0.1, 3 * 18, 18), ("llvm", 0.9, 24 * 18, 6 * 18), ("llvm", 8.0, 24 * 18, 6 * 18),
     ("scalar", 0.5, 24 * 9, 24 * 3), ("scalar", 0, 24, 24)],
)  # fmt: skip
@pytest.mark.parametrize("launch", [0.0, 5.0])
def test_a_part_of_a_view_is_timed_when_its_kernel_is_compiled_and_the_launch_apart_from_its_samples(
    variant: str, part: float, drawn: int, quarter: int, launch: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """60 s of compilation, then 1/8 s a sample: 24 pixels of 2 x 18 samples take 108 s, whichever part is traced, and
    one launch as all take. A part that has no smaller one takes its launch for the time of its samples.
    """
    clock = Clock()
    traced: list[int] = []
    monkeypatch.setattr(radiance, "time", SimpleNamespace(perf_counter=clock))
    monkeypatch.setattr(radiance.RenderedView, "sensors", [None])

    def draw(self: Any, more: Any) -> None:
        clock.now += (0 if traced else 60) + launch + 2 * more.sum() / 8
        traced.append(int(more.sum()))

    monkeypatch.setattr(radiance.RenderedView, "_draw", draw)
    view = radiance.RenderedView(SimpleNamespace(variant=variant, subframes=1), RIG, 0)  # type: ignore[arg-type]
    expected = 108 + launch * (18 if drawn == quarter else 1)
    assert view.seconds(36, part) == pytest.approx(expected)
    assert traced == [drawn, drawn, quarter]


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [((10.0, 4.0), 2 + 8 * 100), ((8.0, 2.0), 8 * 100), ((8.0, 1.0), 8 * 100), ((10.0, 12.0), 12.0), ((8.0, 8.0), 8.0)],
)
def test_what_a_launch_takes_lies_between_nothing_and_all_of_the_smaller_part(
    seconds: tuple[float, float], expected: float
) -> None:
    """Parts of 4 and 1 samples, a job of 400 of them in one launch, and a clock that may be wrong."""
    assert radiance.whole_seconds(seconds, [(1, 4), (1, 1)], (1, 400)) == pytest.approx(expected)


def test_every_launch_of_the_job_counts() -> None:
    assert radiance.whole_seconds([10.0, 4.0], [(1, 4), (1, 1)], (3, 400)) == pytest.approx(3 * 2 + 400 * 2)


def test_parts_of_many_launches_are_scaled_by_their_samples() -> None:
    assert radiance.whole_seconds([12.0, 3.0], [(8, 400), (2, 100)], (32, 1600)) == pytest.approx(48)


def test_a_pilot_is_timed_without_the_compilation_of_its_kernel_and_drawn_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """60 s of compilation, then 1/8 s a sample of a pixel: 24 pixels take 3 s for one sample in each."""
    clock, traced = Clock(), []
    monkeypatch.setattr(radiance, "time", SimpleNamespace(perf_counter=clock))
    monkeypatch.setattr(radiance, "compilation", lambda: nullcontext(lambda: 60.0))

    def draw(self: Any, more: Any) -> None:
        clock.now += 60 + 2 * more.sum() / 8
        self.samples.count += more
        traced.append(int(more.sum()))

    monkeypatch.setattr(radiance.RenderedView, "_draw", draw)
    view = radiance.RenderedView(SimpleNamespace(variant="llvm", subframes=1), RIG, 0)  # type: ignore[arg-type]
    assert view.pilot.seconds == pytest.approx(3)
    assert traced == [24 * radiance.PILOT_SPP // 2]


def test_versions_and_memory_are_those_of_this_process() -> None:
    assert versions()["numpy"] == np.__version__
    assert versions()["python"] == ".".join(map(str, sys.version_info[:3]))
    status = Path("/proc/self/status")
    if status.is_file():
        kib = next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        # A process may have inherited the peak of the one that started it: above its own, only the unit is checked.
        assert 0.98 * 1024 * kib <= peak_bytes() < 100 * 1024 * kib
