"""Differences between runs that are compared: software, processor, graphics card.

Keys of results leave these out: a fit that was made elsewhere is no other fit. The last bits differ, though, and
scores with them: a comparison says so.
"""

from collections.abc import Mapping

from novags.testbed.folders.run import Run


def mixed(runs: Mapping[str, Run]) -> str:
    """In words what differs between these runs; "" if nothing does."""
    found: dict[str, dict[str, list[str]]] = {}
    for name, run in runs.items():
        stage = run.record["stage"]
        hardware = {"processor": stage["hardware"]["processor"], "GPU": stage["hardware"]["gpu"] or "none"}
        for what, value in {**stage["versions"], **hardware}.items():
            found.setdefault(what, {}).setdefault(str(value), []).append(name)
    for values in found.values():
        if missing := [name for name in runs if not any(name in names for names in values.values())]:
            values["not installed"] = missing
    several = {what: values for what, values in found.items() if len(values) > 1}
    if not several:
        return ""
    told = "; ".join(
        f"{what} {', '.join(f'{value} ({_named(names)})' for value, names in values.items())}"
        for what, values in several.items()
    )
    return f"These runs were not made alike, so that small differences between them say little: {told}."


def _named(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
