"""Commands that answer a question about novags or this machine, and write nothing but what `--out` names."""

from pathlib import Path
from typing import Annotated

import tyro

from novags.commands.shared import say
from novags.options import Listed


def doctor(*, stability: bool = False, part: tuple[str, ...] = (), long: bool = False, out: Path | None = None,
           overwrite: bool = False, dry_run: bool = False) -> None:  # fmt: skip
    """Check what works on this machine, what does not, and how to install what is missing.

    Args:
        stability: Instead, compute the numerically hard cases and show their errors beside their bounds.
        part: Only these parts: enhance, splats, sensor, ...
        long: With the cases that take minutes.
        out: File for the table of hard cases, Markdown; in a page like docs/stability.md it replaces the old table.
        overwrite: Replace a file that holds anything else.
        dry_run: Only say whether that file would be made, or made again. Nothing is computed or written.
    """
    from novags.testbed.ledger.dry import dry_run as dry
    from novags.testbed.machine.doctor import examine

    if dry_run and out is None:
        raise ValueError("--dry-run belongs to --out: without it doctor makes nothing")

    if stability or part or long or out is not None:
        from novags.testbed.stability.console import show

        with dry(dry_run):
            if not show(part, long=long, out=out, overwrite=overwrite):
                raise SystemExit(1)
        return
    marks = {"ok": "ok     ", "missing": "missing", "broken": "BROKEN "}
    broken = False
    for finding in examine():
        say(f"{marks[finding.state]}  {finding.name:<18} {finding.detail}")
        broken |= finding.state == "broken"
    say("something needed is broken: see above" if broken else "ready: novags run --preset demo")
    if broken:
        raise SystemExit(1)


def list_(what: Annotated[Listed, tyro.conf.Positional] = "all") -> None:
    """List what is available: scenes, sensors, methods and variants, light levels, presets, cameras.

    Args:
        what: One of these lists, or all.
    """
    from novags.testbed.help.catalogue import listing

    say(listing(what))


def help_(topic: Annotated[str | None, tyro.conf.Positional] = None) -> None:
    """Show the help page about a term: electrons, cameras, variants, scores ...; without one, list the pages.

    Args:
        topic: The term.
    """
    from novags.testbed.help.topics import page, topics

    say(page(topic) if topic else f"novags help TOPIC, with one of: {', '.join(topics())}")
