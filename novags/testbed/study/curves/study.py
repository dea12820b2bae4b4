"""The studies behind curves: the file of each subject that ships, and its missing measurements."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from novags.testbed.console.terminal import Console
from novags.testbed.ledger.dry import NOT_DONE
from novags.testbed.study.conduct import there
from novags.testbed.study.curves.measuring import measurements_of
from novags.testbed.study.knobs.subjects import PARTS, chosen
from novags.testbed.study.plan import StudyPlan, plan_of
from sensor_model.files.toml_file import read_toml

STUDIES = Path(__file__).parent / "studies"


def plans(
    what: str, store: Path, console: Console, *, knobs: Sequence[str] = (), quick: bool = False,
    repeats: int | None = None,
) -> list[StudyPlan]:  # fmt: skip
    """Measurements to make, and finished ones.

    Args:
        what: A subject, "all", or a study file of one's own.
        store: The store.
        console: Where notes go.
        knobs: Those to measure; none: all. Stored measurements of others are kept.
        quick: With small sizes.
        repeats: Seeds, 0 to repeats - 1; None: the file's. Stored measurements of further ones are kept.

    Raises:
        ValueError: If there is no such subject or knob.
    """
    seeds = None if repeats is None else range(repeats)
    if what.endswith(".toml"):
        asked = [plan_of(measurements_of(Path(what), read_toml(Path(what)), quick=quick, seeds=seeds), store, console)]
    else:
        asked = [_with_kept(name, quick, seeds, store, console) for name in chosen(what)]
    return [plan.only(knobs, there(plan, store)) for plan in asked]


def _with_kept(name: str, quick: bool, seeds: Sequence[int] | None, store: Path, console: Console) -> StudyPlan:
    """The study of a subject, with stored measurements of further seeds."""
    file = STUDIES / f"{name if name in PARTS else 'method'}.toml"
    table = read_toml(file)

    def planned(wanted: Sequence[int] | None) -> StudyPlan:
        return plan_of(measurements_of(file, table, subject=name, quick=quick, seeds=wanted), store, console)

    plan = planned(seeds)
    while there(more := planned([max(plan.study.axes["seed"]) + 1]), store) & more.ends:
        plan = planned([*plan.study.axes["seed"], *more.study.axes["seed"]])
    return plan


def subject_of(plan: StudyPlan) -> str:
    """The name of the subject."""
    return str(plan.study.table["measure"]["subject"])


def told(plan: StudyPlan, store: Path) -> Iterator[str]:
    """How many measurements of each knob are missing."""
    known, name = there(plan, store), subject_of(plan)
    for knob in plan.study.axes["knob"]:
        keys = {key for cell, key in plan.runs if cell.values["knob"] == knob}
        if count := len(keys - known):
            yield f"pareto {name}: {knob}: {count} measurements to be made, {len(keys & known)} kept {NOT_DONE}"
        elif keys:
            yield f"pareto {name}: {knob}: unchanged, kept {len(keys)} measurements"
