"""Claims about the samples on disk: complete, listed, and made again only where something has changed."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.dataset.make import publish
from novags.testbed.dataset.publish import entries_of
from novags.testbed.dataset.recipes import write

QUIET = Console(quiet=True)


def published(finished: Any, out: Path, *recipes: str) -> dict[str, Any]:
    publish(finished.plan, replace(finished.config, recipes=recipes), finished.store, out, QUIET)
    files: dict[str, Any] = json.loads((out / "manifest.json").read_text())["files"]
    return files


def rows(out: Path, recipe: str) -> list[dict[str, str]]:
    with (out / "training" / recipe / "index.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def out(finished: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The data set with two recipes."""
    monkeypatch.setitem(write.RECIPES, "copy", write.RECIPES["denoiser"])
    made = shutil.copytree(finished.out, tmp_path / "data")
    published(finished, made, "denoiser", "copy")
    return made


def test_every_sample_is_in_the_index_and_in_the_manifest_and_has_the_split_of_its_scene(out: Path) -> None:
    files = json.loads((out / "manifest.json").read_text())["files"]
    there = {path.relative_to(out).as_posix() for path in (out / "training").rglob("[!.]*") if path.is_file()}
    assert {name for name in files if name.startswith("training/")} == there
    for recipe in ("denoiser", "copy"):
        found = rows(out, recipe)
        assert [(row["split"], row["scene"]) for row in found] == [("train", "tabletop:1")] * 6 + [
            ("val", "cornell")
        ] * 3
        assert {row["file"] for row in found} | {f"training/{recipe}/index.csv"} == {
            name for name in there if name.startswith(f"training/{recipe}/")
        }
        for row in found:
            assert row["file"].startswith(f"training/{recipe}/{row['split']}/")
            with np.load(out / row["file"]) as held:  # which refuses pickles
                assert all(held[name].dtype != object for name in held.files)
    card = (out / "README.md").read_text()
    assert "- `training/denoiser`: a raw frame as taken" in card
    assert "`snr_db` is 10 log10 of the sum" in card


def test_nothing_is_made_again_and_the_same_samples_have_the_same_bytes(finished: Any, out: Path) -> None:
    def stamps() -> dict[Path, tuple[int, int]]:
        return {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in (out / "training").rglob("*.npz")}

    before = stamps()
    files = published(finished, out, "denoiser", "copy")
    assert stamps() == before
    entries = entries_of(finished.plan, finished.store, {"tabletop:1": "train", "cornell": "val"})
    listed = write.write_recipes(("denoiser", "copy"), entries[::-1], out, QUIET)  # in another order
    assert sorted(listed) == [name for name in sorted(files) if name.startswith("training/")]
    assert stamps() == before
    gone = out / rows(out, "denoiser")[0]["file"]
    gone.unlink()
    assert published(finished, out, "denoiser", "copy") == files
    after = stamps()
    assert {path for path in before if after[path] != before[path]} == set(gone.parent.glob("*.npz"))


def test_a_group_is_made_again_when_its_captures_or_its_set_or_the_code_of_the_recipe_change(
    finished: Any, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entries = entries_of(finished.plan, finished.store, {"tabletop:1": "train", "cornell": "val"})
    lit, capture = (next(entry for entry in entries if entry.task.kind == kind) for kind in ("set", "capture"))
    opened = list[str]()
    kept = write.opened_group
    monkeypatch.setattr(write, "opened_group", lambda *args: opened.append("again") or kept(*args))

    def made(captures: list[Any], of_set: Any) -> int:
        opened.clear()
        write._rows_of("denoiser", captures, of_set, out)
        return len(opened)

    assert made([capture], lit) == 0
    assert made([capture], replace(lit, files=lit.files | {"set.json": "another"})) == 1
    assert made([capture], lit) == 1
    assert made([replace(capture, files={})], lit) == 1
    assert made([replace(capture, files={})], lit) == 0
    monkeypatch.setattr(write, "code_of", lambda _: SimpleNamespace(key="another"))
    assert made([replace(capture, files={})], lit) == 1


def test_recipes_that_are_gone_are_removed_and_what_somebody_put_there_stays(finished: Any, out: Path) -> None:
    mine = [out / "training" / name for name in ("notes.txt", "denoiser/weights.pt", "denoiser/train/mine/a.npz")]
    for path in mine:
        path.parent.mkdir(exist_ok=True)
        path.write_text("mine")
    stale = out / "training" / "copy" / "train" / "earlier"
    stale.mkdir()
    (stale / ".made.json").write_text("{}")
    files = published(finished, out, "copy")
    assert not stale.exists()
    assert {path for path in (out / "training").rglob("*") if path.is_file() and path not in mine} == {
        *(out / name for name in files if name.startswith("training/")),
        *(out / "training").rglob(".made.json"),
    }
    assert [path.read_text() for path in mine] == ["mine"] * 3
    for path in mine:
        path.unlink()
    shutil.rmtree(out / "training" / "denoiser")
    assert not any(name.startswith("training/") for name in published(finished, out))
    assert not (out / "training").exists()


def test_captures_are_together_if_their_light_alone_differs(finished: Any) -> None:
    entries = entries_of(finished.plan, finished.store, {"tabletop:1": "train", "cornell": "val"})
    captures = [entry for entry in entries if entry.task.kind == "capture"]
    assert [[entry.task.key for entry in group] for group in write.grouped(captures)] == [["c0"], ["c1"], ["c2"]]
    first = captures[0]
    bright = replace(first, record=first.record | {"electrons": 900.0},
                     task=replace(first.task, config=replace(first.task.config, electrons=900.0)))  # fmt: skip
    longer = replace(first, task=replace(first.task, config=replace(first.task.config, time=0.5)))
    assert write.grouped([bright, longer, first]) == [[first, bright], [longer]]
