"""Rows of tables can be loaded without what only work needs: a list of names, or a configuration, takes no second."""

import subprocess
import sys
from pathlib import Path

from novags.methods import VARIANTS
from simscenes.scenes import SCENES

ROOT = Path(__file__).resolve().parents[1]
METHODS = [f"novags.methods.{name}.row" for name in ("nova", "nova_plus", "denoised", "averaging")]
# Two packages stand for their folders alone: what their other rows import is not asked here.
LOADING = """
import sys
from importlib import import_module
from types import ModuleType

for name in ("novags.methods", "novags.methods.enhancers"):
    package = sys.modules[name] = ModuleType(name)
    package.__path__ = [name.replace(".", "/")]
for name in sys.argv[1:]:
    import_module(name)
print(*sorted({"torch", "numba", "mitsuba", "drjit"} & sys.modules.keys()))
"""
LISTING = """
import sys
from simscenes.scenes import SCENES

print(*sorted({SCENES.module_of(name) for name in SCENES} & sys.modules.keys()))
"""


def _printed(code: str, *arguments: str) -> list[str]:
    """What a fresh interpreter prints."""
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=120).stdout.split()


def test_loading_rows_imports_no_library_for_training_or_rendering() -> None:
    named = [table.module_of(name) for table in (VARIANTS, SCENES) for name in table]
    modules = {module for module in named if module is not None}
    assert modules
    assert _printed(LOADING, *METHODS, *sorted(modules)) == []


def test_listing_the_scenes_imports_none_of_them() -> None:
    assert _printed(LISTING) == []
