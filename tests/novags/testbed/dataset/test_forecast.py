"""Claims about the forecast of a data set: the disk of every entry, and the copies that shards hold."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.dataset import forecast as module
from novags.testbed.dataset.file import DatasetConfig

DISK = {"s0": 1e6, "s1": 2e6, "c0": 4e6, "c1": 8e6, "c2": 16e6}
NEEDS = {"c0": ("s0",), "c1": ("s0",), "c2": ("s1", "s0")}


@pytest.mark.parametrize("shard_mb", [None, 3.0])
def test_every_entry_counts_once_and_shards_hold_the_set_of_every_capture_again(
    shard_mb: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = {key: SimpleNamespace(key=key, needs=NEEDS.get(key, ())) for key in DISK}
    cells = [SimpleNamespace(preset=megabytes) for megabytes in (1, 2, 4)]
    plan: Any = SimpleNamespace(tasks=tasks, ends=("c0", "c1", "c2"), study=SimpleNamespace(cells=cells))
    predicted = SimpleNamespace(predicted=lambda task: SimpleNamespace(disk=DISK[task.key]))
    monkeypatch.setattr(module.Costs, "of", lambda *_: predicted)
    monkeypatch.setattr(module, "costs", lambda store: [])
    monkeypatch.setattr(module.of_study, "forecast", lambda *_: "work")
    monkeypatch.setattr(module, "size_of", lambda names, presets: 1e6 * sum(presets) * len(names))
    split = {"a": "train", "b": "test", "c": "train"}
    config = DatasetConfig(name="dark", licence="x", shard_mb=shard_mb)
    engine: Any = SimpleNamespace(threads={})
    found = module.forecast(plan, config, split, tmp_path, tmp_path, engine)
    beside = 0 if shard_mb is None else (4 + 1) + (8 + 1) + (16 + 2 + 1)
    assert "data set dark: about 31.0 MB" in found
    assert f"it takes {f'{beside:.1f} MB' if beside else '0 kB'}" in found
    assert [line.split()[0] for line in found.splitlines()[3:]] == ["train", "test"]
    assert "2 scenes: a, c" in found
    assert ("(links, and shards)" if beside else "(links)") in found
    found = module.forecast(plan, replace(config, recipes=("denoiser", "dark3r")), split, tmp_path, tmp_path, engine)
    assert f"it takes {beside + 14:.1f} MB (links, and {'shards, ' * bool(beside)}denoiser, dark3r)" in found
