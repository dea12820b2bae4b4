"""The command that shows runs in a browser."""

import threading

from novags.commands import shared
from novags.commands.shared import say
from novags.options import Folders


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
