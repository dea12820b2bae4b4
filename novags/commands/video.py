"""The command that films a flight through a reconstruction."""

import os
from pathlib import Path

from novags.commands.shared import next_, say, typed, writing
from novags.options import Folder


def video(
    run: Folder, *, out: Path | None = None, seconds: float = 8.0, fps: float = 24.0, overwrite: bool = False,
    wait: bool = False, dry_run: bool = False,
) -> None:  # fmt: skip
    """Film a flight through a run, on a smooth path through its training cameras, beside truth and dark pictures.

    Truth and dark pictures are known at the cameras alone: in between, the nearest camera's are shown, and the film
    says so.

    Args:
        run: Folder of a run that holds Gaussians or a radiance field.
        out: The film: .mp4 (MPEG-4), or .webp, which every browser plays; if not given, RUN.mp4 beside the run.
        seconds: How long it takes.
        fps: Frames a second.
        overwrite: Replace a file that is there.
        wait: If another process is making the same film, wait until it is done instead of refusing.
        dry_run: Only say which file would be made, or made again. Nothing is written.
    """
    from novags.testbed.flight.video import check_length, make_video
    from novags.testbed.folders.run import open_run
    from novags.testbed.stages.paths import keep_apart
    from sensor_model.files.atomic import sweep_file

    check_length(seconds, fps)
    opened, place = open_run(run), Path(os.path.realpath(run))
    path = out or place.with_name(f"{place.name}.mp4")  # not with_suffix: a name may hold a dot, as sh0.5 does
    keep_apart(path, run)
    with writing(path.parent, wait, name=f".{path.name}.lock", dry_run=dry_run) as console:
        if path.exists() and not overwrite:
            raise ValueError(f"{path} is there already: choose another --out, or add --overwrite")
        if not dry_run:
            sweep_file(path)
        frames = make_video(opened, path, console, seconds=seconds, fps=fps)
        say(f"{path}: {frames} frames")
        next_(f"novags report {typed(run)}")
