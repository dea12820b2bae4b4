from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from novags.methods.averaging import scene, surface, warp
from novags.testbed.stability import Case, Setting, measured

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


class Warped:
    """A matrix of weights with wrong squares."""

    def __init__(self, matrix: Any, squares: Callable[[Any], Any]) -> None:
        self.matrix, self.squares = matrix, squares

    def power(self, n: int) -> Any:
        return self.squares(self.matrix)

    def __matmul__(self, other: np.ndarray) -> np.ndarray:
        return np.asarray(self.matrix @ other)


@pytest.mark.parametrize(
    ("squares", "name"),
    [
        (lambda matrix: matrix, "exposures as good as each other"),
        (lambda matrix: matrix.power(2).toarray() + 1e-9, "variances from 1e-12 to 1e6"),
    ],
    ids=["weights instead of squares", "a little of every pixel"],
)
def test_wrong_variances_of_what_was_warped_are_noticed(
    fails: Fails, monkeypatch: pytest.MonkeyPatch, squares: Callable[[Any], Any], name: str
) -> None:
    def spoiled(*arguments: Any) -> tuple[Warped, np.ndarray]:
        matrix, seen = warp.warp(*arguments)
        return Warped(matrix, squares), seen

    monkeypatch.setattr(scene, "warp", spoiled)
    assert fails(name, "numpy")


def test_lengths_that_have_a_unit_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    near = lambda expected, found, tolerance: np.abs(expected - found) <= tolerance  # noqa: E731
    monkeypatch.setattr(surface, "same_depth", near)
    monkeypatch.setattr(warp, "same_depth", near)
    assert fails("worlds from 1e-9 to 1e9 in size", "numpy")


def test_planes_without_a_least_angle_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surface, "GRAZING", 0.0)
    with np.errstate(all="ignore"):
        assert fails("a surface seen exactly from the side", "numpy")


def test_dividing_by_the_weight_of_no_view_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def divided(*arguments: Any) -> scene.Average:
        found = average(*arguments)
        return scene.Average(found.mean * np.inf, found.variance, found.views)

    average = scene.average
    monkeypatch.setattr("novags.testbed.stability.parts.methods.average.average", divided)
    with np.errstate(all="ignore"):
        assert fails("pixels that no exposure sees", "numpy")
