"""Who adds a row of every kind to a copy of the tree, as the pages say, meets no test that fails."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from novags.commands.new import Kind, template
from tests.end_to_end.plugins.tree import copy_of_the_tree

METHODS = "novags/methods/__init__.py"
# Kind, the new file, and the line of each table.
ADDED = (
    ("method", "novags/methods/rivals/rows/gamma.py", {METHODS: '"gamma": "novags.methods.rivals.rows.gamma:METHOD"'}),
    ("enhancer", "novags/methods/enhancers/rows/root.py",
     {"novags/methods/enhancers/__init__.py": '"root": "novags.methods.enhancers.rows.root:ENHANCER"',
      METHODS: '"root-gs": "novags.methods.enhancers.rows.root:METHOD"'}),
    ("camera", "novags/cameras/sources/turntable.py",
     {"novags/cameras/__init__.py": '"turntable": "novags.cameras.sources.turntable:SOURCE"'}),
    ("scene", "simscenes/scenes/shelf.py",
     {"simscenes/scenes/__init__.py": '"shelf": "simscenes.scenes.shelf:SHELF"'}),
    ("metric", "novags/testbed/metrics/mae.py",
     {"novags/testbed/metrics/__init__.py": '"mae": "novags.testbed.metrics.mae:METRIC"'}),
    ("effect", "sensor_model/frame/glow.py",
     {"sensor_model/effect_list.py": '"glow": "sensor_model.frame.glow:EFFECT"'}),
    ("study", "docs/studies/mine.toml", {}),
)  # fmt: skip


def add(folder: Path, kind: str, file: str, lines: dict[str, str]) -> None:
    """One file, and one line at the end of the rows of each table."""
    (folder / file).write_text(re.sub(r"\n\nPLUGIN = .*\n$", "\n", template(kind)))
    for table, line in lines.items():
        text = (folder / table).read_text()
        end = re.search(r"^( *)\}.*\n", text, re.M)  # of the table, the first of the file
        assert end is not None
        (folder / table).write_text(f"{text[: end.start()]}{end[1]}    {line},\n{text[end.start() :]}")


def with_additions(folder: Path) -> None:
    """The tree with an addition of each kind, and the pages made again, as the page on each says."""
    copy_of_the_tree(folder)
    for addition in ADDED:
        add(folder, *addition)
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    subprocess.run([sys.executable, "scripts/make_docs.py", "--cheap"], cwd=folder, check=True, env=environment)
    subprocess.run(["git", "add", "-A"], cwd=folder, check=True)


@pytest.mark.slow  # the whole default suite, in a copy
def test_the_default_suite_passes_after_an_addition_of_each_kind(tmp_path: Path) -> None:
    assert {kind for kind, *_ in ADDED} == set(get_args(Kind))
    with_additions(tmp_path)
    done = subprocess.run([sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile"], cwd=tmp_path,
                          capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(tmp_path)})  # fmt: skip
    assert done.returncode == 0, done.stdout[-10_000:]
