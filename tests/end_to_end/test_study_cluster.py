"""A tiny study on a Ray cluster of two nodes ends with the tables and entries of one machine, bit for bit."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.console.cores import cores_here
from novags.testbed.study.results import COSTS

pytest.importorskip("ray")
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:::ray")]
ROOT = Path(__file__).resolve().parents[2]
DATASET = """
[dataset]
name = "dark-boxes"
licence = "CC-BY-4.0"
description = "Boxes in the dark"
creators = ["Jane Doe"]
shard_mb = 0.2
split_by = "variation"
[dataset.split]
val = ["cornell:1"]
train = 1
[grid]
scene = ["cornell:0", "cornell:1"]
electrons = [5, 20]
[override]
views = 4
width = 24
height = 24
spp = 4
render.variant = "scalar"
"""
GRID = """
[grid]
scene = "cornell"
electrons = [5, 20]
method = ["naive", "nova-fast"]
"""


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    from ray.cluster_utils import Cluster

    small = {"num_cpus": 1, "object_store_memory": 80 << 20}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), *filter(None, sys.path)]))
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        cluster = Cluster(initialize_head=True, head_node_args={**small, "include_dashboard": False})
        cluster.add_node(**small)
        yield cluster.address
        cluster.shutdown()


def novags(folder: Path, *words: str) -> None:
    """Run a command in a folder."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)])}
    command = [sys.executable, "-m", "novags", *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def study(smallest: str) -> Callable[..., None]:
    """A function that runs `novags study` in a folder."""

    def run(folder: Path, *words: str) -> None:
        folder.mkdir(exist_ok=True)
        (folder / "study.toml").write_text(GRID + smallest + "denoiser_steps = 3\n")
        novags(folder, "study", "study.toml", "--out", "out", *words)

    return run


def rows(folder: Path) -> list[dict[str, Any]]:
    """The table without costs and places."""
    found = json.loads((folder / "out" / "results.json").read_text())["rows"]
    return [{k: v for k, v in row.items() if not k.startswith((*COSTS, "folder"))} for row in found]


@pytest.fixture
def entries(without_costs: Callable[[Any], Any]) -> Callable[[Path], dict[str, object]]:
    """A function that reads everything in a store but costs."""

    def content(path: Path) -> object:
        return without_costs(json.loads(path.read_text())) if path.suffix == ".json" else path.read_bytes()

    def read(store: Path) -> dict[str, object]:
        paths = [path for path in store.rglob("*") if path.is_file() and not path.name.startswith(".")]
        return {path.relative_to(store).as_posix(): content(path) for path in paths}

    return read


def test_a_cluster_gives_the_same_bits_as_one_machine_in_a_common_folder_and_at_a_url(
    address: str, study: Callable[..., None], entries: Callable[[Path], dict[str, object]], tmp_path: Path
) -> None:
    study(tmp_path / "local", "--workers", str(cores_here()))  # one thread each
    whole = entries(tmp_path / "local" / "store")
    assert len(rows(tmp_path / "local")) == 4
    cluster = ("--engine", "ray", "--address", address)
    study(tmp_path / "shared", *cluster)
    assert rows(tmp_path / "shared") == rows(tmp_path / "local")
    assert entries(tmp_path / "shared" / "store") == whole
    at_url = (*cluster, "--store", f"file://{tmp_path}/bucket", "--scratch", str(tmp_path / "scratch"))
    study(tmp_path / "url", *at_url)
    assert rows(tmp_path / "url") == rows(tmp_path / "local")
    assert entries(tmp_path / "bucket") == whole
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "bucket").rglob("*")}
    study(tmp_path / "again", *cluster, "--store", f"file://{tmp_path}/bucket", "--scratch", str(tmp_path / "other"))
    assert rows(tmp_path / "again") == rows(tmp_path / "local")
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "bucket").rglob("*")} == before
    assert not (tmp_path / "other").exists()  # seals and scores were enough


def test_a_data_set_made_on_a_cluster_has_the_files_of_one_machine(address: str, tmp_path: Path) -> None:
    def sums(name: str, *words: str) -> dict[str, str]:
        (tmp_path / name).mkdir()
        (tmp_path / name / "data.toml").write_text(DATASET)
        novags(tmp_path / name, "dataset", "data.toml", "--out", "data", *words)
        listed = json.loads((tmp_path / name / "data" / "manifest.json").read_text())["files"]
        kept = {path for path in listed if not path.endswith((".json", "README.md"))}  # those say what it took
        return {path: listed[path]["sha256"] for path in kept}

    local = sums("local", "--workers", str(cores_here()))
    assert len({Path(path).parts[0] for path in local} & {"train", "val", "shards"}) == 3
    assert sums("cluster", "--engine", "ray", "--address", address) == local
