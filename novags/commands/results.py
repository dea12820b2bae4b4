"""The commands about what is there: score, report, characterise."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from novags.commands import shared
from novags.commands.shared import announce, next_, writing
from novags.options import Folder, Folders

if TYPE_CHECKING:
    from novags.testbed.results.comparison import Group


def score(runs: Folders, *, wait: bool = False) -> None:
    """Score runs against the truth, write metrics.json, and compare them.

    Args:
        runs: Folders of runs, of experiments, or folders that hold such.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed.experiment import score_all
    from novags.testbed.folders.experiment import experiments_in
    from novags.testbed.results.comparison import groups_of

    for folder in [part for given in runs for part in experiments_in(given)]:
        with writing(folder, wait, make=False) as console:
            score_all(folder, console)
    groups = groups_of(runs, shared.console())
    for group in groups:
        if len(groups) > 1:
            print(f"{group.title}:")
        for name, scores in group.metrics["methods"].items():
            print(f"{name}: {_in_words(scores['mean'], group, name)}")
    next_(f"novags report {' '.join(str(run) for run in runs)}")


def _in_words(mean: Mapping[str, Any], group: "Group", name: str) -> str:
    """Main scores of a run, what it has over the floor, and what it recovers."""
    words = []
    for kind, number, what, share in (
        ("enhanced", "aligned_psnr", "noise-free exposure {} (aligned PSNR{})", "recovered"),
        ("lit", "tone_aligned_psnr", "well lit {} (tone-aligned PSNR{})", "recovered_lit"),
    ):
        if number not in (mean.get(kind) or {}):
            continue
        delta, base = group.deltas(kind)
        found = f", {delta[name]:+.2f} over {base}" if name in delta else ""
        recovered = group.metrics[share].get(name)
        found += "" if recovered is None else f", {recovered:.0%} recovered"
        words.append(what.format(_decibels(mean[kind][number]), found))
    return "; ".join(words) or "not scored: no truth is known (see unavailable in metrics.json)"


def _decibels(score: float | None) -> str:
    return "not scored, because the reference shows nothing" if score is None else f"{score:.2f} dB"


def report(runs: Folders, *, out: Path | None = None, overwrite: bool = False, wait: bool = False) -> None:
    """Write a report on scored runs: one self-contained HTML file.

    Args:
        runs: Folders of runs, of experiments, or folders that hold such.
        out: The file; if not given, report.html in a single folder, comparison.html beside several.
        overwrite: Replace a file even if it is not a report on the same runs.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed.report.page import report_path, write_reports

    with writing((out or report_path(runs)).parent, wait, make=out is not None) as console:
        path = write_reports(runs, console, out=out, overwrite=overwrite)
    announce(path)


def characterise(folder: Folder, *, out: Path, window: int = 1024, overwrite: bool = False, wait: bool = False) -> None:
    """Estimate a camera from its dark and flat frames, and write it as a TOML file for --sensor.

    Args:
        folder: dark/NAME/* and flat/NAME/*, each NAME some frames of one exposure (raw files, 16-bit PNG or TIFF, npy),
            and frames.toml for what the files do not state: bits, exposure times, photons, eta.
        out: The TOML file.
        window: Side of the central square of the sensor that is used, in pixels.
        overwrite: Replace a file of other content.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed.calibration_frames import characterise_folder
    from sensor_model import write_sensor

    with writing(out.parent, wait, name=f".{out.name}.lock"):
        sensor, found = characterise_folder(folder, window=window)
        comment = f"measured from {folder.resolve().name}; what the frames say:\n{found}"
        write_sensor(out, sensor, comment=comment, overwrite=overwrite)
    print(f"{found}\n{out}")
    next_(f"novags capture SET --sensor {out} --electrons 20 --out CAPTURE")
