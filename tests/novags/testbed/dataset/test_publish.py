"""Claims about the entries of a data set and the rows of its index."""

import csv
import json
from itertools import pairwise
from typing import Any

from novags.testbed.dataset.publish import entries_of, simulated, views_of


def test_every_capture_has_its_scene_its_split_and_its_values(finished: Any) -> None:
    entries = entries_of(finished.plan, finished.store, {"tabletop:1": "train", "cornell": "val"})
    assert [(e.task.key, e.scene, e.split) for e in entries] == [
        ("s0", "tabletop:1", "train"), ("s1", "cornell", "val"),
        ("c0", "tabletop:1", "train"), ("c1", "tabletop:1", "train"), ("c2", "cornell", "val"),
    ]  # fmt: skip
    assert [e.values for e in entries[:2]] == [{}, {}]
    assert [e.values for e in entries[2:]] == [dict(cell.values) for cell, _ in finished.plan.runs]
    assert [e.facts()["views"] for e in entries] == [3] * 5
    assert all(first.files != second.files for first, second in pairwise(entries))


def test_all_effects_that_are_in_and_all_that_are_not_are_told() -> None:
    effects = [{"name": name, "on": on, "reason": f"as {name}"} for name, on in
               (("a", True), ("b", False), ("c", True), ("d", False))]  # fmt: skip
    for given, on in ((effects, ["a", "c"]), (effects[::-1], ["c", "a"])):
        found = simulated({"effects": given, "bound": 0.5, "unit": "DN"})
        assert found == {"on": on, "off": {"b": "as b", "d": "as d"}, "bound": 0.5, "unit": "DN"}
    assert simulated(None) == {"on": "all", "off": {}}


def test_each_view_of_each_capture_has_a_row_with_files_that_are_there(finished: Any) -> None:
    with (finished.out / "index.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    captures = [f"{split}/capture/capture-{k:016x}" for k, split in enumerate(("train", "train", "val"))]
    assert [(row["capture"], row["view"]) for row in rows] == [(c, f"{i:04d}") for c in captures for i in range(3)]
    assert [row["set"][-1] for row in rows] == list("000000111")
    assert [row["seed"] for row in rows] == list("000111000")
    assert [row["noise_seed"] for row in rows] == ["70"] * 3 + ["71"] * 3 + ["72"] * 3
    assert [row["held_out"] for row in rows] == ["1", "0", "0"] * 3
    named = [row[kind] for row in rows for kind in ("dark", "dark16", "raw", "truth", "lit", "gt")]
    assert all((finished.out / name).is_file() for name in named)
    assert len(set(named)) == 9 * 4 + 6 * 2  # two captures share the set of their scene
    for split in ("train", "val"):
        lines = (finished.out / split / "metadata.jsonl").read_text().splitlines()
        assert [json.loads(line)["raw"] for line in lines] == [row["raw"] for row in rows if row["split"] == split]


def test_the_cameras_of_a_row_are_those_of_its_view(finished: Any) -> None:
    entries = entries_of(finished.plan, finished.store, {"tabletop:1": "train", "cornell": "val"})
    views = list(views_of(entries, finished.out))
    assert [view.cameras.names[view.i] for view in views] == [view.row["view"] for view in views]
    assert [view.row["scene"] for view in views] == ["tabletop:1"] * 6 + ["cornell"] * 3
    backwards = views_of(entries[::-1], finished.out)  # captures before their sets
    assert [view.row["scene"] for view in backwards] == ["cornell"] * 3 + ["tabletop:1"] * 6
