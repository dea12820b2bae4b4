"""Help, lists and typing errors load none of the heavy libraries."""

import subprocess
import sys

import pytest

from novags import cli

HEAVY = {"torch", "mitsuba", "numba", "cv2", "matplotlib", "scipy.spatial", "scipy.ndimage"}


def loaded_by(*words: str) -> tuple[set[str], str]:
    """The modules that a command has loaded when it ends, and all that it said."""
    code = (
        f"import sys; sys.argv = {['novags', *words]}\n"
        "from novags.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print('LOADED', *sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    said, _, modules = done.stdout.partition("LOADED")
    return set(modules.split()), said + done.stderr


def test_help_loads_no_heavy_library() -> None:
    modules, said = loaded_by("--help")
    assert not modules & {*HEAVY, "scipy"}
    assert all(command in said for command in cli.COMMANDS)


@pytest.mark.parametrize(
    ("words", "answer"),
    [(["list"], "tabletop"), (["run", "--methods", "magic"], "novags: error: unknown method 'magic'")],
)
def test_lists_and_unknown_names_load_no_heavy_library(words: list[str], answer: str) -> None:
    modules, said = loaded_by(*words)
    assert not modules & HEAVY
    assert answer in said
