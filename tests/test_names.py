"""One name, one meaning: no two classes of the packages share a name."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("novags", "simscenes", "sensor_model")
SHARED: dict[str, str] = {}  # names of several classes, each with the reason why they stay


def test_a_class_has_a_name_of_its_own() -> None:
    """Rationale: thirty names meant two to four things each, `Camera` and `Measured` four."""
    places = defaultdict[str, list[str]](list)
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            for statement in ast.parse(path.read_bytes()).body:
                if isinstance(statement, ast.ClassDef):
                    places[statement.name].append(path.relative_to(ROOT).as_posix())
    assert len(places) > 300
    assert {name: found for name, found in places.items() if len(found) > 1 and name not in SHARED} == {}
    assert [name for name in SHARED if len(places[name]) < 2] == []
