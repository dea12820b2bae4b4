"""Rows of `Method.knobs`: what they stand for, and that the methods accept it."""

import pytest

from novags.methods import METHODS
from novags.methods.knob import MethodKnob
from novags.methods.variant import Variant
from novags.settings import flattened

ROWS = [(method, name) for method in METHODS for name in METHODS[method].knobs]


def test_a_knob_of_one_setting_is_named_after_its_values() -> None:
    row = MethodKnob.of("a.b", (None, 4), "so", ("fit",))
    assert row.settings == {None: {"a.b": None}, 4: {"a.b": 4}}
    assert (row.default({"a.b": 4, "c": 1}), row.default({"a.b": None})) == (4, None)


def test_of_several_settings_all_must_agree_to_be_the_default() -> None:
    row = MethodKnob(settings={"thin": {"w": (1, 2), "b": 3}, "wide": {"w": (1, 2), "b": 9}}, why="so")
    assert row.default({"w": (1, 2), "b": 9}) == "wide"
    with pytest.raises(
        ValueError, match=r"no setting of the knob agrees with the configuration \(w = \(1, 2\), b = 4\)"
    ):
        row.default({"w": (1, 2), "b": 4})


def test_settings_that_leave_each_other_as_they_are_are_refused() -> None:
    """Rationale: what one of them does not set stays at the default there, which the name does not say."""
    with pytest.raises(ValueError, match="must set the same names, got b, w / w"):
        MethodKnob(settings={"thin": {"w": 1, "b": 3}, "wide": {"w": 2}}, why="so")


def test_a_knob_is_either_of_settings_or_of_an_option() -> None:
    for wrong in (
        {}, {"option": "points"}, {"shares": (0.5, 1.0)},
        {"option": "points", "shares": (1.0,), "settings": {1: {"a": 1}}},
        {"option": "points", "settings": {1: {"a": 1}}},
    ):  # fmt: skip
        with pytest.raises(ValueError, match="either settings, or an option"):
            MethodKnob(why="so", **wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(("method", "name"), ROWS)
def test_a_method_accepts_every_setting_that_its_rows_name(method: str, name: str) -> None:
    row = METHODS[method].knobs[name]
    for setting in row.settings.values():
        config = flattened(Variant(name="x", method=method, settings=setting).config(METHODS[method].config(), {}))
        assert {key: config[key] for key in setting} == dict(setting)


def test_the_parts_of_a_row_are_parts_of_its_method() -> None:
    for method, name in ROWS:
        parts = METHODS[method].parts
        assert parts is not None
        assert set(METHODS[method].knobs[name].parts) <= set(parts(METHODS[method].config()))
