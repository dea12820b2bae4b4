"""What the record of a capture says."""

import json
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.folders.capture_record import read_capture_record
from tests.fuzz.readers.records import make_capture


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("recorded")
    make_capture(folder)
    content: dict[str, Any] = json.loads((folder / "capture" / "capture.json").read_text())
    return content


@pytest.mark.parametrize(
    ("said", "seeds"), [({"seed": 3, "noise_seed": 5}, (3, 5)), ({"seed": 3}, (3, 3)), ({}, (0, 0))]
)
def test_the_noise_has_the_seed_that_was_asked_for_unless_it_has_its_own(
    written: dict[str, Any], said: dict[str, int], seeds: tuple[int, int], tmp_path: Path
) -> None:
    kept = {name: value for name, value in written.items() if name not in ("seed", "noise_seed")}
    (tmp_path / "capture.json").write_text(json.dumps(kept | said))
    found = read_capture_record(tmp_path / "capture.json").simulated
    assert found is not None
    assert (found.seed, found.noise_seed) == seeds
