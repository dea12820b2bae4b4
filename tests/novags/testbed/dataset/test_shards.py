"""Claims about the shards of a data set."""

import csv
import hashlib
import json
import shutil
import tarfile
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.dataset.publish import entries_of, views_of
from novags.testbed.dataset.shards import write_shards


def sums(out: Path) -> dict[str, str]:
    files = (path for path in out.rglob("*") if path.is_file())
    return {path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.mark.parametrize(("most", "shares"), [(1, {"train": [1] * 6, "val": [1] * 3}),
                                              (4, {"train": [4, 2], "val": [3]}),
                                              (9, {"train": [6], "val": [3]})])  # fmt: skip
def test_every_view_is_in_one_shard_of_its_split_with_all_its_files(
    finished: Any, tmp_path: Path, most: int, shares: dict[str, list[int]]
) -> None:
    out = shutil.copytree(finished.out, tmp_path / "data", ignore=shutil.ignore_patterns("shards"))
    views = list(views_of(entries_of(finished.plan, finished.store, {"tabletop:1": "train", "cornell": "val"}), out))
    size = sum((out / views[0].row[kind]).stat().st_size for kind in ("dark", "dark16", "raw", "truth", "lit", "gt"))
    names = write_shards(views, out, (most - 0.5) * size / 1e6, sums(out))
    assert names == [f"shards/{s}-{k:06d}.tar" for s, counts in shares.items() for k in range(len(counts))]
    rows = [view.row for view in views]
    numbers = {capture: k for k, capture in enumerate(dict.fromkeys(row["capture"] for row in rows))}
    for split, counts in shares.items():
        own = [(row, i % 3) for i, row in enumerate(rows) if row["split"] == split]
        for k, count in enumerate(counts):
            with tarfile.open(out / f"shards/{split}-{k:06d}.tar") as tar:
                held = {name: tar.extractfile(name).read() for name in tar.getnames()}  # type: ignore[union-attr]
            samples, own = own[:count], own[count:]
            keys = [f"{numbers[row['capture']]:06d}-{i:05d}" for row, i in samples]
            assert list(dict.fromkeys(name.partition(".")[0] for name in held)) == keys
            for key, (row, _) in zip(keys, samples, strict=True):
                assert held[f"{key}.dark.png"] == (out / row["dark"]).read_bytes()
                assert held[f"{key}.gt.exr"] == (out / row["gt"]).read_bytes()
                about = json.loads(held[f"{key}.json"])
                assert (about["view"], about["seed"], about["scene"]) == (row["view"], row["seed"], row["scene"])
            assert len(held) == 7 * count
        assert own == []


def test_a_capture_of_one_view_has_a_shard_too(finished: Any, tmp_path: Path) -> None:
    out = shutil.copytree(finished.out, tmp_path / "data", ignore=shutil.ignore_patterns("shards"))
    views = list(views_of(entries_of(finished.plan, finished.store, {"tabletop:1": "train", "cornell": "val"}), out))
    alone = [views[0], *(view for view in views if view.row["split"] == "val")]
    assert write_shards(alone, out, 1e9, sums(out)) == ["shards/train-000000.tar", "shards/val-000000.tar"]
    with tarfile.open(out / "shards/train-000000.tar") as tar:
        assert {name.partition(".")[0] for name in tar.getnames()} == {"000000-00000"}


@pytest.mark.parametrize("place", [0, 2, 5])
def test_a_shard_is_written_again_when_any_of_its_files_has_changed(finished: Any, tmp_path: Path, place: int) -> None:
    out = shutil.copytree(finished.out, tmp_path / "data")
    views = list(views_of(entries_of(finished.plan, finished.store, {"tabletop:1": "train", "cornell": "val"}), out))
    known = sums(out)
    write_shards(views, out, 9.0, known)
    with (out / "index.csv").open(newline="") as file:
        row = list(csv.DictReader(file))[place]
    for kind in ("dark", "dark16", "raw", "truth", "lit", "gt"):
        (out / "shards" / "train-000000.tar").write_bytes(b"old")
        write_shards(views, out, 9.0, known)
        assert (out / "shards" / "train-000000.tar").read_bytes() == b"old"
        write_shards(views, out, 9.0, known | {row[kind]: f"another {kind}"})
        assert (out / "shards" / "train-000000.tar").read_bytes() != b"old"
        write_shards(views, out, 9.0, known)
