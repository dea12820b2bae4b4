"""The main job: a set, a capture of it, reconstructions by every method, scores, a report, in one folder."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from novags.testbed import stages
from novags.testbed.console import Console
from novags.testbed.folders import capture as capture_folder
from novags.testbed.folders import shapes
from novags.testbed.folders.experiment import EXPERIMENT, REPORT, REPORT_FILES, find_runs
from novags.testbed.folders.place import place_of
from novags.testbed.folders.run import METRICS, RECORD
from novags.testbed.ledger.contents import UNFINISHED, read_json, write_json
from novags.testbed.ledger.dry import NOT_DONE, dry_run, planned
from novags.testbed.ledger.stage import refuse_other
from novags.testbed.presets import Preset
from novags.testbed.report.page import write_report
from novags.testbed.stages.layouts import RECORD as SET
from novags.testbed.stages.scoring import merge
from novags.testbed.study.steps import make_set
from sensor_model.files.door import resolved
from sensor_model.files.lock import dry, locked

DESCRIBED = (EXPERIMENT, METRICS, REPORT, REPORT_FILES)  # files that describe all runs in the folder
TAKEN = ("set", "capture", *DESCRIBED, UNFINISHED)  # what lies there beside a folder for each method or variant


def run(preset: Preset, out: Path, console: Console, *, command: str | None = None, overwrite: bool = False) -> Path:
    """Run what is still missing of the experiment in `out`; returns the path of the report.

    Args:
        preset: What to do.
        out: The experiment folder: set/ (unless a set is given), capture/, one folder per method or variant,
            metrics.json, report.html.
        console: Where progress goes.
        command: The command line, for the record.
        overwrite: Replace finished results of another request.

    Raises:
        ValueError: If an input is wrong, or `out` holds other things or, unless `overwrite`, finished results of
            another request; that is said before any work.
        BlockingIOError: If another process is writing to `out`.
    """
    refuse_impossible(preset)
    with locked(out):
        if not overwrite:
            _refuse_other(preset, out)
        described = [out / name for name in DESCRIBED]
        capture = photograph(preset, out, console, overwrite=overwrite)
        for name in preset.methods:
            config = preset.reconstruct(name)
            stages.reconstruct(capture, out / name, config, console, stale=described, overwrite=overwrite)
        write_json(out / EXPERIMENT, {"command": command, "methods": preset.methods, "preset": asdict(preset)})
        score_all(out, console)
        return write_report(out, console)


def refuse_impossible(preset: Preset) -> None:
    """Raise ValueError for an experiment that cannot be done, wherever it is to lie."""
    preset.refuse_lacking()
    if taken := [name for name in preset.methods if name in TAKEN]:
        raise ValueError(f"a variant must not be called {taken[0]}: the folder of an experiment holds something else "
                         "of that name")  # fmt: skip


def photograph(preset: Preset, out: Path, console: Console, *, overwrite: bool = False) -> Path:
    """The first half of `run`: make the set, if none is given, and take the pictures; returns the capture's folder."""
    with locked(out):
        described = [out / name for name in DESCRIBED]
        source = _source(preset, out, console, described, overwrite)
        stages.capture(source, out / "capture", preset.capture, console, stale=described, overwrite=overwrite,
                       for_runs=True)  # fmt: skip
        return out / "capture"


def _source(preset: Preset, out: Path, console: Console, stale: Sequence[Path], overwrite: bool) -> Path:
    """The set to photograph: the given one, or one made in the experiment's folder."""
    if preset.folder is not None:
        return preset.folder
    make_set(out / "set", preset.photos or preset.render, console, stale=stale, overwrite=overwrite)
    return out / "set"


def _refuse_other(preset: Preset, out: Path) -> None:
    """Refuse a request that would replace finished results in `out`, before any work."""
    if preset.folder is None:
        refuse_other(out / "set", SET, (preset.photos or preset.render).resolved())
    refuse_other(out / "capture", capture_folder.RECORD, preset.capture.resolved())
    if preset.folder is None:
        _refuse_set_elsewhere(out)
    for name in preset.methods:
        refuse_other(out / name, RECORD, preset.reconstruct(name).resolved())
    if (out / EXPERIMENT).exists():
        before = read_json(out / EXPERIMENT, shapes.EXPERIMENT)["methods"]
        if lost := [name for name in before if name not in preset.methods]:
            raise ValueError(
                f"{out} holds a finished comparison with {', '.join(lost)}, which this request leaves out: name them "
                "too (--methods), choose another --out, or add --overwrite"
            )


def _refuse_set_elsewhere(out: Path) -> None:
    """Refuse to render for a finished capture of a set that lies elsewhere: it would be refused after the render."""
    record = out / "capture" / capture_folder.RECORD
    if not record.exists():
        return
    made_of = place_of(out / "capture", read_json(record, shapes.CAPTURE)["set"]["path"])
    if made_of != resolved(out / "set"):
        raise ValueError(f"{out / 'capture'} is a finished capture of the set {made_of}, which this request does not "
                         "name: name it (--scene), choose another --out, or add --overwrite")  # fmt: skip


def said(preset: Preset, out: Path, console: Console, *, overwrite: bool = False) -> None:
    """Say what `run` would do, and write nothing: which stages it would make, or make again and why.

    Raises:
        ValueError: As `run`.
    """
    refuse_impossible(preset)
    if not overwrite:
        _refuse_other(preset, out)
    made = {"": False}  # whether each part would be, of those before
    for name, needs, record, do in _steps(preset, out, console, overwrite):
        if made[needs]:  # an input that is made counts by its key: whether it comes out equal is seen then
            of = needs if needs in preset.methods else f"the {needs}"
            but = f", unless {of} comes out as before" if record.exists() else ""
            console.note(f"{name}: to be made{but} {NOT_DONE}")
            made[name] = True
            continue
        with dry_run() as kept:
            do()
        made[name] = kept == [False]
    with dry_run():
        planned(console, "run", [out / name for name in (EXPERIMENT, METRICS, REPORT)])


def _steps(
    preset: Preset, out: Path, console: Console, overwrite: bool
) -> Iterator[tuple[str, str, Path, Callable[[], Any]]]:
    """Name of each part of `run`, the part that it needs, its record, and what makes it."""
    source, capture = preset.folder or out / "set", out / "capture"
    if preset.folder is None:
        wanted = preset.photos or preset.render
        yield "set", "", source / SET, partial(make_set, source, wanted, console, overwrite=overwrite)
    yield ("capture", "" if preset.folder else "set", capture / capture_folder.RECORD, partial(
        stages.capture, source, capture, preset.capture, console, overwrite=overwrite, for_runs=True
    ))  # fmt: skip
    for name in preset.methods:
        yield (name, "capture", out / name / RECORD, partial(
            stages.reconstruct, capture, out / name, preset.reconstruct(name), console, overwrite=overwrite
        ))  # fmt: skip
    for name in preset.methods:
        yield f"score {name}", name, out / name / METRICS, partial(stages.score, out / name, console)


def score_all(folder: Path, console: Console) -> dict[str, Any]:
    """Score a run, or every run of an experiment; returns the mean scores by name.

    Args:
        folder: Of the run or the experiment.
        console: Where progress goes.

    Raises:
        ValueError: If `folder` is neither, or what its runs refer to is gone.
        BlockingIOError: If another process is writing there.
    """
    with locked(folder, make=False):
        return _score_all(folder, console)


def _score_all(folder: Path, console: Console) -> dict[str, Any]:
    runs, metrics = find_runs(folder), dict[str, Any]()
    for name, run in runs.items():
        with dry_run(dry.get()):  # in a dry run each says what it would do
            metrics[name] = stages.score(run.path, console)
    if not (folder / RECORD).exists():
        planned(console, "score", [folder / METRICS])
        write_json(folder / METRICS, merge(metrics, {name: run.method for name, run in runs.items()}))
    return {name: run["methods"][name]["mean"] for name, run in metrics.items()}
