"""Claims about `novags view` as a command: its address, its end, and what it says where it cannot start."""

import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path

import pytest

Call = Callable[..., int]


def test_it_prints_its_address_serves_a_page_there_and_ends_cleanly_with_ctrl_c(runs: dict[str, Path]) -> None:
    pytest.importorskip("viser", reason="novags view needs the extra view, which is not installed")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()  # so that the viewer has to take another port
        port = taken.getsockname()[1]
        words = [sys.executable, "-m", "novags", "view", str(runs["first"]), "--port", str(port)]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert process.stdout is not None
        name, address = process.stdout.readline().split()
        assert name == "viewer:"
        assert address.startswith("http://127.0.0.1:")
        assert address != f"http://127.0.0.1:{port}"
        with urllib.request.urlopen(address) as page:
            assert b"<!doctype html>" in page.read().lower()
        process.send_signal(signal.SIGINT)
        rest, said = process.communicate(timeout=60)
    assert (process.returncode, rest) == (0, "")
    assert said.splitlines() == ["open it in a browser; stop it with Ctrl-C", "stopped"]


def test_without_viser_one_line_says_how_to_install_it(
    call: Call, runs: dict[str, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert call("view", str(runs["first"])) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("novags: error: novags view needs the package viser, which is not installed: ")
    assert "pip install 'novags[view]'" in line


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((".",), "neither a run"),
        ((), "name at least one folder of a run"),
        (("first", "--port", "70000"), "port must be <= 65535, got 70000"),
        (("first", "--sensor", "kodak"), "unknown sensor 'kodak'"),
        (("first", "--host", "203.0.113.7"), "203.0.113.7"),
    ],
)
def test_what_it_cannot_show_is_one_line(
    call: Call, runs: dict[str, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    tmp_path: Path, words: tuple[str, ...], message: str,
) -> None:  # fmt: skip
    pytest.importorskip("viser", reason="novags view needs the extra view, which is not installed")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "first").symlink_to(runs["first"])
    assert call("view", *words) in (1, 2)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("novags: error: ")
    assert message in line
