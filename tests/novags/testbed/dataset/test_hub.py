"""Claims about the packages that others read a data set with: mlcroissant, datasets and webdataset, all offline."""

import csv
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes.sets.pictures.png import read_codes

HEAD = re.compile(r"\A---\n(.*?)\n---\n", re.S)


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "index.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def head(out: Path) -> dict[str, Any]:
    """The head of the card; every line is a key and JSON, which YAML is a superset of."""
    found = HEAD.match((out / "README.md").read_text())
    assert found is not None
    return {key: json.loads(value) for key, value in (line.split(": ", 1) for line in found[1].splitlines())}


def test_the_files_of_each_split_are_its_rows_and_all_their_pictures_and_no_others(finished: Any) -> None:
    (config,) = head(finished.out)["configs"]
    assert config["default"]
    assert [part["split"] for part in config["data_files"]] == ["train", "val"]
    for part in config["data_files"]:
        own = [row for row in rows(finished.out) if row["split"] == part["split"]]
        found = {path for pattern in part["path"] for path in finished.out.glob(pattern)}
        told = finished.out / part["split"] / "metadata.jsonl"
        assert found == {told} | {finished.out / row[kind] for row in own for kind in ("dark", "lit")}
        lines = [json.loads(line) for line in told.read_text().splitlines()]
        for line, row in zip(lines, own, strict=True):
            for kind in ("dark", "lit"):
                assert told.parent / line.pop(f"{kind}_file_name") == finished.out / row.pop(kind)
            assert {key: str(value) for key, value in line.items()} == row


def test_rows_of_a_split_that_is_gone_are_removed(finished: Any, tmp_path: Path) -> None:
    from novags.testbed.console.terminal import Console
    from novags.testbed.dataset import make

    out = shutil.copytree(finished.out, tmp_path / "data")
    (out / "test").mkdir()
    (out / "test" / "metadata.jsonl").write_text("{}")
    make.publish(finished.plan, finished.config, finished.store, out, Console(quiet=True))
    assert not (out / "test" / "metadata.jsonl").exists()
    assert "test/metadata.jsonl" not in json.loads((out / "manifest.json").read_text())["files"]


@pytest.mark.filterwarnings("ignore")  # of other people's packages
def test_mlcroissant_finds_no_error_and_reads_every_record(finished: Any) -> None:
    mlcroissant = pytest.importorskip("mlcroissant")
    data = mlcroissant.Dataset(jsonld=finished.out / "croissant.json")
    assert data.metadata.ctx.issues.errors == set()
    found = list(data.records("views"))
    expected = rows(finished.out)
    assert len(found) == len(expected)
    for record, row in zip(found, expected, strict=True):
        for name in ("split", "scene", "view", "dark", "gt"):
            assert record[f"views/{name}"].decode() == row[name]
        assert record["views/electrons"] == float(row["electrons"])
        assert record["views/noise_seed"] == int(row["noise_seed"])


@pytest.mark.filterwarnings("ignore")
def test_datasets_opens_the_folder_by_its_card(finished: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("HF_HUB_OFFLINE", "HF_DATASETS_OFFLINE"):
        monkeypatch.setenv(name, "1")
    monkeypatch.setenv("HF_HOME", str(tmp_path / "home"))
    datasets = pytest.importorskip("datasets")
    found = datasets.load_dataset(str(finished.out), cache_dir=str(tmp_path / "cache"))
    assert {split: len(part) for split, part in found.items()} == {"train": 6, "val": 3}
    for row in rows(finished.out):
        same = [line for line in found[row["split"]] if line["raw"] == row["raw"]]
        assert [line["view"] for line in same] == [row["view"]]
        for kind in ("dark", "lit"):
            assert np.array_equal(np.asarray(same[0][kind]), read_codes(finished.out / row[kind]))


@pytest.mark.filterwarnings("ignore")
def test_webdataset_reads_every_sample_of_the_shards(finished: Any) -> None:
    webdataset = pytest.importorskip("webdataset")
    shards = sorted(map(str, (finished.out / "shards").glob("*.tar")))
    found = list(webdataset.WebDataset(shards, shardshuffle=False).decode("rgb8"))
    expected = sorted(rows(finished.out), key=lambda row: row["split"])
    assert len(found) == len(expected)
    for sample, row in zip(found, expected, strict=True):
        assert np.array_equal(sample["lit.png"], read_codes(finished.out / row["lit"]))
        assert sample["truth.exr"] == (finished.out / row["truth"]).read_bytes()
        assert (sample["json"]["view"], sample["json"]["capture"]) == (row["view"], row["capture"])
