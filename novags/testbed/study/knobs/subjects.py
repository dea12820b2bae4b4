"""Subjects by name: parts of the simulation, each a file here, and every method that declares knobs."""

from collections.abc import Callable, Mapping
from difflib import get_close_matches
from functools import lru_cache
from inspect import signature
from typing import Any

from novags.methods import METHODS, VARIANTS
from novags.testbed.study.knobs.knob import Subject
from novags.testbed.study.knobs.methods import SIZES, reconstruction
from novags.testbed.study.knobs.render import render
from novags.testbed.study.knobs.sensor import sensor
from novags.testbed.study.knobs.splats import splats
from sensor_model.files.reading import brief

PARTS: dict[str, Callable[..., Subject]] = {make.__name__: make for make in (render, sensor, splats)}
Sizes = tuple[tuple[str, int], ...]  # of the work, by name


def subjects() -> list[str]:
    """The names of all, in their order on the page."""
    return [*PARTS, *with_knobs()]


def with_knobs() -> list[str]:
    """The methods that declare knobs."""
    return [name for name, method in METHODS.items() if method.knobs]


def sizes_of(name: str, given: Mapping[str, Any]) -> Sizes:
    """The sizes of the work on a subject, checked.

    Raises:
        ValueError: If there is no such subject, or a size is unknown, missing or not a whole number >= 1.
    """
    (name,) = chosen(name)
    known = tuple(signature(PARTS[name]).parameters) if name in PARTS else SIZES
    unknown = [key for key in given if key not in known]
    missing = [key for key in known if key not in given] if name in PARTS else []  # a method takes the preset's
    if unknown or missing:
        raise ValueError(f"the sizes of {name} are {', '.join(known)}; got {', '.join(given) or 'none'}")
    if bad := [key for key, value in given.items() if type(value) is not int or not 1 <= value < 1 << 31]:
        raise ValueError(f"{bad[0]} must be a whole number >= 1, got {brief(repr(given[bad[0]]), 60)}")
    return tuple(given.items())


@lru_cache(maxsize=8)
def subject_of(name: str, sizes: Sizes) -> Subject:
    """The subject of this name, on work of these sizes; a subject that this process has met keeps its preparations."""
    return PARTS[name](**dict(sizes)) if name in PARTS else reconstruction(name, dict(sizes))


def chosen(name: str) -> list[str]:
    """The subjects that a word stands for.

    Raises:
        ValueError: If it stands for none.
    """
    known = subjects()
    if name == "all":
        return known
    if name in known:
        return [name]
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
