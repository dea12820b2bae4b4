"""How far methods of a study are apart: one row for each pair and score, of each scene and over all, in
differences.csv.

A row has the difference of two methods with its standard error and interval (`metrics.differences`), whether it is
seen, and, against the floor of the scale, the share of the cost of noise that the method recovers. Pairs are of the
runs that agree in every axis but the method, the seed and the scene.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.testbed.console.csv_text import as_csv
from novags.testbed.metrics.differences import Estimate, Scatter, Values, difference, share, smallest_seen
from novags.testbed.stages.scores.comparing import NO_GAIN, SHARES, bounds_of, values_of
from novags.testbed.study.cells.grid import Cell
from novags.testbed.study.cells.presets import Preset
from novags.testbed.study.light import METHOD, SEED
from sensor_model.files.atomic import write_text
from simscenes.sets.writers.camera_files import is_test_view

DIFFERENCES = "differences.csv"
SCENE = "scene"
ALL = "all scenes"
# dB, before anything is known of a study: root mean squares over differences between naive, naive-l1 and nova-fast, in
# both scores, on tabletop:3, cornell, busts and bookshop (64 px, 24 views, 800 iterations); of seeds on tabletop.
USUAL = Scatter(scenes=0.7, seeds=0.05, views=0.35)
NUMBERS = ("difference", "error", "low", "high", "freedom", "over", "scenes", "seeds", "views", "seen", "recovered",
           "recovered_error")  # fmt: skip


@dataclass(frozen=True)
class Finished:
    """A finished run of a study."""

    place: Mapping[str, Any]  # its values of the axes
    method: str  # which its variant is of
    scores: Mapping[str, Any]  # of metrics.json
    enhancement: str  # what its noise-free reference is enhanced by


def write_differences(out: Path, axes: Mapping[str, Any], runs: Sequence[Finished]) -> None:
    """Write the table of a study."""
    others = [name for name in axes if name not in (METHOD, SEED, SCENE)]
    columns = (*others, SCENE, "score", METHOD, "than", *NUMBERS)
    write_text(out / DIFFERENCES, as_csv(rows_of(axes, runs), columns))


def rows_of(axes: Mapping[str, Any], runs: Sequence[Finished]) -> list[dict[str, Any]]:
    """The rows of the table; scenes by themselves and, of several, all together."""
    others = [name for name in axes if name not in (METHOD, SEED, SCENE)]
    places: dict[tuple[str, ...], list[Finished]] = {}
    for run in runs:
        places.setdefault(tuple(str(run.place[name]) for name in others), []).append(run)
    found = []
    for members in places.values():
        scenes = list(dict.fromkeys(str(run.place.get(SCENE, "")) for run in members))
        groups = {scene: [run for run in members if str(run.place.get(SCENE, "")) == scene] for scene in scenes}
        for scene, chosen in (groups | {ALL: members} if len(scenes) > 1 else groups).items():
            where = {name: chosen[0].place[name] for name in others} | {SCENE: scene}
            found += [where | row for row in _pairs(chosen)]
    return found


def _pairs(runs: Sequence[Finished]) -> Iterator[dict[str, Any]]:
    methods = {str(run.place[METHOD]): run.method for run in runs}
    ends = {end: names[0] for end, names in bounds_of(methods).items()}
    for kind, number in SHARES.values():
        values = {name: _values(runs, name, kind, number) for name in methods}
        tones = {name: {run.enhancement for run in runs if run.place[METHOD] == name} for name in methods}
        known = [name for name in methods if values[name]]
        known.sort(key=lambda name: name != ends.get("floor"))  # stable: all others are above the floor, if above
        for k, other in enumerate(known):
            for name in known[k + 1 :]:
                # A noise-free reference is enhanced as its run is: of two enhancements there are two.
                apart = difference(values[name], values[other])
                if apart is None or (kind == "enhanced" and len(tones[name] | tones[other]) > 1):
                    continue
                won = None
                ceiling = str(ends.get("ceiling"))
                alike = kind != "enhanced" or tones[name] == tones.get(ceiling)
                if other == ends.get("floor") and ceiling in known and name != ceiling and alike:
                    won = share(values[name], values[other], values[ceiling], NO_GAIN)
                yield {"score": f"{kind}.{number}", METHOD: name, "than": other, **_numbers(apart, won)}


def _values(runs: Sequence[Finished], name: str, kind: str, number: str) -> Values:
    found: dict[tuple[str, str, str], float] = {}
    for run in runs:
        if run.place[METHOD] == name:
            scene, seed = (str(run.place.get(axis, "")) for axis in (SCENE, SEED))
            found |= values_of(run.scores, kind, number, scene, seed)
    return found


def _numbers(apart: Estimate, won: Estimate | None) -> dict[str, Any]:
    half = apart.half
    return {
        "difference": apart.value, "error": apart.error, "low": None if half is None else apart.value - half,
        "high": None if half is None else apart.value + half, "freedom": apart.freedom if half is not None else None,
        "over": apart.over, "scenes": apart.scenes, "seeds": apart.seeds, "views": apart.views,
        "seen": None if half is None else apart.seen, "recovered": None if won is None else won.value,
        "recovered_error": None if won is None else won.error,
    }  # fmt: skip


def _held_out(preset: Preset) -> int:
    """Held-out views of a set that will be rendered; of one that is there already, 1 at least."""
    rendered = preset.folder is None and preset.photos is None and preset.dark is None
    return sum(map(is_test_view, range(preset.render.n_views))) if rendered else 1


def foreseen(axes: Mapping[str, Sequence[Any]], cells: Sequence[Cell], scatter: Scatter = USUAL) -> str:
    """In a line: the smallest difference between two methods that the study sees four times in five."""
    scenes, seeds = (max(len(axes.get(axis, ())), 1) for axis in (SCENE, SEED))
    views = min(_held_out(cell.preset) for cell in cells)
    least = smallest_seen(scenes, seeds, views, scatter)
    of = [f"{count} {what}{'' if count == 1 else 's'}" for count, what in ((scenes, SCENE), (seeds, SEED))]
    counts = f"{', '.join(of)}, {views} held-out view{'' if views == 1 else 's'}"
    if least is None:
        return f"no difference between methods, of {counts}: nothing repeats, and so no error is known"
    place = "this scene" if scenes == 1 else "scenes like these"
    return f"differences from {least:.2g} dB on of two methods on {place}, four times in five ({counts})"
