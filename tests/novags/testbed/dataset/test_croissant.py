"""Claims about the metadata of a data set."""

import json
from typing import Any

from novags.testbed.dataset.croissant import TYPES


def test_all_shards_columns_and_creators_are_named(finished: Any) -> None:
    found = json.loads((finished.out / "croissant.json").read_text())
    files = json.loads((finished.out / "manifest.json").read_text())["files"]
    shards = [f"shards/train-{k:06d}.tar" for k in range(6)] + [f"shards/val-{k:06d}.tar" for k in range(3)]
    assert [creator["name"] for creator in found["creator"]] == ["Jane", "Joe"]
    assert found["citeAs"].startswith("Jane, Joe: dark")
    *single, together = found["distribution"]
    assert [one["@id"] for one in single] == ["index.csv", *shards]
    assert all(one["sha256"] == files[one["@id"]]["sha256"] for one in single)
    assert [one["@id"] for one in together["containedIn"]] == shards
    (views,) = found["recordSet"]
    header = (finished.out / "index.csv").read_text().splitlines()[0].split(",")
    assert [field["name"] for field in views["field"]] == header
    assert {field["name"]: field["dataType"] for field in views["field"] if field["name"] in TYPES} == TYPES
