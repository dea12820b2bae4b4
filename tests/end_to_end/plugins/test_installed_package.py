"""Rows of an installed package take part like ours, name where they come from, and a broken package harms nothing."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

TINY = ("--views", "9", "--width", "24", "--height", "24", "--spp", "4", "--points", "60", "--iterations", "5")
Novags = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def novags(site: Path, tmp_path: Path) -> Novags:
    """Runs a command in a process that sees the packages."""

    def run(*words: str, code: int = 0) -> "subprocess.CompletedProcess[str]":
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), *sys.path])}
        done = subprocess.run([sys.executable, "-m", "novags", *words], cwd=tmp_path, env=environment,
                              capture_output=True, text=True)  # fmt: skip
        assert done.returncode == code, done.stderr
        return done

    return run


def test_a_method_of_a_package_is_listed_run_by_two_workers_and_reported_with_its_origin(
    novags: Novags, tmp_path: Path, site: Path
) -> None:
    listed = novags("list")
    assert "times a factor (from their-package 1.2)" in " ".join(listed.stdout.split())
    assert "Their room (from their-package 1.2)" in listed.stdout
    assert "broken_package:METHOD of broken-package 0.1 cannot be used (ModuleNotFoundError" in listed.stderr
    assert "broken-package 0.1 names a row '../escape'" in listed.stderr
    assert "their-package 1.2 has a row 'naive' in novags.methods, as novags has: that one is used" in listed.stderr
    request = ("run", "--scene", "cornell", "--methods", "naive", "theirs", "--out", "out", *TINY)
    novags(*request, "--workers", "2")
    record = json.loads((tmp_path / "out" / "theirs" / "run.json").read_text())
    assert record["title"].endswith("(from their-package 1.2)")
    assert record["stage"]["versions"]["their-package"] == "1.2"
    ours = json.loads((tmp_path / "out" / "naive" / "run.json").read_text())
    assert "their-package" not in ours["stage"]["versions"]
    assert "(from their-package 1.2)" in (tmp_path / "out" / "report.html").read_text()
    # Another constant of theirs is another code: their run is made again, and ours is not.
    (site / "their_package" / "factor.py").write_text("FACTOR = 4.0\n")
    again = novags(*request, "--dry-run").stderr
    assert "reconstruct naive: unchanged, kept out/naive" in again
    assert "out/theirs: their_package/factor.py has changed" in again
    # Without the package the results are still there to be seen; nothing takes their place.
    shutil.rmtree(site)
    assert "out/theirs cannot be scored: unknown enhancer 'times'" in novags("score", "out/theirs", code=2).stderr
    novags("report", "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "(from their-package 1.2)" in page
    assert all(f"<dt>{row}</dt>" in page for row in ("method theirs", "enhancer times"))


def test_a_scene_of_a_package_is_rendered_and_its_set_says_whose_it_is(novags: Novags, tmp_path: Path) -> None:
    novags("render", "their-room", "--out", "set", *TINY[:8])
    assert json.loads((tmp_path / "set" / "set.json").read_text())["stage"]["versions"]["their-package"] == "1.2"


def test_a_broken_row_is_named_when_it_is_asked_for(novags: Novags) -> None:
    done = novags("run", "--methods", "broken", "--out", "out", *TINY, code=2)
    assert "broken_package:METHOD of broken-package 0.1 cannot be used" in done.stderr
    assert "Traceback" not in done.stderr
