"""Rows of other groups' methods: they load without an engine, and what they name for later exists."""

import subprocess
from importlib import import_module
from pathlib import Path

import pytest

import novags
from novags.methods import METHODS
from sensor_model.files.python import python
from sensor_model.files.registry import Later, loaded

ROOT = Path(novags.__file__).parent
ROWS = sorted(
    f"novags.methods.{folder}.rows.{path.stem}"
    for folder in ("rivals", "nerf")
    for path in (ROOT / "methods" / folder / "rows").glob("*.py")
    if path.stem != "__init__"
)
TABLES = {"novags.methods": ROOT / "methods", "novags.methods.enhancers": ROOT / "methods" / "enhancers"}
# Packages whose own file holds a table are replaced by empty ones: rows are looked at, not what tables import.
PROGRAM = f"""
import sys
from importlib import import_module
from types import ModuleType
for name, folder in {[(name, str(folder)) for name, folder in TABLES.items()]!r}:
    sys.modules[name] = ModuleType(name)
    sys.modules[name].__path__ = [folder]
for name in sys.argv[1:]:
    import_module(name).METHOD.config()
print(sorted({{"torch", "numba", "mitsuba"}} & set(sys.modules)))
"""


def test_rows_load_no_engine() -> None:
    assert len(ROWS) == 11
    done = subprocess.run(python(PROGRAM, *ROWS), capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("[]", "")


@pytest.mark.parametrize("row", ROWS)
def test_a_row_is_one_of_the_table_and_its_trainer_exists(row: str) -> None:
    method = import_module(row).METHOD
    name = row.rpartition(".")[2].replace("_", "-")
    assert METHODS[name] is method
    assert isinstance(method.train, Later)
    assert callable(loaded(method.train.reference))
    config = method.config()
    assert method.parts(config) == {"fit": config.fit.iterations}
