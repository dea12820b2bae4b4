"""docs/faults.md names for every fault the test that shows it."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_every_fault_of_the_page_has_a_test_that_exists() -> None:
    tests = "".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    rows = [line.split(" | ") for line in (ROOT / "docs" / "faults.md").read_text().splitlines() if line[:2] == "| "]
    assert len(rows) > 15
    for fault, *_, named in rows[2:]:
        names = re.findall(r"`(test_\w+)`", named)
        assert names, fault
        assert [name for name in names if f"def {name}(" not in tests] == []
