"""The views of a job: which are rendered, what is said on the way, and what of them is written."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simscenes import orbit_rig
from simscenes.job import views
from simscenes.job.accuracy import noise_limits
from simscenes.job.cost import Stopwatch
from simscenes.job.views import LIMITS, RenderJob, render_views


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
