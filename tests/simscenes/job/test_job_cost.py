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
from simscenes.job.accuracy import noise_limits
from simscenes.job.cost import Stopwatch, peak_bytes, predict_seconds, versions
from simscenes.job.views import LIMITS, RenderJob, render_views
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


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., RenderJob]:
    """A job of four views whose second one is there already; nothing is rendered."""
    monkeypatch.setattr(views, "using_variant", lambda *a: nullcontext())
    monkeypatch.setattr(views, "RenderedView", lambda method, rig, i: SimpleNamespace(i=i))
    monkeypatch.setattr(views, "predict_seconds", lambda *a: 300.0)
    done = {"spp": 8, "relativeError": 0.25, "fireflies": 2, LIMITS: [0.5] * 5}
    monkeypatch.setattr(views, "_rendered_before", lambda job, i, path: done if i == 1 else None)
    radiance, names = iter([40.0, 100.0, 70.0]), ["0000", "0001", "0002", "0003"]

    def rendered(job: RenderJob, view: Any, path: Path, tick: Callable[[float], None]) -> dict[str, Any]:
        assert path == job.out / "gt" / f"000{view.i}.exr"
        tick(0.5)
        for stage, seconds in (("radiance", next(radiance)), ("geometry", 10.0), ("write", 1e6)):
            job.watch.seconds[stage] = job.watch.seconds.get(stage, 0.0) + seconds
        return {"spp": 16 + view.i, "relativeError": 0.5 / (1 + view.i), "fireflies": view.i, LIMITS: [0.5] * 5}

    monkeypatch.setattr(views, "_render_view", rendered)
    method = SimpleNamespace(variant="scalar_rgb")
    config = {"spp": 16, "noise_target": None, "optics": {"motion": None}}
    plan = SimpleNamespace(bias=(0.3, 1.2, 0.0, 0.0, 0.0))

    def make(progress: Callable[[int, int, str], None]) -> RenderJob:
        rig = orbit_rig(4, 6, 4, 40, radius=3.0)
        return RenderJob(method, plan, None, "scalar", rig, tmp_path, names, config, "d", None, Stopwatch(), progress)  # type: ignore[arg-type]

    return make


def test_the_time_left_follows_the_views_that_are_done(job: Callable[..., RenderJob]) -> None:
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
        (
            4,
            4,
            "images; error at most 58.31% (noise 50.00%), 130.00% in the darkest quarter; 7 fireflies, see set.json",
        ),
    ]
    told = {name: (view["spp"], view["relative_error"], view["fireflies"]) for name, view in found.items()}
    assert told == {"0000": (16, 0.5, 0), "0001": (8, 0.25, 2), "0002": (18, 0.5 / 3, 2), "0003": (19, 0.125, 3)}
    assert found["0003"]["error"] == pytest.approx(np.hypot(0.5, 0.3))
    assert found["0003"]["noise_by_brightness"] == [0.5] * 4
    assert found["0003"]["error_by_brightness"] == pytest.approx([1.3, 0.5, 0.5, 0.5])


def test_a_view_that_stopped_far_before_its_siblings_is_rendered_again(
    job: Callable[..., RenderJob], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of 66,000 samples beside others of 173, one of which then needs more; a held-out one counts twice."""
    spent, asked = {0: 173, 1: 400, 2: 66000, 3: 16000}, list[tuple[int, int]]()

    def rendered(job: RenderJob, view: Any, path: Path, tick: Any, least: int = 0) -> dict[str, Any]:
        asked.append((view.i, least))
        spp = max(spent[view.i], least) if not least or view.i else 160000
        job.watch.seconds.update(radiance=1.0, geometry=1.0)
        return {"spp": spp, "relativeError": 0.05, "fireflies": 0, LIMITS: [0.05] * 5}

    monkeypatch.setattr(views, "_render_view", rendered)
    monkeypatch.setattr(views, "_rendered_before", lambda *a: None)
    said: list[str] = []
    one = job(lambda done, total, what: said.append(what))
    object.__setattr__(one, "truth_samples", 2.0)  # view 0 is held out
    object.__setattr__(one, "config", one.config | {"noise_target": 0.05})
    found, _ = render_views(one)
    assert asked[:4] == [(i, 0) for i in range(4)]
    assert asked[4:] == [(0, 8250), (1, 4125), (1, 5000)]  # 66,000 / 16; then 160,000 / 2 / 16
    assert [view["spp"] for view in found.values()] == [160000, 5000, 66000, 16000]
    assert "view 0000 again with 8250 samples per pixel at least: others needed 16 times more" in said
    asked.clear()
    spent.update({0: 2 * 400, 1: 400, 2: 400 * 16 + 15, 3: 400})  # a sixteenth, but for rounding
    render_views(one)
    assert len(asked) == 4
    object.__setattr__(one, "config", one.config | {"noise_target": None})
    spent[2], asked[:] = 66000, []
    render_views(one)
    assert len(asked) == 4


def test_nothing_is_predicted_where_nothing_is_missing(
    job: Callable[..., RenderJob], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And of the files in the folder only views of a larger set are removed."""
    monkeypatch.setattr(
        views, "_rendered_before", lambda *a: {"spp": 8, "relativeError": 0.25, "fireflies": 0, LIMITS: [0.5] * 5}
    )
    (tmp_path / "gt").mkdir()
    for name in ("0003.exr", "0004.exr", "notes.exr", "0004.txt"):
        (tmp_path / "gt" / name).write_bytes(b"")
    said: list[tuple[int, int, str]] = []
    assert render_views(job(lambda *what: said.append(what)))[1] == 0
    assert [what[:2] for what in said] == [(4, 4)]
    assert said[0][2].startswith("images; error at most ")
    assert sorted(path.name for path in (tmp_path / "gt").iterdir()) == ["0003.exr", "0004.txt", "notes.exr"]


def test_a_view_is_written_with_its_variance_and_without_negative_light(
    job: Callable[..., RenderJob], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.undo()
    monkeypatch.setattr(views, "using_variant", lambda *a: nullcontext())
    monkeypatch.setattr(views, "geometry_channels", lambda mi, surfaces, rig, i: {"Z": np.full((4, 6), i)})
    written: dict[str, Any] = {}
    monkeypatch.setattr(views, "write_exr", lambda path, channels, header: written.update(path=path, **header))
    kept: dict[int, dict[str, Any]] = {}
    mean, variance = np.arange(72.0).reshape(2, 4, 3, 3).reshape(4, 6, 3) - 10, np.arange(72.0).reshape(4, 6, 3)
    radiance = SimpleNamespace(mean=mean, variance=variance, half=mean / 3, spp=16, error=0.5, fireflies=3)
    asked: list[int] = []
    view = SimpleNamespace(i=2, render=lambda spp, target_error, tick, least: asked.append(least) or radiance)
    one = job(lambda *what: None)
    object.__setattr__(one, "store", SimpleNamespace(put=lambda i, channels: kept.update({i: channels})))
    header = views._render_view(one, view, tmp_path / "v.exr", lambda part: None, 7)  # type: ignore[arg-type]
    assert header.pop(LIMITS) == noise_limits(kept[2])  # of the pixels as they are written, none below zero
    assert written == {"path": tmp_path / "v.exr", **header}
    assert np.array_equal(header.pop("worldToCamera"), one.rig.viewmats[2].astype(np.float32))
    assert header == {
        "spp": 16, "relativeError": 0.5, "fireflies": 3, "novagsKey": one.key(2, 7), "leastSpp": 7
    }  # fmt: skip
    assert asked == [7]
    assert one.key(2, 7) != one.key(2) != one.key(1)
    assert list(kept) == [2]
    for k, c in enumerate("RGB"):
        assert np.array_equal(kept[2][c], np.where(mean[..., k] < 0, 0, mean[..., k]))
        assert np.array_equal(kept[2][f"var.{c}"], variance[..., k])
        assert np.array_equal(kept[2][f"half.{c}"], mean[..., k] / 3)
    assert (kept[2]["Z"] == 2).all()
    assert set(one.watch.seconds) == {"geometry", "radiance", "write"}
