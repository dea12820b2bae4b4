"""What settling a process leaves unsaid."""

import os
import subprocess
import sys

from novags.process import ENVIRONMENT

PROGRAM = """
import sys
sys.modules["matplotlib"] = None  # as where it is not installed
from novags.process import settle
settle()
import colour
import novags.testbed.report.look.pictures, simscenes.scenes.indoors, simscenes.scenes.printed.pages
"""


def test_where_matplotlib_is_not_installed_nothing_is_said_of_it() -> None:
    """Rationale: it is no dependency of ours, and colour-science warned of it in every capture."""
    bare = {name: value for name, value in os.environ.items() if name not in ENVIRONMENT}
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=bare, capture_output=True, text=True, check=True)
    assert done.stderr == ""
