"""Claims about a data set as a whole: what it holds and lists, and what it leaves to others."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.dataset import make
from novags.testbed.ledger.contents import checksum


def test_seeds_scenes_and_costs_are_of_all_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    def entry(kind: str, seed: int, scene: str, split: str, seconds: float, peak: int) -> Any:
        cost = {"seconds": seconds, "peak_bytes": peak}
        return SimpleNamespace(facts=lambda: {"kind": kind, "seed": seed, "scene": scene, "split": split, "cost": cost})

    entries = [
        entry("set", 7, "a", "train", 1.0, 40), entry("set", 5, "b", "test", 2.0, 10),
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
    shards = ["shards/train-000000.tar", "shards/val-000000.tar"]
    files = {shards[0]: {"bytes": 1}, **files, shards[1]: {"bytes": 1}}
    assert make._manifest(config, study, entries, files)["shards"] == shards


def test_all_files_of_all_entries_are_there_and_listed_with_their_checksums(finished: Any) -> None:
    manifest = json.loads((finished.out / "manifest.json").read_text())
    there = {path.relative_to(finished.out).as_posix() for path in finished.out.rglob("*") if path.is_file()}
    hidden = {name for name in there if "/." in name or name.startswith(".")}
    assert set(manifest["files"]) == there - hidden - {"manifest.json"}
    assert {name: facts["bytes"] for name, facts in manifest["files"].items()} == {
        name: (finished.out / name).stat().st_size for name in manifest["files"]
    }
    for task in finished.plan.tasks.values():
        (place,) = finished.out.glob(f"*/{task.kind}/{task.name}")
        folder = task.folder(finished.store)
        made = {p.relative_to(folder): checksum(p) for p in folder.rglob("[!.]*") if p.is_file()}
        assert {path.relative_to(place): checksum(path) for path in place.rglob("*") if path.is_file()} == made
    study = finished.plan.study
    assert make.scenes_of(study) == ["tabletop:1", "cornell"]
    assert make.scenes_of(replace(study, cells=study.cells[::-1])) == ["cornell", "tabletop:1"]
    assert manifest["splits"] == {"train": ["tabletop:1"], "val": ["cornell"], "test": []}


def test_what_the_file_no_longer_has_is_removed_from_every_split_and_nothing_else(
    finished: Any, tmp_path: Path
) -> None:
    out = shutil.copytree(finished.out, tmp_path / "data")
    there = {path for path in out.glob("*/*/*") if path.is_dir()}
    files = {path: path.stat().st_ino for folder in there for path in folder.rglob("*") if path.is_file()}
    gone = [out / split / kind / f"old-{k}123456789abcdef" for split in ("train", "val", "test")
            for kind in ("set", "capture") for k in range(2)]  # fmt: skip
    foreign = [out / "train" / "set" / "mine", out / "val" / "capture" / "mine"]
    for path in (*gone, *foreign):
        path.mkdir(parents=True)
    make.publish(finished.plan, finished.config, finished.store, out, Console(quiet=True))
    assert {path for path in out.glob("*/*/*") if path.is_dir()} == there | set(foreign)
    assert {path: path.stat().st_ino for path in files} == files  # not written anew


@pytest.mark.parametrize("name", ["manifest.json", "README.md", "croissant.json", "index.csv", "shards", "training",
                                  "train", "val", "test"])  # fmt: skip
def test_a_folder_that_holds_any_of_its_names_is_refused_unless_it_was_made_here(tmp_path: Path, name: str) -> None:
    (tmp_path / "out" / name).mkdir(parents=True)
    (tmp_path / "making").mkdir()
    with pytest.raises(ValueError, match=re.escape(f"already holds {name}, and no work")):
        make.refuse_foreign(tmp_path / "out", tmp_path / "making")
    (tmp_path / "making" / "study.json").touch()
    make.refuse_foreign(tmp_path / "out", tmp_path / "making")
