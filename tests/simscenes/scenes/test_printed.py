"""Printed pages: the type that they are set in is ours to pass on, and what stands on them is there."""

from pathlib import Path

import numpy as np
import pytest

from simscenes.scenes.printed.pages import CHART, FONT, page


def test_the_type_is_the_one_that_came_with_matplotlib_and_its_licence_lies_beside_it() -> None:
    """Rationale: scenes were set in it, and must stay as they are where matplotlib is not installed."""
    matplotlib = pytest.importorskip("matplotlib", reason="matplotlib is not installed (scripts/setup dev)")
    theirs = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    for name in (FONT.name, "LICENSE_DEJAVU"):
        assert FONT.with_name(name).read_bytes() == (theirs / name).read_bytes()


def test_a_page_has_its_lines_from_top_to_bottom_in_ink_on_paper() -> None:
    def made(*lines: str) -> np.ndarray:
        texels = page((300, 200), np.random.default_rng(0), lines, paper="f2ead8", shrink=0.7)
        dark: np.ndarray = (texels.mean(-1) < 0.5 * np.median(texels))[::-1].mean(1)  # row 0 is the lower edge
        return dark

    full, above = made(*CHART[:4]), made(*CHART[:2], " ", " ")
    written = np.flatnonzero(full > 0.02)
    assert 0.08 * 200 <= written[0] < written[-1] < 300 - 0.08 * 200  # between the margins
    assert np.count_nonzero(np.diff(written) > 2) == 3  # four lines
    assert np.array_equal(full[:170], above[:170])
    assert not above[200:].any()
