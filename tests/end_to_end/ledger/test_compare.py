"""Claims about `novags compare`, on tiny pictures: equal sides give equal bits, a change that is known is seen."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.study.versions.sides import PACKAGES, ROOT

Call = Callable[..., int]
SHORT = ("--points", "300", "--iterations", "30", "--device", "cpu")
SINGLE = ("--seeds", "0", *SHORT)


@pytest.fixture
def place(experiment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the experiment, beside which commands run."""
    shutil.copytree(experiment, tmp_path / "exp")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def found(folder: Path, method: str = "naive") -> dict[str, Any]:
    return dict(json.loads((folder / "compare.json").read_text())["methods"][method])


def times(folder: Path) -> dict[str, int]:
    return {path.parent.name + path.parent.parent.name: path.stat().st_mtime_ns for path in folder.rglob("run.json")}


def test_the_same_method_twice_shows_the_same_pictures_and_a_second_time_keeps_them(
    place: Path, call: Call, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("compare", "naive", "naive", "--captures", "exp", "--out", "out", *SINGLE)
    assert call(*words) == 0
    assert "changed (naive) shows the same pictures as base (naive), bit for bit." in capsys.readouterr().out
    first, made = found(Path("out")), times(Path("out"))
    assert len(made) == 2
    (pair,) = first["pairs"]
    assert pair["same"]
    assert first["cost"]["base"]["cpu_seconds"] > 0
    assert (Path("out") / "compare.csv").read_text().splitlines()[1].startswith("naive,")
    assert call(*words) == 0
    assert times(Path("out")) == made
    assert found(Path("out")) == first


def checkout(folder: Path) -> Path:
    """A copy of our sources."""
    for name in PACKAGES:
        shutil.copytree(Path(ROOT, name), folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


@pytest.mark.slow
def test_a_change_in_a_checkout_is_seen_and_its_side_alone_is_made_again(
    place: Path, call: Call, capsys: pytest.CaptureFixture[str]
) -> None:
    checkout(Path("one"))
    file = checkout(Path("two")) / "novags" / "splats" / "gaussians.py"
    words = ("compare", "one", "two", "--methods", "naive", "--captures", "exp/naive", "--out", "out", *SINGLE)
    assert call(*words) == 0
    assert found(Path("out"))["same_pictures"]
    made, whole = times(Path("out")), file.read_text()
    assert whole.count("torch.tensor(init_opacity)") == 1
    file.write_text(whole.replace("torch.tensor(init_opacity)", "torch.tensor(0.02)"))
    call(*words)
    told, after = found(Path("out")), times(Path("out"))
    assert not told["same_pictures"]
    (pair,) = told["pairs"]
    assert pair["code"][0] != pair["code"][1]
    assert {name for name in made if made[name] != after[name]} == {name for name in made if name.endswith("changed")}
    file.write_text(f"{whole}\nraise ValueError('planted')\n")
    capsys.readouterr()
    assert call(*words) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "changed (two): " in said
    assert "planted" in said


@pytest.mark.slow
def test_fewer_iterations_are_seen_to_be_below_on_captures_that_are_made_with_the_exit_code_that_says_so(
    tmp_path: Path, call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    small = {"width": 24, "height": 24, "views": 17, "spp": 8}
    monkeypatch.setattr("novags.testbed.study.versions.pairs.SMALL", small)
    words = ("compare", "naive", "short", "--variant", "short=naive:fit.iterations=1", "--out", "out", *SHORT,
             "--scenes", "cornell", "busts", "bookshop")  # fmt: skip
    assert call(*words, "--dry-run") == 0
    assert "6 pairs of fits, of 6 captures" in capsys.readouterr().err
    assert not Path("out").exists()
    assert call(*words) == 3
    told = found(Path("out"))
    assert told["headline"].startswith("changed (short) is below base (naive) by ")
    whole = [row for row in told["scores"] if row["scene"] == "all scenes"]
    assert [(row["scenes"], row["seeds"], row["views"]) for row in whole] == [(3, 2, 3)] * 2
    assert all(row["low"] < row["difference"] < row["high"] < 0 for row in whole)
    assert told["log_cpu_ratio"]["value"] < 0 < told["log_cpu_ratio"]["error"]
    assert {pair["noise"] for pair in told["pairs"]} == {"0", "1"}
    assert len(times(Path("out"))) == 12
