"""What the page on runs of several captures shows: a table and pictures of each capture."""

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from novags.methods.memo import Memo
from novags.testbed.console import Update
from novags.testbed.report.look.album import Album
from novags.testbed.report.look.maps import ERROR_CEILING
from novags.testbed.report.material import Material
from novags.testbed.report.pictures import ViewTiles, spread, view_tiles
from novags.testbed.report.verdict import compared
from novags.testbed.results.again import score_again
from novags.testbed.results.comparison import MAIN, Group
from novags.testbed.results.mixed import mixed
from sensor_model.files.door import resolved

VIEWS = 8  # of all captures together; each has one at least


def comparison_context(groups: Sequence[Group], folder: Path, album: Album, progress: Update) -> dict[str, Any]:
    """What the template shows; its pictures go into `album`.

    Args:
        groups: The runs of each capture.
        folder: Of the page.
        album: Of the page.
        progress: Told of every capture.
    """
    shown, views, left, right = [], list[ViewTiles](), list[str](), list[str]()
    unseen = dict[str, str]()
    for done, (group, place) in enumerate(zip(groups, places(groups, folder), strict=True), 1):
        # Of its own memory, so that what was computed for the pictures of one capture goes before the next.
        capture = replace(group.capture, memo=Memo())
        material = Material(folder, {}, group.runs, group.metrics, capture, group.lit)
        picked = spread(capture.cameras.test_indices, max(1, VIEWS // len(groups)))
        try:
            mine = [view_tiles(i, material, album, place) for i in picked]
        except (ValueError, OSError) as error:  # one damaged or old run must not cost the tables
            mine, unseen[place] = [], str(error)
        views += mine
        for side, key in zip((left, right), compared(material), strict=True):
            side.append(key)
        base = {kind: group.deltas(kind)[1] for kind in MAIN}
        shown.append({"title": place, "base": base, "rows": _rows(group, material, mine), "unregistered":
                      group.lit.views.unregistered, "unavailable": group.metrics["unavailable"]})  # fmt: skip
        progress(done, len(groups), place)
    count = sum(len(group.runs) for group in groups)
    named = zip(groups, places(groups, folder), strict=True)
    every = {f"{place}: {name}": run for group, place in named for name, run in group.runs.items()}
    data = {"left": [*left, "enhanced"], "right": [*right, "truth-lit"]}
    return {"title": f"{count} runs of {len(groups)} captures", "groups": shown, "count": count, "views": views,
            "unseen": unseen, "error_ceiling": ERROR_CEILING, "data": data, "mixed": mixed(every)}  # fmt: skip


def places(groups: Sequence[Group], folder: Path) -> list[str]:
    """The title of each group, with the folder of its capture where others have the same title."""
    count = Counter(group.title for group in groups)
    return [group.title if count[group.title] == 1
            else f"{group.title} ({os.path.relpath(resolved(group.capture.path), resolved(folder))})"
            for group in groups]  # fmt: skip


def _rows(group: Group, material: Material, views: Sequence[ViewTiles]) -> list[dict[str, Any]]:
    deltas = {kind: group.deltas(kind)[0] for kind in MAIN}
    recovered = {"enhanced": group.metrics["recovered"], "lit": group.metrics["recovered_lit"]}
    rows = []
    for name, run in group.runs.items():
        scores = group.metrics["methods"][name]
        row = {kind: {"value": (scores["mean"].get(kind) or {}).get(MAIN[kind]), "delta": deltas[kind].get(name),
                      "recovered": recovered[kind].get(name)} for kind in MAIN}  # fmt: skip
        geometry = scores.get("geometry")
        rows.append({"name": name, **row, "competes": material.rows[name].competes,
                     "depth": geometry and geometry["abs_rel"], "seconds": run.record["stage"]["seconds"],
                     "again": score_again(run, material.folder, name),
                     "view": views[0].name if views else None})  # fmt: skip
    return rows
