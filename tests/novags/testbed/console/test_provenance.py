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


@pytest.mark.parametrize("place", [0, 1, 3])
def test_a_fact_is_found_on_whichever_line_of_the_system_it_stands(place: int, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = {"/proc/self/status": "VmHWM:\t  1234 kB", "/proc/cpuinfo": "model name\t: A fast one"}

    def read_text(path: Path, **_: Any) -> str:
        others = [f"Other{k}: {k}" for k in range(3)]
        return "\n".join([*others[:place], lines[str(path)], *others[place:]])

    monkeypatch.setattr(Path, "read_text", read_text)
    assert provenance._high_water_mark() == 1234 * 1024
    assert provenance._processor() == "A fast one"
