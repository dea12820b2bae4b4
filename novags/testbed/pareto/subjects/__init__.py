"""What can be measured. A new knob is a row in one of these files; a new subject a file and a name in `SUBJECTS`."""

from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path

from novags.testbed.console import Console
from novags.testbed.pareto.knob import Subject
from novags.testbed.pareto.subjects.nova import nova
from novags.testbed.pareto.subjects.render import render
from novags.testbed.pareto.subjects.sensor import sensor
from novags.testbed.pareto.subjects.splats import splats
from sensor_model.files.reading import brief

Make = Callable[[bool, Path, Console], Subject]
"""(small, folder for what measurements have in common, console) -> the subject."""

SUBJECTS: dict[str, Make] = {make.__name__: make for make in (render, sensor, splats, nova)}


def chosen(name: str) -> list[Make]:
    """The subjects that a word stands for.

    Raises:
        ValueError: If it stands for none.
    """
    if name == "all":
        return list(SUBJECTS.values())
    if name not in SUBJECTS:
        near = get_close_matches(name, (*SUBJECTS, "all"), 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        known = ", ".join((*SUBJECTS, "all"))
        raise ValueError(f"what to measure must be one of {known}; got {brief(repr(name), 100)}{hint}")
    return [SUBJECTS[name]]
