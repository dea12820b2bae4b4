"""Curves of accuracy against time, what they are made of, and what a budget has chosen from them."""

from __future__ import annotations

import json
from pathlib import Path

from tests.fuzz.case import Reader

CURVE = {
    "seconds": 2.0, "seconds_sd": 0.1, "cpu_seconds_sd": 0.1, "error_unit": "%", "error_sd": 0.2, "front": True,
    "repeats": 3, "of": "a reconstruction", "why": "so", "workload": {"scene": "x", "size": "64 x 64"},
    "hardware": {"processor": "x", "cores": 2},
}  # fmt: skip


def make_curves(folder: Path) -> None:
    points = [
        {**CURVE, "knob": f"nova.{name}", "setting": setting, "cpu_seconds": 0.01 * setting, "error": 500 / setting,
         "default": setting == 800, "option": option, "parts": {"fit": 0.01 * setting, "denoiser": 3.0},
         "db_lost": 8.0 - 0.01 * setting, "db_lost_sd": 0.3}
        for name, option in (("iterations", "iterations"), ("mask share", None)) for setting in (100, 400, 800)
    ]  # fmt: skip
    (folder / "curves.jsonl").write_text("".join(json.dumps(point) + "\n" for point in points))


def read_curves(folder: Path, file: Path) -> object:
    """As a budget and the page of curves do."""
    from novags.testbed.report.curves.page import embedded
    from novags.testbed.study.budget.choice import choose
    from novags.testbed.study.budget.known import known
    from novags.testbed.study.curves.curve import read_curves

    options = known(folder).options
    chosen = choose({"fit": 10.0, "denoiser": 5.0, "fixed": 1.0}, options, 9.0)
    embedded("<!-- curves: nova -->\n<!-- end of curves -->", read_curves(folder))
    return options, chosen


def make_state(folder: Path) -> None:
    from novags.testbed.study.budget.within import Request
    from novags.testbed.study.cells.presets import EXPERIMENTS

    state = {
        "request": Request(EXPERIMENTS["demo"], 60.0).identity(), "budget": 60.0, "trial": 9.0, "curves": "mine",
        "shares": {"iterations": 0.25}, "foretold": {"seconds": 50.0, "lost": 1.0, "sd": 0.2}, "preset_seconds": 200.0,
        "seconds": 52.0,
    }  # fmt: skip
    (folder / "budget.json").write_text(json.dumps(state))


def read_state(folder: Path, file: Path) -> object:
    """As a budget does that was interrupted, and one that is done."""
    from novags.testbed.study.budget.said import after
    from novags.testbed.study.budget.within import Request, begun
    from novags.testbed.study.cells.presets import EXPERIMENTS
    from novags.testbed.study.knobs.options import turned

    request = Request(EXPERIMENTS["demo"], 60.0)
    if (state := begun(request, folder)) is None:
        return None
    preset = turned(request.preset, state["shares"])
    return state, preset, after(preset, folder, state, None) if "seconds" in state else None


def make_measured(folder: Path) -> None:
    measured = {"seconds": 1.0, "cpu_seconds": 2.0, "error": 0.5, "parts": {"fit": 1.0}}
    (folder / "measured.json").write_text(json.dumps(measured))


def read_one(folder: Path, file: Path) -> object:
    """As the table of a study of measurements and its curves do."""
    from novags.testbed.report.curves.figure import figure
    from novags.testbed.report.curves.table import tables
    from novags.testbed.study.curves.curve import curves
    from novags.testbed.study.knobs.measurement import read_measured

    subject, found = _subject(), read_measured(folder)
    parts = {f"parts.{name}": value for name, value in found.parts.items()}
    own = {"seconds": found.seconds, "cpu_seconds": found.cpu_seconds, "error": found.error, **parts}
    rows = [{"state": "done", "knob": "k", "setting": setting, "seed": 0, **own} for setting in (1, 2, 4)]
    points = curves(subject, rows)
    figure(points, "x"), tables(points)
    return points


def _subject():  # type: ignore[no-untyped-def]  # of a module that is imported late
    from novags.testbed.study.knobs.knob import Knob, Reading, Subject

    knob = Knob(
        name="k", settings=(1, 2, 4), default=2, unit="%", of="it", why="so",
        measure=lambda s, i, c: Reading(0, 0, 0), parts=("fit",),
    )  # fmt: skip
    return Subject("x", {"size": 3}, (knob,))


def _prepare() -> None:
    import torch

    torch.set_num_threads(1)


def make(folder: Path) -> None:
    make_curves(folder), make_state(folder), make_measured(folder)


def read(folder: Path, file: Path) -> object:
    kind = {"curves.jsonl": read_curves, "budget.json": read_state}.get(file.name, read_one)
    return kind(folder, file)


READERS = [Reader("curves and budgets", make, read, ("*.json", "*.jsonl"), share=0.5, prepare=_prepare)]
