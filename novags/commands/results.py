"""The commands about what is there: score, report, characterise."""

from pathlib import Path

from novags.commands.shared import announce, next_, writing
from novags.options import Folder


def score(run: Folder, *, wait: bool = False) -> None:
    """Score a run, or every run of an experiment, against the truth; write metrics.json.

    Args:
        run: Folder of a run or of an experiment.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed.experiment import score_all

    with writing(run, wait, make=False) as console:
        scores = score_all(run, console)
    for name, mean in scores.items():
        lit = mean["lit"]
        against = f"well lit {_decibels(lit['tone_aligned_psnr'])} (tone-aligned PSNR)"
        if "enhanced" in mean:
            against = f"noise-free exposure {_decibels(mean['enhanced']['aligned_psnr'])} (aligned PSNR), {against}"
        print(f"{name}: {against}")
    next_(f"novags report {run}")


def _decibels(score: float | None) -> str:
    return "not scored, because the reference shows nothing" if score is None else f"{score:.2f} dB"


def report(folder: Folder, *, wait: bool = False) -> None:
    """Write report.html for a scored run or experiment: one self-contained file.

    Args:
        folder: Folder of a run or of an experiment.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed.report.page import write_report

    with writing(folder, wait, make=False) as console:
        path = write_report(folder, console)
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
