"""Tables are text: listing them loads no row, and rows and configurations load nothing of what only work needs."""

import subprocess
import sys
from importlib import import_module

import pytest

from novags.cameras import SOURCES
from novags.methods import METHODS, VARIANTS
from novags.methods.enhancers import ENHANCERS
from novags.testbed.stages.seen import SEEN
from sensor_model.files.registry import Later, Registry, loaded
from simscenes.scenes import SCENES

TABLES: dict[str, Registry[object]] = {
    "METHODS": METHODS, "VARIANTS": VARIANTS, "ENHANCERS": ENHANCERS, "SOURCES": SOURCES, "SCENES": SCENES,
}  # type: ignore[dict-item]  # each of rows of its own type # fmt: skip
BEGIN = """
import sys
from novags.cameras import SOURCES
from novags.methods import METHODS, VARIANTS
from novags.methods.enhancers import ENHANCERS, enhancer_of
from simscenes.scenes import SCENES

TABLES = (METHODS, VARIANTS, ENHANCERS, SOURCES, SCENES)
"""
END = """
print(*(name for name in ("torch", "numba", "mitsuba", "drjit", "pycolmap") if name in sys.modules))
"""


def printed(code: str) -> list[str]:
    """The words that a fresh interpreter prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_listing_the_tables_loads_no_row() -> None:
    code = "print(*(t.module_of(name) for t in TABLES for name in t if t.module_of(name) in sys.modules))"
    assert printed(BEGIN + code) == []


def test_all_rows_and_configurations_load_no_engine() -> None:
    code = """
for table in TABLES:
    list(table.values())
for method in METHODS.values():
    method.config()
for name, enhancer in ENHANCERS.items():
    assert enhancer_of(enhancer.config())[0] == name
import novags.testbed.stages.configs.capturing, novags.testbed.stages.configs.command
import novags.testbed.stages.configs.denoising, novags.testbed.stages.configs.importing
import novags.testbed.stages.configs.posing, novags.testbed.stages.configs.reconstructing
import novags.testbed.stages.configs.rendering, novags.testbed.study.cells.presets
"""
    assert printed(BEGIN + code + END) == []


@pytest.mark.parametrize("words", [["list"], ["list", "methods", "--json"], ["help", "cameras"]])
def test_lists_load_no_engine(words: list[str]) -> None:
    code = f"""
import contextlib, io, sys
sys.argv = ["novags", *{words!r}]
from novags.cli import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main()
"""
    assert printed(code + END) == []


def test_a_configuration_beside_its_row_loads_no_other_row() -> None:
    code = """
import sys
from novags.methods.enhancers import enhancer_of
from novags.methods.enhancers.networks.rows.mbllen import MbllenConfig
enhancer_of(MbllenConfig())
print(*(name for name in sys.modules if name.startswith("novags.methods.enhancers.") and ".rows." in name))
"""
    assert printed(code) == ["novags.methods.enhancers.networks.rows.mbllen"]


@pytest.mark.parametrize("name", METHODS)
def test_a_method_names_a_trainer_that_exists_and_says_its_parts(name: str) -> None:
    method = METHODS[name]
    assert callable(loaded(method.train.reference) if isinstance(method.train, Later) else method.train)
    if method.parts is not None:
        parts = method.parts(method.config())
        assert parts
        assert all(isinstance(steps, int) and steps >= 0 for steps in parts.values())


@pytest.mark.parametrize("name", ENHANCERS)
def test_an_enhancer_names_functions_that_exist(name: str) -> None:
    enhancer = ENHANCERS[name]
    for function in (enhancer.enhance, enhancer.typical):
        assert callable(loaded(function.reference) if isinstance(function, Later) else function)


def test_only_networks_have_a_kind() -> None:
    found = {name: row.network() for name, row in ENHANCERS.items() if row.network is not None}
    assert list(found) == ["zero-dce", "sci", "mbllen", "uretinex", "retinexformer", "naka-net"]
    assert {kind.name for kind in found.values()} == {*"Zero-DCE SCI MBLLEN URetinex-Net Retinexformer Naka-GS".split()}


def test_every_text_of_a_table_names_something() -> None:
    for table in (*TABLES.values(), SEEN):
        assert [name for name in table if loaded(f"{table.module_of(name)}:__name__") != table.module_of(name)] == []


def test_a_table_takes_rows_and_texts_and_knows_where_they_are_from() -> None:
    table = Registry[object]({"a": "os.path:join", "b": 3})
    assert (list(table), len(table), "a" in table, "c" in table) == (["a", "b"], 2, True, False)
    assert table["a"] is import_module("os.path").join
    assert [table.module_of(name) for name in "abc"] == ["os.path", None, None]
    table["a"] = 5
    assert (table["a"], table.module_of("a")) == (5, None)
    table["a"] = import_module("os.path").join  # put back, as a test does
    assert table.module_of("a") == "os.path"
    del table["b"]
    with pytest.raises(KeyError):
        table["b"]
    for wrong in ("nothing", "os.path", ":join", "os.path:"):
        with pytest.raises(ValueError, match="module:NAME"):
            loaded(wrong)
