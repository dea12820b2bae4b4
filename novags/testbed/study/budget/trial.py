"""The experiment on a small scale, with a stopwatch: what each of its parts will take here at the preset's settings.

Pictures have their real size and fits their real number of Gaussians; views, samples and steps are few. What is done
once per view, sample or step is scaled up; the rest counts as it is.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from novags.methods import METHODS
from novags.testbed.console.terminal import Console, Update
from novags.testbed.folders.run import METRICS, RECORD
from novags.testbed.ledger.contents import read_json
from novags.testbed.study import place as experiment
from novags.testbed.study.cells.presets import Preset, adapted
from sensor_model.files.scratch import scratch
from simscenes.rigs import TEST_EVERY

VIEWS, STEPS, DENOISER_STEPS, SAMPLES = 4, 60, 10, 6
WARM = 5  # first steps of a part, in which machine code is loaded


class OutOfTime(Exception):
    """A trial took longer than it may."""


class Stopwatch(Console):
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
        spent: What the trial took.
    """

    before: dict[str, float]
    after: dict[str, float]
    spent: float

    @property
    def parts(self) -> dict[str, float]:
        """All together."""
        return {part: self.before.get(part, 0.0) + self.after.get(part, 0.0) for part in {**self.before, **self.after}}


def in_small(preset: Preset) -> Preset:
    """The preset with few views, samples and steps."""
    if preset.folder is not None:
        return adapted(preset, iterations=STEPS, denoiser_steps=DENOISER_STEPS)
    spp = min(SAMPLES, preset.render.spp or SAMPLES)
    views = min(VIEWS, preset.render.n_views)
    return adapted(preset, n_views=views, spp=spp, iterations=STEPS, denoiser_steps=DENOISER_STEPS)


def forecast(preset: Preset, limit: float) -> Forecast:
    """Try the experiment on a small scale.

    Args:
        preset: The experiment.
        limit: Seconds after which the trial gives up.

    Raises:
        OutOfTime: If it does.
        ValueError: If the experiment cannot be done.
    """
    small, start = in_small(preset), time.perf_counter()
    with scratch("budget") as folder:
        watch = Stopwatch(limit)
        experiment.run(small, folder / "trial", watch)
        spent = time.perf_counter() - start
        return scaled(preset, small, folder / "trial", watch.stamps, spent)


def scaled(
    preset: Preset, small: Preset, folder: Path, stamps: Mapping[str, Mapping[int, float]], spent: float
) -> Forecast:
    """What the small experiment in `folder` says of the large one."""
    ratio = 1.0 if preset.folder is not None else preset.render.n_views / small.render.n_views
    before, rest = {"fixed": 0.0}, spent
    if preset.folder is None:
        record = read_json(folder / "set" / "set.json")
        seconds = record["seconds"]
        samples = ratio * (preset.render.spp or 1) / (small.render.spp or 1)
        before["render"] = seconds.get("radiance", 0.0) * samples
        per_view = seconds.get("geometry", 0.0) + seconds.get("write", 0.0)
        before["fixed"] += sum(seconds.values()) - seconds.get("radiance", 0.0) + (ratio - 1) * per_view
        rest -= sum(seconds.values())
    photographed = read_json(folder / "capture" / "capture.json")["stage"]["seconds"]
    before["fixed"] += ratio * photographed
    rest -= photographed
    after = {"fixed": 0.0}
    for name in preset.methods:
        found = of_method(preset, small, name, folder / name, stamps, ratio)
        took = found.pop("took")
        rest -= took
        for part, value in found.items():
            after[part] = after.get(part, 0.0) + value
    after["fixed"] += max(rest, 0.0)  # the report and what lies between the stages
    return Forecast(before, after, spent)


def of_method(
    preset: Preset, small: Preset, name: str, folder: Path, stamps: Mapping[str, Mapping[int, float]], ratio: float
) -> dict[str, float]:
    """Seconds by part of one method with its score, and `took`: what it took on a small scale."""
    record, metrics = read_json(folder / RECORD), read_json(folder / METRICS)
    spent, scored = float(record["stage"]["seconds"]), float(metrics["stage"]["seconds"])
    found = {"took": spent + scored, "fixed": 0.0}
    method = METHODS[preset.reconstruct(name).variant.method]
    steps = stamps.get(f"reconstruct {name}", {})
    trained = 0.0
    if method.parts is not None:
        few, many = (method.parts(p.reconstruct(name).config) for p in (small, preset))
        begin = 0
        for part, count in few.items():
            pace = pace_of(steps, begin, begin + count)
            part_seconds = pace * count
            trained += part_seconds
            if many[part] == count:  # the variant decides this itself: no option changes it
                found["fixed"] += part_seconds
            else:
                found[part] = found.get(part, 0.0) + pace * many[part]
            begin += count
    views = stamps.get(f"render {name}", {})
    shown = pace_of(views, 0, max(views, default=0)) * max(views, default=0)
    each = shown + float(record["seconds"].get("enhance", 0.0)) if method.parts is not None else spent
    found["fixed"] += max(spent - trained, 0.0) + (ratio - 1) * each
    count = -(-preset.render.n_views // TEST_EVERY) if preset.folder is None else 1
    found["fixed"] += scored * count
    return found


def pace_of(stamps: Mapping[int, float], begin: int, end: int) -> float:
    """Seconds per step between two steps, without the first ones; 0 if no two of them are known."""
    steps = [step for step in sorted(stamps) if begin <= step <= end]
    warm = [step for step in steps if step >= begin + WARM]
    used = warm if len(warm) > 1 else steps
    if len(used) < 2:
        return 0.0
    return (stamps[used[-1]] - stamps[used[0]]) / (used[-1] - used[0])
