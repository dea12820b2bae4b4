"""Dry runs: a command names its steps, and does nothing."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from novags.testbed.console.terminal import Console
from sensor_model.files.lock import dry

NOT_DONE = "(dry run: nothing is done)"


class Planned(Exception):
    """In a dry run: raised in place of the work, once the steps were named.

    Args:
        kept: Whether nothing would be.
    """

    def __init__(self, kept: bool) -> None:
        super().__init__()
        self.kept = kept


@contextmanager
def dry_run(asked: bool = True) -> Iterator[list[bool]]:
    """Where asked, a stage names its steps, writes nothing, and ends the block; and so does `planned`.

    Yields:
        A list, to which the stage adds whether its result would be kept.
    """
    token, kept = dry.set(asked), list[bool]()
    try:
        yield kept
    except Planned as planned:
        kept.append(planned.kept)
    finally:
        dry.reset(token)


def planned(console: Console, name: str, files: Iterable[Path]) -> None:
    """In a dry run, say of each file that it would be made, or made again; otherwise do nothing.

    Call it where all has been checked and nothing is written yet.

    Args:
        console: Where it is said.
        name: The maker of the files.
        files: The files. Measurements, for example, are told by their own command, which counts them.

    Raises:
        Planned: In a dry run.
    """
    if not dry.get():
        return
    for file in files:
        again, there = (" again", " is there") if file.exists() else ("", "")
        console.note(f"{name}: to be made{again} in {file.parent}: {file.name}{there} {NOT_DONE}")
    raise Planned(kept=False)
