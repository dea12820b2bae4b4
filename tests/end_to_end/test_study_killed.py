"""A study killed at random moments ends with the tables and the store of one that was left alone."""

import csv
import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.study.results import COSTS

STUDY = """
[grid]
scene = ["cornell", "tabletop", "tabletop:1"]
electrons = [5, 20, 80]
method = ["naive", "nova-fast"]
seed = [0, 1]
"""
MORE = """
denoiser_steps = 3
fit.checkpoint_every = 10
"""
KILLS = 10


def start(folder: Path, study: str) -> "subprocess.Popen[bytes]":
    folder.mkdir(exist_ok=True)
    (folder / "study.toml").write_text(study)
    root = Path(__file__).resolve().parents[2]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    with (folder / "log").open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "novags", "study", "study.toml", "--out", "out"], cwd=folder, stdout=log, stderr=log,
            env=environment,
        )  # fmt: skip


def files(folder: Path) -> list[Path]:
    return [path for path in (folder / "store").rglob("*") if path.is_file()] if (folder / "store").exists() else []


def tables(folder: Path) -> tuple[Any, Any]:
    """Both tables without what differs from one time to the next."""
    rows = json.loads((folder / "out" / "results.json").read_text())["rows"]
    with (folder / "out" / "results.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    return tuple(
        [{k: v for k, v in row.items() if not k.startswith(COSTS)} for row in found] for found in (rows, lines)
    )  # type: ignore[return-value]


def store(folder: Path, without_costs: Callable[[Any], Any]) -> dict[str, object]:
    """Everything in the store, but for costs."""
    return {path.relative_to(folder).as_posix(): content(path, without_costs) for path in files(folder)}


def content(path: Path, without_costs: Callable[[Any], Any]) -> object:
    if path.name == ".sealed.json":  # hashes of records, which hold costs
        return sorted(json.loads(path.read_text())["records"])
    return without_costs(json.loads(path.read_text())) if path.suffix == ".json" else path.read_bytes()


@pytest.mark.slow
def test_a_study_of_36_runs_killed_ten_times_ends_the_same(
    tmp_path: Path, smallest: str, without_costs: Callable[[Any], Any]
) -> None:
    whole, killed, study = tmp_path / "whole", tmp_path / "killed", STUDY + smallest + MORE
    assert start(whole, study).wait() == 0, (whole / "log").read_text()
    count = len(files(whole))
    moments = sorted(random.Random(0).sample(range(count), KILLS))
    for moment in moments:
        process = start(killed, study)
        while len(files(killed)) < moment and process.poll() is None:
            time.sleep(0.05)
        assert process.poll() is None, (killed / "log").read_text()
        process.kill()
        process.wait()
    assert start(killed, study).wait() == 0, (killed / "log").read_text()
    assert {row["state"] for row in tables(whole)[0]} == {"done"}
    assert tables(killed) == tables(whole)
    assert store(killed, without_costs) == store(whole, without_costs)
