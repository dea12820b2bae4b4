"""Who adds a row of every kind to a copy of the tree, as the pages say, meets no test that fails."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from novags.commands.new import template

ROOT = Path(__file__).resolve().parents[3]
# Kind, the new file, the table, and the line in it.
ADDED = (
    ("method", "novags/methods/rivals/rows/gamma.py", "novags/methods/__init__.py",
     '"gamma": "novags.methods.rivals.rows.gamma:METHOD"'),
    ("enhancer", "novags/methods/enhancers/rows/root.py", "novags/methods/enhancers/__init__.py",
     '"root": "novags.methods.enhancers.rows.root:ENHANCER"'),
    ("camera", "novags/cameras/sources/turntable.py", "novags/cameras/__init__.py",
     '"turntable": "novags.cameras.sources.turntable:SOURCE"'),
    ("scene", "simscenes/scenes/shelf.py", "simscenes/scenes/__init__.py", '"shelf": "simscenes.scenes.shelf:SHELF"'),
    ("metric", "novags/testbed/metrics/mae.py", "novags/testbed/metrics/__init__.py",
     '"mae": "novags.testbed.metrics.mae:METRIC"'),
)  # fmt: skip


def copy_of_the_tree(folder: Path) -> None:
    """The files that git knows, as they are."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in listed.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)


def add(folder: Path, kind: str, file: str, table: str, line: str) -> None:
    """One file, and one line at the end of the rows of a table."""
    (folder / file).write_text(re.sub(r"\n\nPLUGIN = .*\n$", "\n", template(kind)))
    text = (folder / table).read_text()
    rows = list(re.finditer(r'^( +)"[\w-]+": "[\w.]+:\w+",\n', text.partition("VARIANTS")[0], re.M))
    last = rows[-1]
    (folder / table).write_text(f"{text[: last.end()]}{last[1]}{line},\n{text[last.end() :]}")


@pytest.mark.slow  # the whole default suite, in a copy
def test_the_default_suite_passes_after_an_addition_of_each_kind(tmp_path: Path) -> None:
    copy_of_the_tree(tmp_path)
    for addition in ADDED:
        add(tmp_path, *addition)
    subprocess.run(["git", "add", "-A"], cwd=tmp_path, check=True)
    done = subprocess.run([sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile"], cwd=tmp_path,
                          capture_output=True, text=True)  # fmt: skip
    assert done.returncode == 0, done.stdout[-10_000:]
