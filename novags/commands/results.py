"""The commands about existing results: score, explain, verify, report, characterise."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from novags.commands import shared
from novags.commands.shared import announce, next_, say, typed, writing
from novags.options import Folder, Folders

_Reference = Literal["lit", "linear", "clean", "linear_demosaiced", "clean_demosaiced"]

DIFFERS = 3  # exit code: a result that was made again differs, or could not be made

_Swap = Literal["cameras", "points", "noise", "tone", "geometry", "colours", "length", "views"]

if TYPE_CHECKING:
    from novags.testbed.metrics.differences import Estimate
    from novags.testbed.report.place import Place


def score(
    runs: Folders = (), *, renders: Path | None = None, set: Path | None = None,
    reference: _Reference | None = None, out: Path | None = None, overwrite: bool = False,
    wait: bool = False, dry_run: bool = False,
) -> None:  # fmt: skip
    """Score runs against the truth, write metrics.json, and compare them. Or pictures from anywhere: --renders, --set.

    Args:
        runs: Folders of runs, of experiments, or folders that hold such.
        renders: Instead: a folder of pictures of the test views, named like them: 8-bit, 16-bit or EXR.
        set: The set or the capture whose test views they show.
        reference: The pictures they are compared with: lit (the views in good light, sRGB; if not given), linear (the
            light of the scene, after one gain for all views; 16-bit and EXR files hold linear light then), clean (of a
            capture: the dark exposures without noise, sRGB); linear_demosaiced, clean_demosaiced: the same of
            noise-free mosaics.
        out: File for all scores of pictures, JSON; the means are printed anyway.
        overwrite: Replace it.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say which scores would be made, or made again and why. Nothing is written.
    """
    from novags.testbed.ledger.dry import dry_run as dry

    if renders is not None or set is not None:
        if renders is None or set is None or runs:
            raise ValueError("score takes either folders of runs, or both --renders and --set")
        with dry(dry_run):
            _score_pictures(renders, set, reference or "lit", out, overwrite)
        return
    if not runs:
        raise ValueError("name at least one folder of a run, or pictures with --renders and --set")
    if out is not None:
        raise ValueError(f"--out {out} belongs to --renders: scores of runs go into their folders")
    if reference is not None:
        raise ValueError(f"--reference {reference} belongs to --renders: runs are scored against all that there are")
    from novags.testbed.report.place import places_in
    from novags.testbed.report.verdict import limits
    from novags.testbed.study.place import score_all, together

    for folder, mine in together(runs).items():
        with writing(folder, wait, make=False, dry_run=dry_run) as console:
            score_all(folder, mine, console)
    if dry_run:
        return
    places = places_in(runs, shared.console())
    for place in places:
        if len(places) > 1:
            say(f"{place.title}:")
        for name, scores in place.metrics["methods"].items():
            say(f"{name}: {_in_words(scores['mean'], place, name)}")
        if doubt := limits(place):
            say(doubt.strip())
    next_(f"novags report {' '.join(typed(run) for run in runs)}")


def _score_pictures(
    renders: Path, set: Path, reference: _Reference, out: Path | None, overwrite: bool
) -> None:  # fmt: skip
    from novags.testbed.ledger.contents import write_json
    from novags.testbed.stages.paths import keep_apart
    from novags.testbed.stages.scores.foreign import Truth, score_renders

    if out is not None:
        for source in (renders, set):
            keep_apart(out, source)
        if out.exists() and not overwrite:
            raise ValueError(f"{out} is there already: choose another --out, or add --overwrite")
    console = shared.console()
    found = score_renders(renders, Truth.of(set, console), reference, console, out)
    about = found["about"]
    kinds = " and ".join(about["pictures"])
    say(f"{len(found['views'])} test views, {kinds} pictures, against {reference}: {about['meaning']}")
    for name, value in [*found["mean"][reference].items(), *(found["geometry"] or {}).items()]:
        say(f"  {name:<18} {'not measured' if value is None else f'{value:.4f}'}")
    if out is not None:
        write_json(out, {**found, "renders": str(renders), "set": str(set)})
        say(out)


def explain(
    runs: Folders, *, swaps: tuple[_Swap, ...] = (), study: Path | None = None, wait: bool = False,
    dry_run: bool = False,
) -> None:  # fmt: skip
    """Say where the dB of a run are lost: each ingredient is replaced by its truth, alone, on the same capture.

    Writes RUN/explain/: the ladder as explain.json and explain.csv, and a run for each truth. What is there is kept.

    Args:
        runs: Folders of runs: one, or several of one method that differ in their seeds, of which one ladder is made.
        swaps: The ingredients; all if none is named.
        study: Of runs by a program: the study file whose [method.NAME] says how it is run.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say which runs would be made, and about how long they take. Nothing is written.
    """
    from contextlib import ExitStack

    from novags.testbed.ledger.dry import dry_run as dry
    from novags.testbed.ledger.dry import planned
    from novags.testbed.stages.configs.command import read_commands
    from novags.testbed.stages.explaining import ladder
    from novags.testbed.stages.explaining.swaps import SWAPS
    from novags.testbed.study.engines.progress import duration
    from sensor_model.files.toml_file import read_toml

    if not runs:
        raise ValueError("name at least one folder of a run")
    console = shared.console()
    with dry(dry_run), ExitStack() as held:
        for run in dict.fromkeys(runs):
            held.enter_context(writing(run, wait, make=False, dry_run=dry_run))
        commands = () if study is None else read_commands(read_toml(study).get("method", {}), study.parent)
        cases, asked = ladder.cases_of(runs, console, commands), list[str](swaps or SWAPS)
        seconds = ladder.forecast(cases, asked)
        for folder, cost in seconds.items():
            console.note(f"explain: {folder}, about {duration(cost)}")
        console.note(f"explain: {len(seconds)} runs to make, about {duration(sum(seconds.values()))} in all")
        planned(console, "explain", ladder.made(cases))
        say("\n".join(ladder.explain(cases, asked, console).lines()))
        next_(f"novags report {' '.join(typed(run) for run in runs)}")


def verify(
    runs: Folders, *, out: Path, count: int = 3, seed: int = 0, wait: bool = False, dry_run: bool = False
) -> None:  # fmt: skip
    """Make some of somebody's runs again from their records, stage by stage, and say what differs.

    Sets, captures, runs and scores are each made from the inputs that the record names, so that a difference is of this
    stage alone; the tables of a study from the scores of all its runs. Exit code 3: something differs, or could not be
    made again.

    Args:
        runs: Folders of runs, of experiments, of studies, or folders that hold such.
        out: Folder for the new results, and for verify.json. Finished ones in it are kept.
        count: How many runs, drawn from all of them.
        seed: Of the draw.
        wait: If another process is writing to `out`, wait until it is done instead of refusing.
        dry_run: Only say which runs would be made again, and about how long they took. Nothing is written.
    """
    from novags.numbers import check_range
    from novags.settings import check_seed
    from novags.testbed.folders.runs import studies_in
    from novags.testbed.ledger.dry import planned
    from novags.testbed.stages.explaining.verifying import RECORD, chosen_runs
    from novags.testbed.stages.explaining.verifying import verify as make_again
    from novags.testbed.study.engines.progress import duration
    from novags.testbed.study.results import tables_again
    from simscenes.sets.names import safe_name

    check_range("count", count, 1, 100_000)
    check_seed(seed)
    with writing(out, wait, dry_run=dry_run) as console:
        chosen = chosen_runs(runs, count, seed)
        for name, run in chosen.items():
            console.note(f"verify: {name} in {run.path}: its fit took {duration(run.record['stage']['seconds'])}")
        planned(console, "verify", [out / RECORD])
        tables = [tables_again(study, out / "tables" / f"{number}-{safe_name(study.name)}")
                  for number, study in enumerate(studies_in(runs), 1)]  # fmt: skip
        parts = make_again(chosen, out, console, tables)
        say("\n".join(part.line() for part in parts))
        if not all(part.same for part in parts):
            raise SystemExit(DIFFERS)


def export_results(
    runs: Folders, *, out: Path, reference: Literal["lit", "enhanced"] = "lit", dataset: str = "novags",
    overwrite: bool = False, wait: bool = False, dry_run: bool = False,
) -> None:  # fmt: skip
    """Export scores of runs in the JSON layout of nerfbaselines, with the pictures that they compare.

    Args:
        runs: Folders of runs, of experiments, of studies, or folders that hold runs and experiments.
        out: Folder for results.json and METHOD/SCENE/.
        reference: The reference of pictures: the views in good light, or the enhanced noise-free exposures.
        dataset: Name of the data set in these files.
        overwrite: Replace results that are there.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say which files would be made, or made again. Nothing is written.
    """
    from novags.testbed.dataset.nerfbaselines import export_results as export

    with writing(out, wait, dry_run=dry_run) as console:
        say(export(runs, out, console, reference=reference, dataset=dataset, overwrite=overwrite))


def _in_words(mean: Mapping[str, Any], place: "Place", name: str) -> str:
    """Main scores of a run, its gain over the floor, and the share that it recovers."""
    words = []
    for kind, number, what, share in (
        ("enhanced", "aligned_psnr", "noise-free exposure {} (aligned PSNR{})", "recovered"),
        ("lit", "tone_aligned_psnr", "well lit {} (tone-aligned PSNR{})", "recovered_lit"),
    ):
        if number not in (mean.get(kind) or {}):
            continue
        delta, base = place.deltas(kind)
        found = f", {_apart(delta[name])} over {base}" if name in delta else ""
        recovered = place.metrics[share].get(name)
        found += "" if recovered is None else f", {_with_error(recovered, '{:.0%}')} recovered"
        words.append(what.format(_decibels(mean[kind], number), found))
    return "; ".join(words) or "not scored: no truth is known (see unavailable in metrics.json)"


def _apart(found: "Estimate") -> str:
    """A difference with its error, and whether it is seen."""
    return _with_error(found, "{:+.2f}") + ("" if found.error is None or found.seen else ", not seen to differ,")


def _with_error(found: "Estimate", how: str) -> str:
    return how.format(found.value) + ("" if found.error is None else f" ± {how.format(found.error).lstrip('+')}")


def _decibels(scores: Mapping[str, Any], number: str) -> str:
    from novags.testbed.metrics.truth import ERROR, WITHIN

    if (score := scores[number]) is not None:
        return f"{score:.2f} dB"
    return (
        WITHIN
        if scores.get(number + ERROR) in ("inf", float("inf"))
        else "not scored, because the reference shows nothing"
    )


def report(
    runs: Folders, *, out: Path | None = None, overwrite: bool = False, wait: bool = False, dry_run: bool = False
) -> None:
    """Write a report on scored runs, or on a study: one HTML file. Where there are many pictures, the page holds
    thumbnails, and whole ones lie in a folder beside it.

    Args:
        runs: Folders of runs, of experiments, or folders that hold such; or the folder of one study.
        out: The file; if not given, report.html in a single folder, comparison.html beside several.
        overwrite: Replace a file even if it is not a report on the same runs or study.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say which files would be made, or made again; whether pictures need a folder beside the page is
            seen when it is made. Nothing is written.
    """
    from novags.testbed.report.page import report_path, write_reports, write_study
    from novags.testbed.report.study import is_study

    if len(runs) == 1 and is_study(runs[0]):
        with writing((out or runs[0] / "x").parent, wait, make=out is not None, dry_run=dry_run):
            announce(write_study(runs[0], out, overwrite=overwrite))
        return
    with writing((out or report_path(runs)).parent, wait, make=out is not None, dry_run=dry_run) as console:
        announce(write_reports(runs, console, out=out, overwrite=overwrite))


def site(folders: Folders, *, out: Path, overwrite: bool = False, wait: bool = False, dry_run: bool = False) -> None:
    """Write a results site on studies: one folder of pages that needs no server, with search, downloads and pictures.

    Args:
        folders: Folders of studies, of experiments, of runs, or folders that hold runs.
        out: Folder of the site: index.html, a page for each study, method and scene, their tables as CSV and LaTeX.
        overwrite: Write into a folder that holds other things than a site.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say which files and folders would be made, or made again. Nothing is written.
    """
    from novags.testbed.ledger.dry import planned
    from novags.testbed.site.writing import PARTS, write_site

    with writing(out, wait, dry_run=dry_run) as console:
        planned(console, "site", [out / part for part in PARTS])
        announce(write_site(folders, out, console, overwrite=overwrite))


def characterise(
    folder: Folder, *, out: Path, window: int = 1024, maps: bool = False, overwrite: bool = False, wait: bool = False,
    dry_run: bool = False,
) -> None:  # fmt: skip
    """Estimate a camera from its dark and flat frames, and write it as a TOML file for --sensor.

    Args:
        folder: dark/NAME/* and flat/NAME/*, each NAME some frames of one exposure (raw files, 16-bit PNG or TIFF, npy),
            and frames.toml for values that the files do not state: bits, exposure times, photons, eta. Or folders isoN
            of these, for a camera at several ISOs: --sensor FILE.toml@N. Without flat frames the gain is assumed.
        out: The TOML file.
        window: Side of the central square of the sensor that is used, in pixels.
        maps: Also measure every pixel of that square, and write a file of maps beside the TOML file.
        overwrite: Replace a file of other content.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Estimate the camera, on which it depends whether a file there is another, and only say whether it would
            be made, or made again. Nothing is written.
    """
    from novags.numbers import SIDE, check_range
    from novags.testbed.console.terminal import warnings_as_notes
    from novags.testbed.importing.calibration.camera import characterise_folder
    from novags.testbed.ledger.dry import planned
    from sensor_model.files.camera_file import write_maps, write_sensor

    check_range("window", window, 2, SIDE, " px")
    with writing(out.parent, wait, name=f".{out.name}.lock", dry_run=dry_run) as console:
        with warnings_as_notes(console):
            found = characterise_folder(folder, window=window, maps=maps)
        comment = f"measured from {os.path.basename(os.path.realpath(folder))}; what the frames say:\n{found}"
        sensors = {iso: setting.sensor for iso, setting in found.settings.items()}
        files = {
            iso: out.with_name(f"{out.stem}-iso{iso}.npz" if iso else f"{out.stem}.npz") for iso in sensors if maps
        }
        for iso, file in files.items():
            if (measured := found.settings[iso].maps) is not None:
                write_maps(file, measured, overwrite=overwrite)
        names = {iso: file.name for iso, file in files.items()}
        one = sensors.get(0)
        write_sensor(out, sensors if one is None else one, comment=comment, overwrite=overwrite, fits=found.fits,
                     maps=names if one is None else names.get(0))  # fmt: skip
        planned(console, "characterise", [out, *files.values()])
        say(f"{found}\n{out}")
        at = "" if one is not None else f"@{max(sensors)}"
        next_(f"novags capture SET --sensor {typed(out)}{at} --electrons 20 --out CAPTURE")
