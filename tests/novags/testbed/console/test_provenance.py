"""Peaks of memory in records."""

from pathlib import Path
from typing import Any

import pytest

from novags.testbed.console import provenance


def test_a_peak_is_in_bytes_where_there_is_no_proc_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: the other source counts kilobytes. It may still hold a larger peak of the program that began this."""

    def missing(*_: Any, **__: Any) -> str:
        raise FileNotFoundError("no /proc")

    held = bytearray(100_000_000)
    usual = provenance._high_water_mark()
    monkeypatch.setattr(Path, "read_text", missing)
    assert len(held) <= usual / 1.5 <= provenance._high_water_mark() <= 100 * usual
