"""The entry point, of `novags` and of `python -m novags`."""

import os
import sys


def main() -> None:
    """Run a command. Nothing is imported from the working directory, which is often a stranger's.

    Raises:
        SystemExit: On Windows, which lacks what locks are made of; the message says where novags runs there.
    """
    if sys.platform == "win32":
        sys.exit(
            "novags: Windows has no fcntl, by which commands lock their folders: run novags in WSL 2, which is Linux"
        )
    # `python -m` puts it first, and an empty entry of PYTHONPATH means it too. Nothing of ours is imported before.
    found = [folder for folder in sys.path if os.path.isabs(folder) and not _is_here(folder)]
    sys.path[:] = dict.fromkeys([*found, os.path.dirname(os.path.dirname(os.path.abspath(__file__)))])

    from novags.process import settle

    settle()
    from novags.cli import main as command

    command()


def _is_here(folder: str) -> bool:
    return os.path.isdir(folder) and os.path.samefile(folder, os.curdir)


if __name__ == "__main__":
    main()
