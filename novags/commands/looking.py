"""The commands that show runs: in a browser, and as a film."""

import os
import threading
from pathlib import Path

from novags.commands import shared
from novags.commands.shared import next_, say, typed, writing
from novags.options import Folder, Folders


def view(runs: Folders, *, host: str = "127.0.0.1", port: int = 8080, sensor: str | None = None) -> None:
    """Show runs in a browser: Gaussians, cameras, pictures, and any view exposed again at any light level.

    Args:
        runs: Folders of runs, of experiments, or folders that hold such.
        host: Where to listen: 127.0.0.1 for browsers on this machine, 0.0.0.0 for every machine that can
            reach it. No password is asked for.
        port: Port to listen at; the next free one where it is taken.
        sensor: Camera that views are exposed again with, a name or a TOML file; if not given, the capture's.
    """
    from novags.numbers import check_range
    from novags.testbed.viewer.server import check_installed, serving
    from novags.testbed.viewer.shown import shown_of

    check_range("port", port, 1, 65535)
    check_installed()
    console = shared.console()
    if not runs:
        raise ValueError("name at least one folder of a run, of an experiment, or of several of them")
    try:
        with serving(shown_of(runs, console, sensor), host, port) as viewer:
            say(f"viewer: {viewer.address}")
            console.note("open it in a browser; stop it with Ctrl-C")
            threading.Event().wait()
    except KeyboardInterrupt:  # the way to end it
        console.note("stopped")


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
