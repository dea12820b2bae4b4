"""`novags doctor --stability`: the hard cases, computed here and now, one line each."""

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from novags.testbed import stability
from novags.testbed.console import Console
from novags.testbed.ledger.dry import planned
from sensor_model.files.atomic import write_text
from sensor_model.files.door import read_text
from sensor_model.files.lock import locked


def show(parts: Sequence[str], *, long: bool = False, out: Path | None = None, overwrite: bool = False) -> bool:
    """Compute and print the hard cases.

    Args:
        parts: Which parts; none: all.
        long: With the slow ones.
        out: File for the table, Markdown.
        overwrite: Whether `out` may be a file that has no place for a table.

    Returns:
        Whether all of them hold.

    Raises:
        ValueError: If there is no such part, or `out` holds something else or is a folder.
        OSError: If `out` cannot be written to.
        BlockingIOError: If another process is writing it.
    """
    if unknown := [part for part in parts if part not in stability.PARTS]:
        raise ValueError(f"no part {unknown[0]!r:.80} of the hard cases; available: {', '.join(stability.PARTS)}")
    if out is not None and out.is_dir():
        raise ValueError(f"{out} is a folder, and the table goes into a file: choose another --out")
    page = read_text(out) if out is not None and out.is_file() else ""
    if page and not stability.has_place(page) and not overwrite:
        raise ValueError(f"{out} is there and has no place for a table: choose another --out, or add --overwrite")
    results = []
    with nullcontext() if out is None else locked(out.parent, name=f".{out.name}.lock"):
        planned(Console(), "doctor", [] if out is None else [out])
        for result in stability.measure(parts or tuple(stability.PARTS), long=long):
            print(f"{'ok  ' if result.holds else 'FAIL'}  {result}", flush=True)
            results.append(result)
        if out is not None:
            write_text(out, stability.embedded(page, stability.markdown(results)))
    failed = sum(not result.holds for result in results)
    print(f"{len(results)} computed, {failed} beyond their bounds" if failed else f"all {len(results)} hold")
    return not failed
