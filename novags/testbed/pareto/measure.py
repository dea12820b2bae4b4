"""Measure a subject: every setting of every knob, seed after seed. What is measured already is kept."""

import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from novags.testbed.console.terminal import Console
from novags.testbed.ledger.dry import NOT_DONE
from novags.testbed.pareto.knob import Knob, Setting, Subject
from novags.testbed.pareto.samples import Samples
from novags.testbed.study.engines.progress import duration
from sensor_model.files.lock import dry
from sensor_model.files.reading import brief

Step = tuple[Knob, Setting, int]


def steps(subject: Subject, repeats: int, only: Sequence[str] = ()) -> list[Step]:
    """Every measurement once. Seeds come last: what else loads the machine meets all settings alike.

    Args:
        subject: Whose.
        repeats: Seeds.
        only: Names of the knobs that are wanted; none: all.

    Raises:
        ValueError: If the subject has no knob of that name.
    """
    names = [knob.name for knob in subject.knobs]
    if missing := [name for name in only if name not in names]:
        raise ValueError(f"{subject.name} has no knob {brief(repr(missing[0]), 100)}; its knobs: {', '.join(names)}")
    found: dict[tuple[str, Setting, int], Step] = {}
    for seed in range(repeats):
        for knob in subject.knobs:
            for setting in knob.settings if not only or knob.name in only else ():
                found.setdefault(knob.key(setting, seed), (knob, setting, seed))
    return list(found.values())


def measure(
    subject: Subject, folder: Path, repeats: int, console: Console, *, only: Sequence[str] = (), overwrite: bool = False
) -> Samples:
    """Measure what is missing.

    Args:
        subject: What.
        folder: Where `NAME.samples.json` is kept.
        repeats: Seeds, 0 to repeats - 1.
        console: Where progress goes.
        only: Names of the knobs to measure; none: all.
        overwrite: Drop measurements of another size, machine or version of the software.

    Returns:
        What is measured. In a dry run the missing measurements are counted for each knob, and none is made.

    Raises:
        ValueError: If `repeats` is below 1, a knob is unknown, or the folder holds measurements of another size,
            machine or version of the software.
    """
    if repeats < 1:
        raise ValueError(f"repeats must be >= 1, got {repeats}")
    todo = steps(subject, repeats, only)
    samples = Samples(folder / f"{subject.name}.samples.json", subject, overwrite=overwrite)
    if samples.dropped:
        console.note(f"pareto {subject.name}: measured again in {folder}: {samples.dropped}")
    missing = [step for step in todo if samples.find(*step) is None]
    if dry.get():
        _tell(subject, todo, missing, console)
        return samples
    if kept := len(todo) - len(missing):
        console.note(f"pareto {subject.name}: {kept} of {len(todo)} measurements are there already")
    with console.progress(f"pareto {subject.name}") as progress:
        for place, (knob, setting, seed) in enumerate(missing):
            left = time_left(samples, missing[place:])
            said = f"{knob.name} = {setting}, seed {seed}{left and ', '}{left}"
            progress(kept + place, len(todo), said)
            start = time.perf_counter()
            measured = knob.measure(setting, seed)
            samples.add(knob, setting, seed, measured, time.perf_counter() - start)
        progress(len(todo), len(todo), "done")
    return samples


def _tell(subject: Subject, todo: Sequence[Step], missing: Sequence[Step], console: Console) -> None:
    for knob in subject.knobs:
        count = sum(step[0] is knob for step in missing)
        kept = sum(step[0] is knob for step in todo) - count
        if count:
            console.note(f"pareto {subject.name}: {knob.name}: {count} measurements to be made, {kept} kept {NOT_DONE}")
        elif kept:
            console.note(f"pareto {subject.name}: {knob.name}: unchanged, kept {kept} measurements")


def time_left(samples: Samples, missing: Sequence[Step]) -> str:
    """What measurements took so far predicts the rest: those of the same setting first, then of the same knob."""
    rows = list(samples.spent())
    if not rows:
        return ""
    total = 0.0
    for knob, setting, seed in missing:
        name, value, _ = knob.key(setting, seed)
        same = [spent for other, at, spent in rows if other == name and at == value]
        near = [spent for other, _, spent in rows if other == knob.name]
        total += median(same or near or [spent for *_, spent in rows])
    return f"about {duration(total)} left"
