"""The command line in this process."""

import sys

import pytest

from novags import cli


def command(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """Run a command; its exit code."""
    monkeypatch.setattr(sys, "argv", ["novags", *words])
    monkeypatch.setattr("signal.signal", lambda *_: None)  # pytest keeps its own handlers
    try:
        cli.main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0
