"""Claims about who may talk to the viewer, by requests to a real server: its own pages alone."""

import http.client
import socket
from collections.abc import Iterator

import pytest

from novags.testbed.viewer.guard import guarded, names_of

viser = pytest.importorskip("viser", reason="novags view needs the extra view, which is not installed")
from novags.testbed.viewer.server import serving  # noqa: E402

UPGRADE = {
    "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
}  # fmt: skip


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with serving([], "127.0.0.1", 8420) as viewer:
        yield int(viewer.address.rpartition(":")[2])


def status(port: int, headers: list[tuple[str, str]]) -> int:
    """What the server answers to a request with these headers and no others."""
    with socket.create_connection(("127.0.0.1", port), timeout=30) as raw:
        lines = ["GET / HTTP/1.1", *(f"{name}: {value}" for name, value in headers), "", ""]
        raw.sendall("\r\n".join(lines).encode())
        answer = http.client.HTTPResponse(raw)
        answer.begin()
        return answer.status


def asked(port: int, host: str | None, origin: str | None = None, *, socket_: bool = True) -> int:
    headers = [*UPGRADE.items()] if socket_ else []
    headers += [("Host", host.replace("PORT", str(port)))] if host is not None else []
    headers += [("Origin", origin.replace("PORT", str(port)))] if origin is not None else []
    return status(port, headers)


@pytest.mark.parametrize("host", ["127.0.0.1:PORT", "localhost:PORT", "LOCALhost:PORT", "[::1]:PORT", "localhost:9000"])
def test_its_own_page_is_answered_through_a_tunnel_too(port: int, host: str) -> None:
    for scheme in ("http", "https"):
        assert asked(port, host, f"{scheme}://{host.replace('LOCAL', 'local')}") == 101
    assert asked(port, host) == 101  # no browser
    assert asked(port, host, socket_=False) == 200


@pytest.mark.parametrize(
    "origin",
    ["https://evil.example", "http://evil.example:PORT", "http://127.0.0.1", "http://127.0.0.1:1", "http://localhost:PORT",
     "null", "", "http://127.0.0.1:PORT.evil.example", "http://127.0.0.1:PORT/", "evil://evil@127.0.0.1:PORT"],
)  # fmt: skip
def test_a_page_of_another_site_is_refused(port: int, origin: str) -> None:
    """Rationale: it could move cameras, read every picture, and close the viewer."""
    assert asked(port, "127.0.0.1:PORT", origin) == 403
    assert asked(port, "127.0.0.1:PORT", origin, socket_=False) == 403


@pytest.mark.parametrize(
    "host",
    ["evil.example:PORT", "evil.example", "localhost.evil.example", "127.0.0.1.evil.example:PORT", "", "[::1", None],
)
def test_a_name_that_was_made_to_point_here_is_refused(port: int, host: str | None) -> None:
    """Rationale: to the browser, a page there and this server are of one site."""
    for origin in (None, f"http://{host}"):
        assert asked(port, host, origin) == 403
        assert asked(port, host, origin, socket_=False) == 403


def test_two_headers_of_a_kind_are_refused(port: int) -> None:
    good = ("Host", f"127.0.0.1:{port}")
    assert status(port, [good, ("Host", "evil.example")]) == 403
    origins = [("Origin", f"http://127.0.0.1:{port}"), ("Origin", "http://evil.example")]
    for each in (origins, origins[::-1]):
        assert status(port, [good, *each]) == 403


def test_it_is_called_as_the_user_and_the_machine_call_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "Box.lab.example")
    assert names_of("0.0.0.0") == {"0.0.0.0", "localhost", "box.lab.example", "box", "box.local"}
    assert "viewer.lab.example" in names_of("viewer.lab.example")


def start_nothing() -> None:
    with guarded(frozenset()):
        pass


def test_a_viser_that_starts_its_server_in_another_way_is_not_used() -> None:
    with pytest.raises(OSError, match="this version of viser cannot be kept"):
        start_nothing()
