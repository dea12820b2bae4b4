"""The words of a budget: before the work, when the rest is chosen again, and afterwards."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from novags.testbed.folders import shapes
from novags.testbed.folders.runs import EXPERIMENT, ROWS, TABLE
from novags.testbed.ledger.contents import jsonable, read_json
from novags.testbed.study.budget.choice import Option
from novags.testbed.study.cells.presets import Preset
from novags.testbed.study.knobs.options import WORDS, values

State = Mapping[str, Any]


def changes(preset: Preset, chosen: Preset) -> str:
    """Which options differ, with both values."""
    before, now = values(preset), values(chosen)
    words = [f"{WORDS[name]} {before[name]} -> {now[name]}" for name in before if before[name] != now[name]]
    return ", ".join(words) or "nothing, the preset fits"


def _foretold(state: State) -> str:
    found = state["foretold"]
    if not any(share != 1 for share in state["shares"].values()):
        return "nothing is lost"
    return f"expected to lose {found['lost']:.1f} ± {found['sd']:.1f} dB of aligned PSNR against the preset"


def before(preset: Preset, chosen: Preset, state: State, untried: Sequence[str] = ()) -> list[str]:
    """The choice, its time, its loss, and the source of these numbers; `untried`: methods by the tables."""
    tables = f", of {' and '.join(untried)} in part from the curves, at that pace" if untried else ""
    return [
        f"budget {state['budget']:g} s: changed against the preset: {changes(preset, chosen)}",
        f"  predicted {state['foretold']['seconds']:.0f} s, of which {state['trial']:.0f} s are spent on the trial; "
        f"the preset takes {state['preset_seconds']:.0f} s here",
        f"  {_foretold(state)}",
        f"  losses from the curves {state['curves']}; times from the trial on this machine{tables}",
    ]


def untried(
    preset: Preset, budget: float, limit: float, options: Mapping[str, Sequence[Option]], source: str
) -> list[str]:
    """The basis of a choice whose trial has not run yet.

    Args:
        preset: The experiment.
        budget: Seconds.
        limit: Seconds that the trial may take.
        options: The options to choose from.
        source: Where the curves come from.
    """
    own = values(preset)
    least = {name: max(1, round(own[name] * min(s.share for s in settings))) for name, settings in options.items()}
    open_ = ", ".join(f"{WORDS[name]} {own[name]} -> {value} at the least" for name, value in least.items())
    return [
        f"budget {budget:g} s: the experiment to be tried on a small scale, for {limit:g} s at most, to see this "
        "machine's pace",
        f"  then to be chosen, so that least is lost by the curves {source}: {open_ or 'nothing, all is given'}",
        f"run: {', '.join(preset.methods)} to be made, scored and reported with these settings",
    ]


def again(preset: Preset, chosen: Preset, state: State, spent: float) -> list[str]:
    """A new choice for the rest."""
    return [
        f"budget: the pictures are taken after {spent:.0f} s; for the time that is left: {changes(preset, chosen)}",
        f"  predicted {state['foretold']['seconds']:.0f} s in all; {_foretold(state)}",
    ]


def after(preset: Preset, out: Path, state: State, against: Path | None) -> list[str]:
    """The time taken, and the loss as far as known.

    Args:
        preset: The experiment that was asked for.
        out: The folder of the finished work.
        state: The prediction.
        against: A folder that may hold a finished run of the preset itself.
    """
    took, budget = state["seconds"], state["budget"]
    over = f": {took - budget:.0f} s more than the budget" if took > budget else ""
    lines = [f"budget {budget:g} s: took {took:.0f} s, predicted {state['foretold']['seconds']:.0f} s{over}"]
    full = None if against is None else _scores(against, preset)
    if not any(share != 1 for share in state["shares"].values()):
        return [*lines, "  the preset itself was run: nothing is lost"]
    if full is None:
        return [*lines, f"  {_foretold(state)}; its real loss is known once the preset itself has been run: the "
                        "same command without --budget, then this one again"]  # fmt: skip
    own = _scores(out, None) or {}
    for name, here in own.items():
        if name in full:
            lines.append(f"  {name}: {here:.2f} dB, {full[name]:.2f} dB with the preset's settings in {against}: lost "
                         f"{full[name] - here:.2f} dB")  # fmt: skip
    return [*lines, f"  {_foretold(state)}, predicted for the method that the curves were measured with"]


def _scores(folder: Path, preset: Preset | None) -> dict[str, float] | None:
    """Aligned PSNR of each method; None if the experiment is unfinished, or has other settings than the preset."""
    if not (folder / EXPERIMENT).exists():
        return None
    record = read_json(folder / EXPERIMENT, shapes.EXPERIMENT)
    if preset is not None and record["preset"] != jsonable(asdict(preset)):
        return None
    scores = {row["method"]: row.get("enhanced.aligned_psnr") for row in read_json(folder / TABLE, ROWS)["rows"]}
    return {name: score for name, score in scores.items() if score is not None}
