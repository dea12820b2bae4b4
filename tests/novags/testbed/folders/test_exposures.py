"""Claims about the exposures at which light is shown: one factor for all held-out views."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed.folders.exposures import as_compared, exposures_of
from sensor_model.isp import linear_to_srgb

LIGHT = np.random.default_rng(0).uniform(0.05, 0.2, (4, 4, 5, 3)).astype(np.float32)
TESTED = (1, 3)


def exposures(
    dark: list[float], lit: list[float] | None, taken: tuple[int, ...] = TESTED, shown: tuple[int, ...] = TESTED
) -> Any:
    """Of a run that renders the light itself; captured and well lit at factors of their own for each view.

    `taken`: views with a dark picture, `shown`: with a well-lit one.
    """
    names = tuple("abcd")
    run: Any = SimpleNamespace(space="linear", enhancement=None, lacks=None,
                               rendering=lambda name: LIGHT[names.index(name)])  # fmt: skip
    capture: Any = SimpleNamespace(
        names=names, cameras=SimpleNamespace(test_indices=list(TESTED)), demosaiced=False,
        holds=lambda part: False, linear=lambda i: np.float32(dark[i]) * LIGHT[i], is_dark=lambda i: i in taken,
    )  # fmt: skip
    bright = [0.0] * 4 if lit is None else lit
    source: Any = SimpleNamespace(
        lit_known=lit is not None, shows=lambda i: lit is not None and i in shown,
        lit=lambda i: linear_to_srgb(np.clip(bright[i] * LIGHT[i], 0, 1)).astype(np.float32),
    )  # fmt: skip
    return exposures_of(run, capture, source)


def expected(factors: list[float], of: tuple[int, ...] = TESTED) -> float:
    cross = sum(factors[i] * float((LIGHT[i].astype(float) ** 2).sum()) for i in of)
    return cross / sum(float((LIGHT[i].astype(float) ** 2).sum()) for i in of)


def test_views_without_a_dark_or_a_lit_picture_say_nothing_about_that_exposure() -> None:
    dark, lit = [0.9, 0.1, 0.7, 0.3], [0.1, 2.0, 0.3, 4.0]
    found = exposures(dark, lit, taken=(1,), shown=(3,))
    assert found.dark == pytest.approx(expected(dark, (1,)), rel=1e-5)
    assert found.lit == pytest.approx(expected(lit, (3,)), rel=1e-4)
    found = exposures(dark, lit, taken=(), shown=())
    assert (found.dark, found.lit) == (None, None)


def test_all_held_out_views_and_no_others_decide() -> None:
    dark, lit = [0.9, 0.1, 0.7, 0.3], [0.1, 2.0, 0.3, 4.0]
    found = exposures(dark, lit)
    assert found.dark == pytest.approx(expected(dark), rel=1e-5)
    assert found.lit == pytest.approx(expected(lit), rel=1e-4)


@pytest.mark.parametrize("black", [1, 3])
def test_a_view_that_is_black_says_nothing_about_the_others(black: int) -> None:
    dark, lit = [0.5] * 4, [2.0] * 4
    dark[black] = lit[black] = 0.0
    found = exposures(dark, lit)
    assert found.dark == pytest.approx(expected(dark), rel=1e-5)
    assert found.lit == pytest.approx(expected(lit), rel=1e-4)


def test_what_is_not_known_or_black_all_over_has_no_exposure() -> None:
    found = exposures([0.5, 0.0, 0.5, 0.0], None)
    assert (found.dark, found.lit) == (None, None)
    assert exposures([0.5] * 4, [0.0] * 4).lit is None


@pytest.mark.parametrize(("exposure", "factor"), [(4.0, 4.0), (None, 1.0)])
def test_light_is_brought_to_the_exposure_of_the_picture_it_is_compared_with(
    exposure: float | None, factor: float
) -> None:
    run: Any = SimpleNamespace(space="linear", enhancement=None)
    known: Any = SimpleNamespace(dark=0.5, lit=exposure)
    found = as_compared(LIGHT[0], run, None, "lit", known)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, linear_to_srgb(factor * LIGHT[0].astype(float)), atol=1e-5)
