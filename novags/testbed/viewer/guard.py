"""Who may talk to the viewer: its own pages alone.

A page of any site that is open in the same browser can reach this machine too. Its requests name that site as `Origin`;
or, where a name of that site has been made to point here, as `Host`.
"""

import ipaddress
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

Handler = Callable[[Any, Any], Any]  # of an HTTP request before it is answered, as `websockets` has it


def refusal(origins: list[str], hosts: list[str], names: frozenset[str]) -> str:
    """Why a request is refused; "" if it is not.

    Args:
        origins: The headers `Origin`: the origin of the page that asks. Programs other than browsers send none.
        hosts: The headers `Host`: the address that the browser was told to open.
        names: Which that may be, beside addresses, which nobody can make point elsewhere.
    """
    host = _named(f"//{hosts[0]}") if len(hosts) == 1 else None
    if host is None or not (host in names or _is_address(host)):
        return (f"this viewer is not called {', '.join(hosts) or 'nothing'}: open it by its address, or start it with "
                "--host NAME")  # fmt: skip
    if any(origin.partition("://")[2].lower() != hosts[0].lower() for origin in origins):
        return f"only the viewer's own page may ask, not one of {', '.join(origins)}"
    return ""


def _named(url: str) -> str | None:
    """The host in an address, without its port; None if there is none."""
    try:
        return (urlsplit(url).hostname or "").removesuffix(".") or None
    except ValueError:
        return None


def _is_address(host: str) -> bool:
    try:
        return bool(ipaddress.ip_address(host))
    except ValueError:
        return False


def names_of(host: str) -> frozenset[str]:
    """The names that a viewer has which listens there: `host` itself, and the names of this machine."""
    here = socket.gethostname()
    short = here.partition(".")[0]
    return frozenset(name.lower() for name in (host, "localhost", here, short, f"{short}.local") if name)


@contextmanager
def guarded(names: frozenset[str]) -> Iterator[None]:
    """Servers of viser that are started here refuse what `refusal` does; viser has no option for that.

    Raises:
        OSError: If this version of viser starts its server in another way: it would answer everybody.
    """
    from websockets.asyncio import server

    serve, started = server.serve, []

    def guarding(*words: Any, process_request: Handler | None = None, **options: Any) -> Any:
        started.append(True)
        return serve(*words, process_request=partial(_answer, names, process_request), **options)

    server.serve = guarding  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]
    if not started:
        raise OSError("this version of viser cannot be kept from answering pages of other sites: "
                      "pip install 'novags[view]' installs one that can")  # fmt: skip


def _answer(names: frozenset[str], answer: Handler | None, connection: Any, request: Any) -> Any:
    """The answer of viser, or a refusal."""
    if why := refusal(request.headers.get_all("Origin"), request.headers.get_all("Host"), names):
        return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n")
    return None if answer is None else answer(connection, request)
