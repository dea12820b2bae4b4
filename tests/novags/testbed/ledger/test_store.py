"""Claims about the keys and the seals of entries in a store."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.ledger.store import SEAL, key_of, other_entries, read_seal, write_seal

COST: dict[str, Any] = {
    "seconds": {"work": 1.0},
    "peak_bytes": 1,
    "work": 1.0,
    "pixels": 1.0,
    "group": "g",
    "threads": 1,
}


def code(key: str) -> Any:
    return SimpleNamespace(key=key)


def test_entries_differ_by_kind_code_and_every_part_of_their_recipe() -> None:
    recipe = {"config": {"views": 4}, "set": "abc"}
    keys = [
        key_of("capture", recipe, code("1")),
        key_of("run", recipe, code("1")),
        key_of("capture", recipe, code("2")),
        key_of("capture", recipe | {"set": "abd"}, code("1")),
        key_of("capture", recipe | {"config": {"views": 5}}, code("1")),
        key_of("capture", {"set": "abc"}, code("1")),
    ]
    assert len(set(keys)) == len(keys)
    assert key_of("capture", dict(reversed(recipe.items())), code("1")) == keys[0]


@pytest.mark.parametrize("name", ["first.json", "second.json"])
def test_a_seal_knows_every_file_and_record_of_its_entry(name: str, tmp_path: Path) -> None:
    records = ("first.json", "second.json")
    for record in records:
        (tmp_path / f"{record}.png").write_bytes(b"picture")
        files = {f"{record}.png": "0"}
        (tmp_path / record).write_text(json.dumps({"stage": {"files": files}, "value": 1}))
    sealed = write_seal(tmp_path, "key", {"set": "abc"}, COST, records)
    assert read_seal(tmp_path) == sealed
    assert sealed.records.keys() == set(records)
    assert sealed.cost["bytes"] == 2 * len(b"picture")
    (tmp_path / name).write_text(json.dumps({"stage": {"files": {f"{name}.png": "1"}}, "value": 1}))
    changed = write_seal(tmp_path, "key", {"set": "abc"}, COST, records)
    assert changed.content != sealed.content
    assert {record for record in records if changed.records[record] != sealed.records[record]} == {name}


def test_entries_of_none_of_several_keys_are_counted(tmp_path: Path) -> None:
    keys = [character * 20 for character in "abc"]
    for key in keys:
        folder = tmp_path / "run" / f"naive-{key[:16]}"
        folder.mkdir(parents=True)
        (folder / SEAL).touch()
    assert [other_entries(tmp_path, set(keys[:k])) for k in range(4)] == [3, 2, 1, 0]
