"""The controls of the viewer and where they stand at the start."""

from typing import Any
from unittest.mock import MagicMock

import pytest

from novags.testbed.viewer.panel import LEVELS, ControlPanel


def test_one_button_changes_between_two_methods() -> None:
    gui: Any = MagicMock()
    gui.add_dropdown.side_effect = lambda *_, **__: MagicMock()
    panel = ControlPanel(gui, ["a"], 20.0, MagicMock())
    panel.method.value, panel.other.value = "best", "floor"
    (press,) = panel.switch.on_click.call_args.args
    press(None)
    assert (panel.method.value, panel.other.value) == ("floor", "best")
    press(None)
    assert (panel.method.value, panel.other.value) == ("best", "floor")


@pytest.mark.parametrize(("electrons", "level"), [(100.0, 2.0), (1e-5, LEVELS[0]), (1e9, LEVELS[1])])
def test_the_light_starts_at_that_of_the_capture_within_the_range_of_the_slider(electrons: float, level: float) -> None:
    gui: Any = MagicMock()
    ControlPanel(gui, ["a"], electrons, MagicMock())
    _, low, high, _, start = gui.add_slider.call_args.args
    assert (low, high) == LEVELS
    assert start == pytest.approx(level)
