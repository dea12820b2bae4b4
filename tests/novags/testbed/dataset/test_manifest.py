"""What the list of a data set says of all its parts together."""

from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.dataset import make


def test_seeds_scenes_and_costs_are_of_all_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    def entry(kind: str, seed: int, scene: str, split: str, seconds: float, peak: int) -> Any:
        cost = {"seconds": seconds, "peak_bytes": peak}
        return SimpleNamespace(facts=lambda: {"kind": kind, "seed": seed, "scene": scene, "split": split, "cost": cost})

    entries = [
        entry("set", 7, "a", "train", 1.0, 10), entry("set", 5, "b", "test", 2.0, 40),
        entry("capture", 3, "a", "train", 4.0, 20), entry("capture", 1, "b", "test", 8.0, 30),
    ]  # fmt: skip
    config: Any = SimpleNamespace(name="n", version="1", licence="l", description="d", creators=("c", "e"))
    study: Any = SimpleNamespace(axes={"scene": ("a", "b")})
    monkeypatch.setattr(make, "jsonable_table", lambda _: {})
    files: dict[str, dict[str, Any]] = {"x": {"bytes": 100}, "y": {"bytes": 11}}
    found = make._manifest(config, study, entries, files)
    assert found["seeds"] == [1, 3]
    assert found["render_seeds"] == [5, 7]
    assert {split: scenes for split, scenes in found["splits"].items() if scenes} == {"train": ["a"], "test": ["b"]}
    assert found["cost"] == {"seconds": 15.0, "peak_bytes": 40, "bytes": 111}
    assert found["entries"] == [each.facts() for each in entries]
    assert found["creators"] == ["c", "e"]
