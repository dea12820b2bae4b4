"""Claims about packed mosaics."""

import numpy as np
import pytest

from novags.testbed.dataset.recipes.packing import half_size, half_size_intrinsics, packed
from sensor_model.params import CFAS, Cfa


def slowly(frame: np.ndarray, cfa: Cfa) -> dict[str, list[list[int]]]:
    """The pixels of each filter by cell; greens by the other filter of their row."""
    found: dict[str, list[list[int]]] = {name: [] for name in ("R", "G of R", "G of B", "B")}
    for y in range(0, frame.shape[0], 2):
        rows: dict[str, list[int]] = {name: [] for name in found}
        for x in range(0, frame.shape[1], 2):
            for k, letter in enumerate(cfa):
                row = cfa[2 * (k // 2) : 2 * (k // 2) + 2]
                name = letter if letter != "G" else f"G of {row.replace('G', '')}"
                rows[name].append(int(frame[y + k // 2, x + k % 2]))
        for name in found:
            found[name].append(rows[name])
    return found


@pytest.mark.parametrize("cfa", CFAS)
def test_planes_are_red_both_greens_and_blue_whatever_the_pattern(cfa: Cfa) -> None:
    frame = np.random.default_rng(0).integers(0, 2**14, (6, 8)).astype(np.uint16)
    expected = slowly(frame, cfa)
    found = packed(frame, cfa)
    assert found.dtype == np.uint16
    for plane, name in zip(found, ("R", "G of R", "G of B", "B"), strict=True):
        assert plane.tolist() == expected[name]
    green = (np.array(expected["G of R"]) + np.array(expected["G of B"])) / 2  # exact: halves of whole numbers
    assert np.array_equal(half_size(frame, cfa), [expected["R"], green, expected["B"]])


@pytest.mark.parametrize("shape", [(5, 8), (6, 7), (6, 8, 3)])
def test_other_frames_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"must be even for a mosaic, whose cells are 2 x 2 px, got \[.*\]"):
        packed(np.zeros(shape, np.uint16), "RGGB")


def test_a_point_falls_on_half_of_its_pixel() -> None:
    K = np.array([[30.0, 0.5, 12.0], [0.0, 31.0, 9.0], [0.0, 0.0, 1.0]])
    point = np.array([0.3, -0.2, 2.0])
    whole, half = (matrix @ point / point[2] for matrix in (K, half_size_intrinsics(K)))
    assert half[:2] == pytest.approx(whole[:2] / 2)
    assert half[2] == 1
