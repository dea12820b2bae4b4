"""What can be measured: parts of the simulation, each a file here, and every method that declares knobs."""

from collections.abc import Callable
from difflib import get_close_matches
from functools import partial
from pathlib import Path

from novags.methods import METHODS, VARIANTS
from novags.testbed.console.terminal import Console
from novags.testbed.pareto.knob import Subject
from novags.testbed.pareto.subjects.methods import reconstruction, with_knobs
from novags.testbed.pareto.subjects.render import render
from novags.testbed.pareto.subjects.sensor import sensor
from novags.testbed.pareto.subjects.splats import splats
from sensor_model.files.reading import brief

Make = Callable[[bool, Path, Console], Subject]
"""(small, folder for what measurements have in common, console) -> the subject."""


def subjects() -> dict[str, Make]:
    """All by name, in their order on the page."""
    parts: dict[str, Make] = {make.__name__: make for make in (render, sensor, splats)}
    return {**parts, **{name: partial(reconstruction, name) for name in with_knobs()}}


def chosen(name: str) -> list[Make]:
    """The subjects that a word stands for.

    Raises:
        ValueError: If it stands for none.
    """
    known = subjects()
    if name == "all":
        return list(known.values())
    if name in known:
        return [known[name]]
    if name in METHODS:
        raise ValueError(f"the method {name} declares no knobs; these do: {', '.join(with_knobs())}")
    if name in VARIANTS:
        method = VARIANTS[name].method
        of = f"novags pareto {method}" if method in known else f"one of {', '.join(with_knobs())}"
        raise ValueError(f"{name} is a variant of {method}, and knobs are measured by method: {of}")
    words = (*known, "all")
    near = get_close_matches(name, words, 1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise ValueError(f"what to measure must be one of {', '.join(words)}; got {brief(repr(name), 100)}{hint}")
