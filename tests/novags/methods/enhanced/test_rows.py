"""Rows are read without the libraries that their functions need, and a configuration without the other rows."""

import subprocess
import sys

from novags.methods.enhancers import ENHANCERS

# In the place of the package of methods, whose table may import what it likes: an empty one.
BEGIN = """
import sys
from importlib.util import find_spec
from types import ModuleType

package = ModuleType("novags.methods")
package.__path__ = [find_spec("novags").submodule_search_locations[0] + "/methods"]
sys.modules[package.__name__] = package

from novags.methods.enhancers import ENHANCERS, enhancer_of, network_of
from sensor_model.files.registry import loaded

ROWS = "novags.methods.enhancers.rows."
"""
HEAVY = ("torch", "numba", "mitsuba", "scipy")


def printed(code: str) -> list[str]:
    """The words that a fresh interpreter prints."""
    done = subprocess.run([sys.executable, "-c", BEGIN + code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_every_row_is_read_without_torch() -> None:
    code = f"""
rows = [loaded(f"novags.methods.enhanced.{{name}}:METHOD") for name in ("naive", "oracle")]
for name, enhancer in ENHANCERS.items():
    module = sys.modules[ENHANCERS.module_of(name)]
    config = enhancer.config()
    assert enhancer_of(config) == (name, enhancer)
    rows += [module.METHOD] if hasattr(module, "METHOD") else []
for row in rows:
    row.config()
print(len(rows), *(name for name in {HEAVY} if name in sys.modules))
"""
    assert printed(code) == ["11"]


def test_a_configuration_beside_its_row_loads_no_other_row() -> None:
    code = """
from novags.methods.enhancers.rows.mbllen import MbllenConfig
enhancer_of(MbllenConfig())
print(*(name.removeprefix(ROWS) for name in sys.modules if name.startswith(ROWS)))
"""
    assert printed(code) == ["mbllen"]


def test_only_networks_have_a_kind() -> None:
    found = {name: row.network() for name, row in ENHANCERS.items() if row.network is not None}
    assert list(found) == ["zero-dce", "sci", "mbllen", "uretinex", "retinexformer"]
    assert {kind.name for kind in found.values()} == {"Zero-DCE", "SCI", "MBLLEN", "URetinex-Net", "Retinexformer"}
