"""The experiment on a small scale, with a stopwatch: the time that each of its parts will take here at the preset's
settings.

Pictures have their real size and fits their real number of Gaussians; views, samples and steps are few. Work done once
per view, sample or step is scaled up; the rest counts once. A trial ends when its time is over: a part that it did not
reach takes the time in the curves' tables, at the pace of the parts it reached.
"""

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.methods import METHODS
from novags.testbed.console.terminal import Console, Update
from novags.testbed.folders.run import METRICS, RECORD
from novags.testbed.ledger.contents import read_json
from novags.testbed.study.budget.known import subject
from novags.testbed.study.cells.presets import Preset, adapted
from sensor_model.files.scratch import scratch
from simscenes.rigs import TEST_EVERY

VIEWS, STEPS, DENOISER_STEPS, SAMPLES = 4, 60, 10, 6
WARM = 5  # first steps of a part, in which machine code is loaded
CAUTION = 1.5  # times the tables' seconds at this machine's pace, for untried parts
# Where nothing is known of this machine, a slow one: times the tables' processor seconds; s for work outside the
# tables, of each method and of the pictures (libraries, scores). Guesses.
SLOW, LOADING = 4.0, 15.0
Run = Callable[[Preset, Path, Console], Any]  # runs an experiment in a folder
Parts = dict[str, float]  # seconds by part
Stamps = Mapping[str, Mapping[int, float]]  # when each step of each stage was done


class OutOfTime(Exception):
    """A trial took longer than it may."""


class StepClock(Console):
    """A silent console that notes when each step of each stage was done; `limit`: seconds it may take in all."""

    def __init__(self, limit: float) -> None:
        super().__init__(quiet=True)
        self.limit, self.begun = limit, time.perf_counter()
        self.stamps: dict[str, dict[int, float]] = {}

    @contextmanager
    def progress(self, stage: str, parts: Mapping[str, int] | None = None) -> Iterator[Update]:
        """As `Console.progress`.

        Raises:
            OutOfTime: At the first step after the limit.
        """
        noted = self.stamps.setdefault(stage, {})

        def update(done: int, total: int, what: str) -> None:
            now = time.perf_counter()
            noted.setdefault(done, now)
            if now - self.begun > self.limit:
                raise OutOfTime

        yield update


@dataclass(frozen=True)
class Forecast:
    """Seconds of an experiment with the preset's own settings.

    Attributes:
        before: Of its parts until the pictures are taken.
        after: Of its parts from there on.
        spent: The time of the trial.
        untried: Methods that it did not come to the end of.
    """

    before: Parts
    after: Parts
    spent: float
    untried: tuple[str, ...] = ()

    @property
    def parts(self) -> Parts:
        """All together."""
        return {part: self.before.get(part, 0.0) + self.after.get(part, 0.0) for part in {**self.before, **self.after}}


def in_small(preset: Preset) -> Preset:
    """The preset with few views, samples and steps."""
    if preset.folder is not None:
        return adapted(preset, iterations=STEPS, denoiser_steps=DENOISER_STEPS)
    spp = min(SAMPLES, preset.render.spp or SAMPLES)
    views = min(VIEWS, preset.render.n_views)
    return adapted(preset, n_views=views, spp=spp, iterations=STEPS, denoiser_steps=DENOISER_STEPS)


def forecast(preset: Preset, limit: float, run: Run, tables: Sequence[Mapping[str, Any]]) -> Forecast:
    """Try the experiment on a small scale.

    Args:
        preset: The experiment.
        limit: Seconds after which the trial ends.
        run: The function that runs it.
        tables: Points of the curves of whole reconstructions.

    Raises:
        OutOfTime: If it ends before anything is known of this machine's pace.
        ValueError: If the experiment cannot be done.
    """
    small, start, watch = in_small(preset), time.perf_counter(), StepClock(limit)
    with scratch("budget") as folder:
        with suppress(OutOfTime):
            run(small, folder / "trial", watch)
        spent = time.perf_counter() - start
        return scaled(preset, small, folder / "trial", watch.stamps, spent, expected(preset, tables))


def expected(preset: Preset, tables: Sequence[Mapping[str, Any]]) -> dict[str, Parts]:
    """Processor seconds of the parts of each method, and of the "render", that the tables have for as much work."""
    found: dict[str, Parts] = {"render": {}}
    pixels = preset.render.width * preset.render.height
    for name in preset.methods:
        config, paces = preset.reconstruct(name), Parts()
        own = [point for point in tables if subject(point) == config.variant.method]
        for point in own or tables:
            work = point["workload"]
            try:
                width, height = map(int, str(work["size"]).split(" x "))
                growth = (pixels + config.points) / (width * height + work["points"])
                paces |= {part: growth * s / work[part] for part, s in point["parts"].items() if part in work}
                if "render" in point["parts"] and preset.folder is None:
                    rendered = work.get("rendered views", work["views"])  # held-out ones count for their samples
                    light = (preset.render.spp or 1) * preset.render.views_worth * pixels
                    per = point["parts"]["render"] / (work["samples per pixel"] * rendered * width * height)
                    found["render"] = {"render": per * light}
            except (KeyError, TypeError, ValueError, ZeroDivisionError):
                continue  # the workload of somebody else's curves
        counts = _steps(preset, name) if paces else {}
        usual = paces.get("fit", max(paces.values(), default=0.0))  # of a part that no curve has
        found[name] = {part: count * paces.get(part, usual) for part, count in counts.items()}
    return found


def together(parts: Mapping[str, Parts]) -> Parts:
    """The parts of all methods, and the render."""
    found = Parts()
    for own in parts.values():
        _add(found, own, ())
    return found


def at_worst(preset: Preset, tables: Sequence[Mapping[str, Any]], share: float = 1.0) -> tuple[float, Parts]:
    """Of a slow machine: seconds until a trial has seen its pace, and seconds of the experiment's parts.

    Args:
        preset: The experiment.
        tables: Points of the curves of whole reconstructions.
        share: Of a core, that is left for it: others work there too.
    """
    slow, loading = SLOW / share, LOADING / share
    small, first = expected(in_small(preset), tables), preset.methods[0]
    seen = sum(small["render"].values()) + sum(small[first].values())
    whole = {part: slow * seconds for part, seconds in together(expected(preset, tables)).items()}
    return slow * seen + 2 * loading, {**whole, "fixed": loading * (1 + len(preset.methods))}


def scaled(
    preset: Preset, small: Preset, folder: Path, stamps: Stamps, spent: float, tables: Mapping[str, Parts]
) -> Forecast:  # fmt: skip
    """The forecast of the small experiment in `folder`, finished or not, for the large one; `tables`: see
    `expected`.
    """
    if not (folder / "capture" / "capture.json").exists():
        raise OutOfTime
    ratio = 1.0 if preset.folder is not None else preset.render.n_views / small.render.n_views
    before, rest = _pictures(preset, small, folder, ratio)
    rest, after = spent - rest, {"fixed": 0.0}
    done = [name for name in preset.methods if (folder / name / METRICS).exists()]
    whole = {name: of_method(preset, small, name, folder / name, stamps, ratio) for name in done}
    for name, parts in whole.items():
        rest -= parts.pop("took")
        _add(after, parts, _closed(preset, small, name))
    if untried := tuple(name for name in preset.methods if name not in done):
        begun = {name: _begun(preset, small, name, stamps) for name in untried}
        known = [(parts, tables[name]) for name, parts in {**whole, **begun}.items()]
        pace = _pace(known) or _pace([(before, tables["render"])])
        if pace is None or any(_steps(preset, name) and not tables[name] for name in untried):
            raise OutOfTime
        fixed = max((parts["fixed"] for parts in whole.values()), default=rest)
        for name in untried:
            guessed = {part: CAUTION * pace * seconds for part, seconds in tables[name].items()}
            _add(after, {**guessed, **begun[name], "fixed": CAUTION * fixed}, _closed(preset, small, name))
    after["fixed"] += max(rest, 0.0)  # the report and the time between the stages
    return Forecast(before, after, spent, untried)


def _add(parts: Parts, more: Mapping[str, float], closed: Collection[str]) -> None:
    for part, seconds in more.items():
        name = "fixed" if part in closed else part
        parts[name] = parts.get(name, 0.0) + seconds


def _steps(preset: Preset, name: str) -> Mapping[str, int]:
    """Steps of each part of a method's training."""
    config = preset.reconstruct(name)
    method = METHODS[config.variant.method]
    return {} if method.parts is None else method.parts(config.config)


def _closed(preset: Preset, small: Preset, name: str) -> list[str]:
    """The parts whose steps the variant decides itself: no option changes them."""
    few = _steps(small, name)
    return [part for part, count in _steps(preset, name).items() if few[part] == count]


def _pace(known: Sequence[tuple[Parts, Parts]]) -> float | None:
    """Multiple of the tables' seconds, the slowest; None if no tried part is in them."""
    both = [[(parts[part], table[part]) for part in parts if table.get(part)] for parts, table in known]
    return max((sum(s for s, _ in pairs) / sum(t for _, t in pairs) for pairs in both if pairs), default=None)


def _pictures(preset: Preset, small: Preset, folder: Path, ratio: float) -> tuple[Parts, float]:
    """Seconds by part until the pictures are taken, and their seconds on a small scale."""
    before, took = {"fixed": 0.0}, 0.0
    if preset.folder is None:
        seconds = read_json(folder / "set" / "set.json")["seconds"]
        samples = preset.render.views_worth / small.render.views_worth
        samples *= (preset.render.spp or 1) / (small.render.spp or 1)
        before["render"] = seconds.get("radiance", 0.0) * samples
        per_view = seconds.get("geometry", 0.0) + seconds.get("write", 0.0)
        before["fixed"] += sum(seconds.values()) - seconds.get("radiance", 0.0) + (ratio - 1) * per_view
        took += sum(seconds.values())
    photographed = read_json(folder / "capture" / "capture.json")["stage"]["seconds"]
    before["fixed"] += ratio * photographed
    return before, took + photographed


def _begun(preset: Preset, small: Preset, name: str, stamps: Stamps) -> Parts:
    """Seconds of the parts of a method's training that were tried."""
    steps, many = stamps.get(f"reconstruct {name}", {}), _steps(preset, name)
    found, begin = Parts(), 0
    for part, count in _steps(small, name).items():
        if pace := pace_of(steps, begin, begin + count):
            found[part] = pace * many[part]
        begin += count
    return found


def of_method(preset: Preset, small: Preset, name: str, folder: Path, stamps: Stamps, ratio: float) -> Parts:
    """Seconds by part of one method with its score, and `took`: its seconds on a small scale."""
    record, metrics = read_json(folder / RECORD), read_json(folder / METRICS)
    spent, scored = float(record["stage"]["seconds"]), float(metrics["stage"]["seconds"])
    found, few, many = _begun(preset, small, name, stamps), _steps(small, name), _steps(preset, name)
    trained = sum(seconds * few[part] / many[part] for part, seconds in found.items())
    views = stamps.get(f"render {name}", {})
    shown = pace_of(views, 0, max(views, default=0)) * max(views, default=0)
    each = shown + float(record["seconds"].get("enhance", 0.0)) if many else spent
    count = -(-preset.render.n_views // TEST_EVERY) if preset.folder is None else 1
    fixed = max(spent - trained, 0.0) + (ratio - 1) * each + scored * count
    return {**found, "took": spent + scored, "fixed": fixed}


def pace_of(stamps: Mapping[int, float], begin: int, end: int) -> float:
    """Seconds per step between two steps, without the first ones; 0 if no two of them are known."""
    steps = [step for step in sorted(stamps) if begin <= step <= end]
    warm = [step for step in steps if step >= begin + WARM]
    used = warm if len(warm) > 1 else steps
    if len(used) < 2:
        return 0.0
    return (stamps[used[-1]] - stamps[used[0]]) / (used[-1] - used[0])
