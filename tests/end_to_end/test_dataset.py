"""A tiny data set by its command: what it holds, that it says so truly, and that nothing is done twice."""

import csv
import hashlib
import json
import re
import sys
import tarfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from novags.commands.dataset import dataset
from novags.testbed.console.terminal import Console
from novags.testbed.dataset.file import read_dataset
from novags.testbed.dataset.forecast import forecast
from novags.testbed.dataset.shards import MEMBERS, remove_shards
from novags.testbed.folders.capture import open_capture
from novags.testbed.ledger.store import costs
from novags.testbed.study.costs import Costs
from novags.testbed.study.engines.choice import OneMachine
from novags.testbed.study.plan import plan_of
from novags.testbed.viewer.light import ViewerCamera
from sensor_model.files.toml_file import read_toml
from simscenes.sets.pictures.png import read_png

TRAINING_LOOP = Path(__file__).resolve().parents[2] / "docs" / "examples" / "training_loop.py"
FILE = """
[dataset]
name = "dark-balls"
licence = "CC-BY-4.0"
description = "Balls in the dark"
creators = ["Jane Doe"]
shard_mb = 0.2
[dataset.split]
val = ["two.xml"]
train = 1
[grid]
scene = ["one.xml", "two.xml"]
electrons = [5, 50]
[override]
views = 4
width = 24
height = 24
spp = 4
render.variant = "scalar"
"""
BALL = """<scene version="3.0.0">
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
  </sensor>
  <emitter type="constant"/>
  <shape type="sphere"><bsdf type="diffuse"><rgb name="reflectance" value="{color}"/></bsdf></shape>
</scene>
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a data set in data/."""
    folder = tmp_path_factory.mktemp("dataset")
    (folder / "data.toml").write_text(FILE)
    (folder / "one.xml").write_text(BALL.format(color="0.8,0.2,0.1"))
    (folder / "two.xml").write_text(BALL.format(color="0.1,0.3,0.8"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("signal.signal", lambda *_: None)  # pytest keeps its own handlers
        dataset(folder / "data.toml", out=folder / "data", workers=1)
    return folder


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def rows(place: Path) -> list[dict[str, str]]:
    with (place / "data" / "index.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_view_is_in_the_index_and_no_scene_in_two_splits(place: Path) -> None:
    found = rows(place)
    assert len(found) == 2 * 2 * 4
    assert {(row["split"], row["scene"]) for row in found} == {("train", "one.xml"), ("val", "two.xml")}
    for row in found:
        assert all((place / "data" / row[kind]).is_file() for kind in ("dark", "dark16", "raw", "truth", "lit", "gt"))
    capture = open_capture(place / "data" / found[0]["capture"])
    assert capture.record.simulated.electrons == 5
    source = capture.source(Console(quiet=True))  # the set is found beside it, wherever the data set lies
    assert source.views.path.resolve() == (place / "data" / found[0]["set"]).resolve()
    assert np.array_equal(source.lit(0), read_png(place / "data" / found[0]["lit"]))


def test_the_manifest_names_every_file_with_its_checksum_and_what_was_simulated(place: Path) -> None:
    data = place / "data"
    manifest = json.loads((data / "manifest.json").read_text())
    there = {path.relative_to(data).as_posix() for path in data.rglob("*") if path.is_file()}
    own = {name for name in there if not any(part.startswith(".") for part in name.split("/"))}
    assert set(manifest["files"]) == {name for name in own if not name.startswith("making/")} - {"manifest.json"}
    assert all(sha256(data / name) == facts["sha256"] for name, facts in manifest["files"].items())
    assert manifest["licence"] == "CC-BY-4.0"
    assert manifest["file"] == read_toml(place / "data.toml")
    assert manifest["seeds"] == [0]
    assert manifest["splits"] == {"train": ["one.xml"], "val": ["two.xml"], "test": []}
    assert manifest["cost"]["seconds"] == pytest.approx(sum(e["cost"]["seconds"] for e in manifest["entries"]))
    captures = [entry for entry in manifest["entries"] if entry["kind"] == "capture"]
    assert [entry["electrons"] for entry in captures] == [5, 50, 5, 50]
    for entry in manifest["entries"]:
        assert entry["cost"]["seconds"] > 0
        assert entry["simulation"]["on"]
        assert all(reason for reason in entry["simulation"]["off"].values())
    assert "photon_shot" in captures[0]["simulation"]["on"]
    card = (data / "README.md").read_text()
    assert card.startswith('---\nlicense: "cc-by-4.0"\n')
    assert "| train | one.xml | 2 | 8 |" in card
    assert "Balls in the dark" in card
    assert "no photograph" not in card  # textures of scene files may be photographs


def test_shards_are_forecast_with_a_copy_of_the_set_in_every_capture(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of entries that hold pictures alone: of such small ones, points take most of the disk."""
    (place / "more.toml").write_text(
        FILE.replace("[5, 50]", str([*range(5, 17)])).replace(', "two.xml"]', "]").replace('val = ["two.xml"]', "")
    )
    study, config = read_dataset(place / "more.toml")
    plan = plan_of(study, place / "store", Console(quiet=True))
    sizes = {kind: sum((place / "data" / row[kind]).stat().st_size for row in rows(place)[:4]) for kind in MEMBERS}
    lit = sizes["lit"] + sizes["gt"]
    of = {"set": lit, "capture": sum(sizes.values()) - lit}
    entries = [{**entry, "bytes": of[entry["kind"]]} for entry in costs(place / "store")]
    monkeypatch.setattr("novags.testbed.dataset.forecast.costs", lambda store: entries)
    said = forecast(plan, config, {"one.xml": "train"}, place / "store", place / "data", OneMachine.shared(12, 1))
    found = re.search(r"beside the store it takes ([0-9.]+) MB \(links, and shards\)", said)
    assert found is not None, said
    assert float(found[1]) * 1e6 == pytest.approx(12 * sum(sizes.values()), rel=0.3)


def test_no_two_captures_share_their_noise(place: Path) -> None:
    captures = [open_capture(place / "data" / name) for name in dict.fromkeys(row["capture"] for row in rows(place))]
    noise = [(c.raw(0) - c.truth(0, "mean")) / np.sqrt(c.truth(0, "variance")) for c in captures]
    shared = np.corrcoef([part.ravel() for part in noise])[np.triu_indices(len(noise), 1)]
    assert np.abs(shared).max() < 5 / np.sqrt(noise[0].size)
    assert {c.record.simulated.seed for c in captures} == {0}
    manifest = json.loads((place / "data" / "manifest.json").read_text())
    told = [entry["noise_seed"] for entry in manifest["entries"] if entry["kind"] == "capture"]
    assert [c.record.simulated.noise_seed for c in captures] == told
    assert len(set(told)) == 4
    assert ViewerCamera.of(captures[1], captures[1].source(Console(quiet=True))).seed == told[1]
    assert {row["noise_seed"] for row in rows(place)} == set(map(str, told))
    assert "No two captures share" in (place / "data" / "README.md").read_text()


def test_shards_hold_the_files_themselves_each_sample_whole_and_bytes_without_a_date(place: Path) -> None:
    data = place / "data"
    shards = sorted((data / "shards").glob("*.tar"))
    assert len(shards) > 2  # of 0.2 MB
    assert {shard.name.partition("-")[0] for shard in shards} == {"train", "val"}
    samples: dict[str, dict[str, bytes]] = {}
    for shard in shards:
        with tarfile.open(shard) as tar:
            for member in tar:
                assert (member.mtime, member.uid, member.gid, member.uname, member.mode) == (0, 0, 0, "", 0o644)
                key, _, kind = member.name.partition(".")
                opened = tar.extractfile(member)
                assert opened is not None
                samples.setdefault(key, {})[kind] = opened.read()
    assert len(samples) == 16
    for row, (_, sample) in zip(rows(place), sorted(samples.items()), strict=True):
        assert sample["dark.png"] == (data / row["dark"]).read_bytes()
        assert sample["gt.exr"] == (data / row["gt"]).read_bytes()
        about = json.loads(sample["json"])
        assert (about["view"], about["split"]) == (row["view"], row["split"])
        assert about["electrons"] == float(row["electrons"])
        assert np.shape(about["viewmat"]) == (4, 4)


def test_the_same_command_does_nothing_again_and_mends_what_is_damaged(
    place: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("dataset", str(place / "data.toml"), "--out", str(place / "data"), "--workers", "1")
    files = [path for path in (place / "store").rglob("*") if path.is_file() and not path.name.endswith(".lock")]
    files += (place / "data").rglob("*.tar")
    before = {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in files}
    sums = json.loads((place / "data" / "manifest.json").read_text())["files"]
    damaged = place / "data" / rows(place)[3]["dark"]
    whole = damaged.read_bytes()
    damaged.unlink()  # a link: the store keeps its own
    damaged.write_bytes(b"damaged")
    (place / "data" / "manifest.json").unlink()
    others = [place / "data" / "train" / name for name in (".DS_Store", "set/.DS_Store", "capture/mine/notes.txt")]
    for other in others:  # those of a file manager, or of the user: neither part of the data set nor in its way
        other.parent.mkdir(exist_ok=True)
        other.write_text("mine")
    earlier = place / "data" / "train" / "set" / f"earlier-{'0f' * 8}"
    earlier.mkdir()
    assert call(*words) == 0
    assert not earlier.exists()
    assert [other.read_text() for other in others] == ["mine"] * 3
    assert damaged.read_bytes() == whole
    assert {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in before} == before
    assert json.loads((place / "data" / "manifest.json").read_text())["files"] == sums
    capsys.readouterr()
    assert call(*words, "--dry-run") == 0
    said = capsys.readouterr().out
    assert "4 captures = 2 scene x 2 electrons x 1 seed" in said
    assert re.search(r"capture +4 +4 +0", said)
    assert "train      1 scenes: one.xml" in said
    assert "data set dark-balls: about" in said


def test_another_data_set_or_somebody_elses_files_are_not_replaced(
    place: Path, tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    (place / "other.toml").write_text(FILE.replace("[5, 50]", "[7]"))
    assert call("dataset", str(place / "other.toml"), "--out", str(place / "data"), "--dry-run") == 2
    assert "finished runs" in capsys.readouterr().err
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "README.md").write_text("mine")
    assert call("dataset", str(place / "data.toml"), "--out", str(tmp_path / "mine")) == 2
    assert "already holds README.md" in capsys.readouterr().err
    assert (tmp_path / "mine" / "README.md").read_text() == "mine"


@pytest.mark.parametrize(("store", "said"), [("s3://bucket/store", "not a URL"), ("data.toml", "a file, not a folder")])
def test_a_store_that_is_no_folder_is_refused_and_none_of_its_name_is_made(
    store: str, said: str, tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    (tmp_path / "data.toml").write_text('[dataset]\nname="a"\nlicence="x"\n[grid]\nscene=["cornell", "studio"]')
    monkeypatch.chdir(tmp_path)
    assert call("dataset", "data.toml", "--out", "data", "--store", store, "--engine", "ray") != 0
    assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["data.toml"]


def test_croissant_says_where_the_records_are_and_their_checksums(place: Path) -> None:
    found = json.loads((place / "data" / "croissant.json").read_text())
    assert found["conformsTo"] == "http://mlcommons.org/croissant/1.0"
    objects = {part["@id"]: part for part in found["distribution"] if part["@type"] == "cr:FileObject"}
    assert all(part["sha256"] == sha256(place / "data" / name) for name, part in objects.items())
    assert objects["index.csv"]["encodingFormat"] == "text/csv"
    fields = found["recordSet"][0]["field"]
    assert [field["name"] for field in fields] == list(rows(place)[0])
    columns = {field["name"]: field["source"]["extract"]["column"] for field in fields}
    # Readers take a column 0000, 0001 for numbers: the name of a view comes from its path.
    assert columns == {name: "dark" if name == "view" else name for name in columns}
    (view,) = (field["source"] for field in fields if field["name"] == "view")
    for row in rows(place):
        assert re.sub(view["transform"]["regex"], r"\1", row["dark"]) == row["view"]


def test_the_training_loop_of_the_page_reads_it_and_learns(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code = TRAINING_LOOP.read_text(encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["train.py", str(place / "data")])
    exec(code, {"__name__": "__main__"})
    losses = [float(line.split()[3].rstrip(",")) for line in capsys.readouterr().out.splitlines()]
    assert len(losses) == 20
    assert losses[-1] < 0.7 * losses[0]


def test_made_again_without_shards_it_keeps_none_and_what_somebody_put_there_stays(
    place: Path, call: Callable[..., int]
) -> None:
    shards = place / "again" / "shards"
    shards.mkdir(parents=True)
    for name in ("train-000007.tar", "mine.tar", ".shards.json"):
        (shards / name).write_text("{}")
    (place / "again.toml").write_text(FILE.replace("[5, 50]", "[5]").replace("shard_mb = 0.2", ""))
    out = ("--out", str(place / "again"), "--workers", "1", "--overwrite")
    assert call("dataset", str(place / "again.toml"), *out) == 0
    assert [path.name for path in shards.iterdir()] == ["mine.tar"]
    (shards / "mine.tar").unlink()
    remove_shards(place / "again")
    assert not shards.exists()


PICTURES = """
[dataset]
name = "cornells"
licence = "CC-BY-4.0"
split = { train = 1 }
[grid]
scene = ["cornell"]
sensor = ["a7s2-iso6400-3chip", "a7s2-iso6400"]
[override]
views = 8
width = 64
height = 64
spp = 2
"""


def test_the_disk_of_sets_and_captures_is_forecast_within_a_fifth(tmp_path: Path) -> None:
    (tmp_path / "data.toml").write_text(PICTURES)
    study, _ = read_dataset(tmp_path / "data.toml")
    said = Costs()  # of an empty store
    expected = {task.kind + task.group: said.predicted(task).disk
                for task in plan_of(study, tmp_path / "store", Console(quiet=True)).tasks.values()}  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("signal.signal", lambda *_: None)  # pytest keeps its own handlers
        dataset(tmp_path / "data.toml", out=tmp_path / "data", workers=1)
    found = {entry["kind"] + entry["group"]: entry["bytes"] for entry in costs(tmp_path / "store")}
    assert len(found) == 3
    assert {name: size / expected[name] for name, size in found.items()} == pytest.approx(
        dict.fromkeys(found, 1.0), abs=0.2
    )
