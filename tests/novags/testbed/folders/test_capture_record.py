"""What the record of a capture says."""

import json
from pathlib import Path
from typing import Any

import numpy as np
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


def test_how_views_differ_is_read_with_the_colour_matrix_that_their_pictures_went_through(
    written: dict[str, Any], tmp_path: Path
) -> None:
    n = written["views"]
    exposures, balances = [1.0 + k for k in range(n)], [[1.0 + k, 1.0, 0.5] for k in range(n)]
    matrix = [[1.5, -0.25, -0.25], [-0.5, 2.0, -0.5], [0.125, -0.375, 1.25]]
    said = {"uneven": {"exposures": exposures, "balances": balances}, "color_matrix": matrix, "burst": 4}
    (tmp_path / "capture.json").write_text(json.dumps(written | said))
    found = read_capture_record(tmp_path / "capture.json")
    assert [found.uneven.times(k) for k in range(n)] == exposures
    light = np.array([0.125, 0.25, 0.0625])  # of the camera, below white
    for k in range(n):
        taken = np.asarray(matrix) @ (light * exposures[k] * balances[k] / (4 * n))
        even = found.uneven.even(taken.reshape(1, 1, 3), k)
        np.testing.assert_allclose(even[0, 0], np.asarray(matrix) @ (light / (4 * n)), rtol=1e-5, atol=1e-9)
    assert found.variety == f"bursts of 4, exposed 1 to {n} times as long, white balance by view"
    (tmp_path / "capture.json").write_text(json.dumps(written))
    assert read_capture_record(tmp_path / "capture.json").variety == ""


@pytest.mark.parametrize("place", [0, -1])
@pytest.mark.parametrize("kind", ["exposures", "balances"])
def test_a_factor_out_of_range_of_any_view_and_a_missing_one_are_refused(
    written: dict[str, Any], tmp_path: Path, place: int, kind: str
) -> None:
    n = written["views"]
    said: dict[str, Any] = {"exposures": [1.0] * n, "balances": [[1.0, 1.0, 1.0] for _ in range(n)]}
    wrong = json.loads(json.dumps(said))
    wrong[kind][place] = 1e9 if kind == "exposures" else [1.0, 1.0, 1e-9]
    (tmp_path / "capture.json").write_text(json.dumps(written | {"uneven": wrong}))
    with pytest.raises(ValueError, match="uneven must hold factors in"):
        read_capture_record(tmp_path / "capture.json")
    del said[kind][place]
    (tmp_path / "capture.json").write_text(json.dumps(written | {"uneven": said}))
    with pytest.raises(ValueError, match="uneven must say exposure and balance of each of"):
        read_capture_record(tmp_path / "capture.json")
