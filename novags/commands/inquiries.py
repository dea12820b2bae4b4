"""Commands that answer a question about novags or this machine, and write nothing."""

from typing import Annotated

import tyro

from novags.commands.shared import say
from novags.options import Listed


def doctor() -> None:
    """Check which parts work on this machine, and how to install missing ones."""
    from novags.commands.answers.doctor import examine

    marks = {"ok": "ok     ", "missing": "missing", "broken": "BROKEN "}
    broken = False
    for finding in examine():
        say(f"{marks[finding.state]}  {finding.name:<18} {finding.detail}")
        broken |= finding.state == "broken"
    say("something needed is broken: see above" if broken else "ready: novags run --preset demo")
    if broken:
        raise SystemExit(1)


def list_(what: Annotated[Listed, tyro.conf.Positional] = "all", *, json: bool = False) -> None:
    """List scenes, sensors, methods and variants, light levels, presets, sources of cameras, enhancers and metrics.

    Args:
        what: One of these lists, or all.
        json: As JSON, {LIST: {NAME: TEXT}}.
    """
    from novags.commands.answers.catalogue import listing

    say(listing(what, json))


def help_(topic: Annotated[str | None, tyro.conf.Positional] = None) -> None:
    """Show the help page about a term: electrons, cameras, variants, scores ...; without one, list the pages.

    Args:
        topic: The term.
    """
    from novags.commands.answers.topics import page, topics

    say(page(topic) if topic else f"novags help TOPIC, with one of: {', '.join(topics())}")
