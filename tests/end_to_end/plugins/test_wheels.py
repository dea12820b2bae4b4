"""Wheels of novags, of a package of somebody else and of a broken one work in an environment of their own.

Beside this, `test_installed_package.py` has the claims that need no wheel, on a folder laid out as pip installs one.
"""

import json
import os
import re
import subprocess
import sys
import sysconfig
import venv
from importlib.util import find_spec
from pathlib import Path

import pytest

from novags.commands.new import template
from tests.end_to_end.plugins.tree import copy_of_the_tree

PROJECT = """
[build-system]
requires = ["setuptools>=68"]
build-backend = "setuptools.build_meta"
[project]
name = "{name}"
version = "1.2"
[project.entry-points."novags.methods"]
{row} = "{module}:METHOD"
"""
STUDY = """
preset = "demo"
[grid]
scene = ["cornell"]
electrons = [5, 50]
method = ["naive", "theirs", "soft"]
[override]
views = 9
width = 24
height = 24
spp = 4
points = 60
iterations = 5
[variant.soft]
method = "theirs"
gamma = 0.8
"""
TINY = ("--views", "9", "--width", "24", "--height", "24", "--spp", "4", "--points", "60", "--iterations", "5")
ORIGIN = "(from their-package 1.2)"
BROKEN = "broken_module:METHOD of broken-package 1.2 cannot be used (ImportError: it needs what nobody has)"


def built(folder: Path, name: str, row: str, code: str) -> Path:
    """A project of one module."""
    module = f"{row}_module"
    (folder / name).mkdir()
    (folder / name / f"{module}.py").write_text(code)
    (folder / name / "pyproject.toml").write_text(PROJECT.format(name=name, row=row, module=module))
    return folder / name


@pytest.fixture
def python(tmp_path: Path) -> Path:
    """An environment that has novags and both packages from wheels; it borrows the dependencies of this one."""
    # An environment of scripts/setup has both. Others, as of uv, may have neither, and there may be no network.
    if find_spec("pip") is None or find_spec("setuptools") is None:
        pytest.skip("pip or setuptools, which build the wheels, is not installed")
    copy_of_the_tree(tmp_path / "tree")
    theirs = built(tmp_path, "their-package", "theirs", re.sub(r"\nPLUGIN = .*\n$", "", template("method")))
    broken = built(tmp_path, "broken-package", "broken", 'raise ImportError("it needs what nobody has")\n')
    projects = [tmp_path / "tree", theirs, broken]
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", tmp_path, *projects], check=True)
    venv.create(tmp_path / "own", symlinks=True)
    (site,) = (tmp_path / "own").glob("lib/python*/site-packages")
    wheels = sorted(tmp_path.glob("*.whl"))
    assert len(wheels) == 3
    subprocess.run([*pip, "install", "--no-deps", "--no-index", "--target", site, *wheels], check=True)
    # A folder that a .pth file names is searched, and the .pth file in it, of the editable novags, is not read.
    (site / "needed.pth").write_text(sysconfig.get_path("purelib"))
    return tmp_path / "own" / "bin" / "python"


@pytest.mark.slow  # builds three wheels, and compiles the kernels anew
def test_a_method_of_a_wheel_is_listed_run_studied_and_reported_by_its_origin(python: Path, tmp_path: Path) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["PYTHONSAFEPATH"] = "1"
    far = tmp_path / "far"
    far.mkdir()
    (far / "tiny.toml").write_text(STUDY)

    def novags(*words: str) -> "subprocess.CompletedProcess[str]":
        done = subprocess.run([python, "-m", "novags", *words], cwd=far, env=environment, capture_output=True,
                              text=True)  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert done.stderr.count(BROKEN) <= 1
        return done

    listed = novags("list", "methods")
    assert BROKEN in listed.stderr
    assert ORIGIN in " ".join(listed.stdout.split())
    novags("run", "--scene", "cornell", "--methods", "naive", "theirs", "--out", "out", *TINY)
    record = json.loads((far / "out" / "theirs" / "run.json").read_text())
    assert record["title"].endswith(ORIGIN)
    assert record["stage"]["versions"]["their-package"] == "1.2"
    assert record["stage"]["versions"]["novags"]
    novags("study", "tiny.toml", "--out", "many", "--workers", "2")
    assert {row["state"] for row in json.loads((far / "many" / "results.json").read_text())["rows"]} == {"done"}
    for folder in ("out", "many"):
        novags("report", folder)
        page = (far / folder / "report.html").read_text()
        assert ORIGIN in page
        assert "These runs were not made alike" not in page
        assert 'data-block="absent"' not in page
