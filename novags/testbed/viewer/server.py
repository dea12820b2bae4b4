"""The viewer's web server."""

import contextlib
import io
import socket
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from novags.numbers import check_range
from novags.testbed.viewer.guard import guarded, names_of
from novags.testbed.viewer.session import Session
from novags.testbed.viewer.shown import Shown
from sensor_model.files.reading import brief

NEEDS = "novags view needs the package viser, which is not installed: pip install 'novags[view]'"


def check_installed() -> None:
    """Raise ValueError with what to do where viser is not installed."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise ValueError(f"{NEEDS} (or pip install 'novags[view]'; {brief(error)})") from error


@dataclass(frozen=True)
class Viewer:
    """A viewer that is being served: its address, and the content of every connected browser."""

    address: str
    sessions: dict[int, Session] = field(default_factory=dict)


@contextlib.contextmanager
def serving(all_shown: Sequence[Shown], host: str, port: int) -> Iterator[Viewer]:
    """Serve while the block runs.

    Args:
        all_shown: The captures and their runs.
        host: Name or address of the network interface: "127.0.0.1" for this machine alone, "0.0.0.0" for all.
        port: Where to listen; the next free one where it is taken.

    Raises:
        ValueError: If viser is not installed, or the port is out of range.
        OSError: If nothing can be served at that host and port.
    """
    check_installed()
    check_range("port", port, 1, 65535)
    check_host(host)
    server = started(host, port)
    viewer = Viewer(address_of(host, server.get_port()))
    computing = threading.Lock()

    def connect(client: Any) -> None:
        viewer.sessions[client.client_id] = Session(client, all_shown, computing)

    def disconnect(client: Any) -> None:
        if (session := viewer.sessions.pop(client.client_id, None)) is not None:
            session.latest.end()

    try:
        server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="large")
        server.on_client_connect(connect)
        server.on_client_disconnect(disconnect)
        yield viewer
    finally:
        for session in list(viewer.sessions.values()):
            session.latest.end()
        with silent():
            server.stop()


def address_of(host: str, port: int) -> str:
    """The address to open in a browser on this machine."""
    named = "localhost" if host in ("", "0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    return f"http://{named}:{port}"


def check_host(host: str) -> None:
    """Raise OSError for a host that is not this machine's: viser would try port after port, and wait for ever."""
    try:
        with socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET):
            pass
    except OSError as error:
        raise OSError(
            f"cannot listen at --host {host} ({error.strerror or error}): give a name or an address of this machine, "
            "127.0.0.1 or 0.0.0.0 for example"
        ) from error


def started(host: str, port: int) -> Any:
    """A server of viser, which answers its own pages alone."""
    import viser

    with silent(), guarded(names_of(host)):
        return viser.ViserServer(host=host, port=port, label="novags view", verbose=False)


def silent() -> contextlib.redirect_stdout[io.StringIO]:
    """Around the prints of viser."""
    return contextlib.redirect_stdout(io.StringIO())
