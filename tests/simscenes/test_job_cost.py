"""What a job costs: seconds per stage, the prediction from a few samples, and the time left that is told on the way."""

import sys
from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simscenes import Rig, orbit_rig
from simscenes.job import cost, views
from simscenes.job.cost import Stopwatch, peak_bytes, predict_seconds, versions
from simscenes.job.views import QUARTERS, Job, render_views

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


@pytest.fixture
def made(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Views made for the prediction: the first pass compiles for 60 s, then a sample in every pixel takes 1/8 s."""
    found: list[Any] = []

    class Fresh:
        even = False

        def __init__(self, method: Any, rig: Rig, i: int) -> None:
            self.method, self.rig, self.i, self.passes = method, rig, i, []
            self.even = method == "scalar"
            found.append(self)

        def _pass(self, kind: str, count: int, size: int, each: float) -> None:
            clock.now += (0 if self.passes else 60) + count * size * each
            self.passes.append((kind, count * size))

        def run(self, passes: Any, count: int, size: int) -> None:
            self._pass("even", count, size, 1 / 8)

        def run_uneven(self, passes: Any, count: int, blocks: Any, size: int) -> None:
            assert blocks.shape == (self.rig.height, self.rig.width)
            self._pass("uneven", count, size * int(blocks.mean()), 1 / 4)

    monkeypatch.setattr(cost, "View", Fresh)
    return found


def waiting(numbers: list[int], needed: dict[int, int] | None = None) -> dict[int, Any]:
    """The views of the job, which know how many samples they need and must not be run."""
    return {i: SimpleNamespace(predict_spp=lambda error, i=i: round((needed or {})[i] / error)) for i in numbers}


@pytest.mark.parametrize(
    ("spp", "numbers", "size"),
    [
        (64, [3, 5, 6, 8, 11], 4),  # a 32nd of 320 samples, down to a power of four
        (256, [3, 5, 6, 8], 16),
        (1024, list(range(12)), 64),  # never more than 64
        (2, [7], 1),
    ],
)
def test_even_samples_are_predicted_from_a_second_pass(spp: int, numbers: list[int], size: int, made: list) -> None:
    predicted = predict_seconds("any", RIG, waiting(numbers), spp, None)  # type: ignore[arg-type]
    assert predicted == pytest.approx(spp * len(numbers) / 8)
    assert [(view.i, view.rig, view.passes) for view in made] == [(numbers[0], RIG, [("even", size)] * 2)]


@pytest.mark.parametrize(("method", "kind", "each"), [("wide", "uneven", 1 / 4), ("scalar", "even", 1 / 8)])
def test_towards_a_target_error_three_pilots_say_how_many(method: str, kind: str, each: float, made: list) -> None:
    """Of views 2, 3, 5, 8, 11 the first, the middle and the last; every pilot itself takes 2 x 16 samples."""
    pilots = {2: 3, 5: 5, 11: 13}
    predicted = predict_seconds(method, RIG, waiting([2, 3, 5, 8, 11], pilots), None, 0.1)  # type: ignore[arg-type]
    mean = ((30 + 32) + (50 + 32) + (130 + 32)) / 3
    assert predicted == pytest.approx(each * mean * 5)
    assert [(view.i, view.passes) for view in made] == [(2, [(kind, 16)] * 2)]
    alone = predict_seconds(method, RIG, waiting([4], {4: 7}), None, 0.1)  # type: ignore[arg-type]
    assert alone == pytest.approx(each * (70 + 32))


def test_versions_and_memory_are_those_of_this_process() -> None:
    assert versions()["numpy"] == np.__version__
    assert versions()["python"] == ".".join(map(str, sys.version_info[:3]))
    status = Path("/proc/self/status")
    if status.is_file():
        kib = next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        # A process may have inherited the peak of the one that started it: above its own, only the unit is checked.
        assert 0.98 * 1024 * kib <= peak_bytes() < 100 * 1024 * kib


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Job]:
    """A job of four views whose second one is there already; nothing is rendered."""
    for name in ("using_variant", "check_cameras"):
        monkeypatch.setattr(views, name, lambda *a: nullcontext())
    monkeypatch.setattr(views, "View", lambda method, rig, i: SimpleNamespace(i=i))
    monkeypatch.setattr(views, "predict_seconds", lambda *a: 300.0)
    done = {"spp": 8, "relativeError": 0.25, "fireflies": 2, QUARTERS: [0.5] * 4}
    monkeypatch.setattr(views, "_rendered_before", lambda job, i, path, key: done if i == 1 else None)
    radiance, names = iter([40.0, 100.0, 70.0]), ["0000", "0001", "0002", "0003"]

    def rendered(job: Job, view: Any, path: Path, key: str, tick: Callable[[float], None]) -> dict[str, Any]:
        assert path == job.out / "gt" / f"000{view.i}.exr"
        tick(0.5)
        for stage, seconds in (("radiance", next(radiance)), ("geometry", 10.0), ("write", 1e6)):
            job.watch.seconds[stage] = job.watch.seconds.get(stage, 0.0) + seconds
        return {"spp": 16 + view.i, "relativeError": 0.5 / (1 + view.i), "fireflies": view.i, QUARTERS: [0.5] * 4}

    monkeypatch.setattr(views, "_render_view", rendered)
    method = SimpleNamespace(variant="scalar_rgb")
    config = {"spp": 16, "noise_target": None, "optics": {"motion": None}}
    plan = SimpleNamespace(bias=(0.3, 1.2, 0.0, 0.0, 0.0))

    def make(progress: Callable[[int, int, str], None]) -> Job:
        rig = orbit_rig(4, 6, 4, 40, radius=3.0)
        return Job(method, plan, None, "scalar", rig, tmp_path, names, config, "d", None, Stopwatch(), progress)  # type: ignore[arg-type]

    return make


def test_the_time_left_follows_the_views_that_are_done(job: Callable[..., Job]) -> None:
    """300 s are predicted for three views; then one takes 40 + 10 s, and two take 140 + 20 s."""
    said: list[tuple[int, int, str]] = []
    found, predicted = render_views(job(lambda *what: said.append(what)))
    assert predicted == 300
    assert said == [
        (1, 4, "predicting the time"),
        (1, 4, "view 0000, 0%, about 300 s left"),
        (1, 4, "view 0000, 50%, about 250 s left"),
        (2, 4, "view 0002, 0%, about 100 s left"),
        (2, 4, "view 0002, 50%, about 75 s left"),
        (3, 4, "view 0003, 0%, about 80 s left"),
        (3, 4, "view 0003, 50%, about 40 s left"),
        (4, 4, "images; error 58.31% (noise 50.00%), 130.00% in the darkest quarter; 7 fireflies, see set.json"),
    ]
    told = {name: (view["spp"], view["relative_error"], view["fireflies"]) for name, view in found.items()}
    assert told == {"0000": (16, 0.5, 0), "0001": (8, 0.25, 2), "0002": (18, 0.5 / 3, 2), "0003": (19, 0.125, 3)}
    assert found["0003"]["error"] == pytest.approx(np.hypot(0.125, 0.3))
    assert found["0003"]["noise_by_brightness"] == [0.5] * 4
    assert found["0003"]["error_by_brightness"] == pytest.approx([1.3, 0.5, 0.5, 0.5])


def test_nothing_is_predicted_where_nothing_is_missing(
    job: Callable[..., Job], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And of the files in the folder only views of a larger set are removed."""
    monkeypatch.setattr(
        views, "_rendered_before", lambda *a: {"spp": 8, "relativeError": 0.25, "fireflies": 0, QUARTERS: [0.5] * 4}
    )
    (tmp_path / "gt").mkdir()
    for name in ("0003.exr", "0004.exr", "notes.exr", "0004.txt"):
        (tmp_path / "gt" / name).write_bytes(b"")
    said: list[tuple[int, int, str]] = []
    assert render_views(job(lambda *what: said.append(what)))[1] == 0
    assert [what[:2] for what in said] == [(4, 4)]
    assert said[0][2].startswith("images; error ")
    assert sorted(path.name for path in (tmp_path / "gt").iterdir()) == ["0003.exr", "0004.txt", "notes.exr"]


def test_a_view_is_written_with_its_variance_and_without_negative_light(
    job: Callable[..., Job], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.undo()
    monkeypatch.setattr(views, "using_variant", lambda *a: nullcontext())
    monkeypatch.setattr(views, "geometry_channels", lambda mi, surfaces, rig, i: {"Z": np.full((4, 6), i)})
    written: dict[str, Any] = {}
    monkeypatch.setattr(views, "write_exr", lambda path, channels, header: written.update(path=path, **header))
    kept: dict[int, dict[str, Any]] = {}
    mean, variance = np.arange(72.0).reshape(2, 4, 3, 3).reshape(4, 6, 3) - 10, np.arange(72.0).reshape(4, 6, 3)
    radiance = SimpleNamespace(mean=mean, variance=variance, spp=16, error=0.5, fireflies=3)
    view = SimpleNamespace(i=2, render=lambda spp, target_error, tick: radiance)
    one = job(lambda *what: None)
    object.__setattr__(one, "store", SimpleNamespace(put=lambda i, channels: kept.update({i: channels})))
    header = views._render_view(one, view, tmp_path / "v.exr", "the key", lambda part: None)  # type: ignore[arg-type]
    quarters = header.pop(QUARTERS)  # of the pixels as they are written, none below zero
    light, noise = np.maximum(mean, 0).mean(-1).ravel(), variance.mean(-1).ravel()
    for quarter, chosen in zip(quarters, np.array_split(np.argsort(light, kind="stable"), 4), strict=True):
        assert quarter == pytest.approx(np.sqrt(noise[chosen].mean()) / light[chosen].mean())
    assert written == {"path": tmp_path / "v.exr", **header}
    assert np.array_equal(header.pop("worldToCamera"), one.rig.viewmats[2].astype(np.float32))
    assert header == {"spp": 16, "relativeError": 0.5, "fireflies": 3, "novagsKey": "the key"}
    assert list(kept) == [2]
    for k, c in enumerate("RGB"):
        assert np.array_equal(kept[2][c], np.where(mean[..., k] < 0, 0, mean[..., k]))
        assert np.array_equal(kept[2][f"var.{c}"], variance[..., k])
    assert (kept[2]["Z"] == 2).all()
    assert set(one.watch.seconds) == {"geometry", "radiance", "write"}
