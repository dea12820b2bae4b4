"""Python processes of our own: they can import the same modules as this one, without the folder that it was started in.

That folder is often a stranger's, and a file in it that is called `torch.py` or `signal.py` would run.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

INTERPRETER = sys.executable
ROOT = str(Path(__file__).resolve().parents[2])  # where the three packages lie


def python(program: str, *arguments: str) -> list[str]:
    """The command that runs a program in a Python of its own.

    Args:
        program: Its text.
        arguments: `sys.argv[1:]` of the program.
    """
    # -I: neither the working directory nor an entry of PYTHONPATH decides about imports, while Python starts either,
    # and in the processes that this one starts in its turn. Python 3.10 has no -P, which does half of that. The other
    # variables of Python are unknown to it too: of these, how names of files are read must be the same on both sides.
    kept = ["-X", f"utf8={sys.flags.utf8_mode}", *(["-B"] if sys.dont_write_bytecode else [])]
    program = f"import sys; sys.path[:] = {import_path()!r}\n{program}"
    return [INTERPRETER, "-I", *kept, "-c", program, *arguments]


def import_path() -> list[str]:
    """`sys.path` of this process without the working directory, under any of its names.

    Where our own packages lie in the working directory, as in a checkout, they keep their place.
    """
    here = os.stat(os.curdir)
    ours = _is(ROOT, here)
    found = (ROOT if ours and _is(folder, here) else folder for folder in sys.path)
    return list(dict.fromkeys([*(folder for folder in found if folder == ROOT or not _is(folder, here)), ROOT]))


def _is(folder: str, here: os.stat_result) -> bool:
    """Whether an entry is the working directory, or could be wherever a process goes."""
    try:
        return not os.path.isabs(folder) or os.path.samestat(os.stat(folder), here)
    except OSError:  # it does not exist, as the archive of the standard library mostly does not
        return False
