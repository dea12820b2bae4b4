"""The choice beside a plain search through everything."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from novags.testbed.study.budget.choice import BETWEEN, Option, along, choice_of, choose, fastest, refined, united

PARTS = ("fixed", "render", "fit")
share = st.sampled_from((0.125, 0.25, 0.5, 1.0))
factor = st.floats(0.01, 2.0)
loss = st.sampled_from((0.0, 0.1, 0.3, 0.7, 1.5, 4.0))  # few values: many choices are equal


@st.composite
def tables(draw: st.DrawFn) -> tuple[dict[str, float], dict[str, list[Option]]]:
    """A made-up experiment and made-up curves."""
    parts = {part: draw(st.floats(0.0, 100.0)) for part in PARTS}
    options = {}
    for name in draw(st.lists(st.sampled_from("abc"), unique=True, max_size=3)):
        options[name] = [
            Option(name, draw(share), draw(st.dictionaries(st.sampled_from(PARTS[1:]), factor)), draw(loss), 0.1)
            for _ in range(draw(st.integers(1, 4)))
        ]
    return parts, options


def slow_seconds(parts: dict[str, float], chosen: tuple[Option, ...]) -> float:
    total = 0.0
    for part, seconds in parts.items():
        for option in chosen:
            if part in option.factors:
                seconds *= option.factors[part]
        total += seconds
    return total


@given(tables(), st.floats(0.0, 250.0))
def test_the_choice_is_the_one_a_search_through_everything_finds(
    table: tuple[dict[str, float], dict[str, list[Option]]], limit: float
) -> None:
    parts, options = table
    every = [(c, slow_seconds(parts, c)) for c in itertools.product(*options.values())]
    fitting = [(sum(o.lost for o in c), -seconds) for c, seconds in every if seconds <= limit * (1 - 1e-9)]
    found = choose(parts, options, limit)
    if not fitting:
        assert found is None or found.seconds == pytest.approx(limit)
        return
    assert found is not None
    least, longest = min((round(lost, 6), minus) for lost, minus in fitting)
    assert found.lost == pytest.approx(least, abs=1e-6)
    assert found.seconds <= limit * (1 + 1e-12)
    assert found.seconds >= -longest * (1 - 1e-9)  # of equal losses the longest
    assert [option.name for option in found.options] == list(options)
    assert found.seconds == pytest.approx(slow_seconds(parts, found.options))
    assert found.sd == pytest.approx(0.1 * math.sqrt(len(options)))


@given(tables())
def test_the_fastest_choice_is_the_fastest_of_all(table: tuple[dict[str, float], dict[str, list[Option]]]) -> None:
    parts, options = table
    least = min(slow_seconds(parts, chosen) for chosen in itertools.product(*options.values()))
    assert fastest(parts, options).seconds == pytest.approx(least)


def test_enough_time_leaves_the_preset_as_it_is() -> None:
    cheap = Option("iterations", 0.5, {"fit": 0.5}, 0.0, 0.2)  # as good, as far as was measured
    own = Option("iterations", 1.0, {"fit": 1.0}, 0.0, 0.0)
    found = choose({"fit": 10.0, "fixed": 1.0}, {"iterations": [cheap, own]}, 11.0)
    assert found is not None
    assert found.options == (own,)


def test_without_options_the_preset_fits_or_does_not() -> None:
    assert choose({"fit": 10.0}, {}, 9.0) is None
    found = choose({"fit": 10.0}, {}, 10.0)
    assert found == choice_of({"fit": 10.0}, [])
    assert found is not None
    assert (found.seconds, found.lost, found.sd) == (10.0, 0.0, 0.0)


def test_between_two_measured_settings_others_follow_the_logarithm_of_their_share() -> None:
    low, high = Option("n", 0.0625, {"fit": 0.1}, 2.0, 0.5), Option("n", 1.0, {"fit": 1.0}, 0.0, 0.0)
    found = refined([high, low])
    assert found[0] == low
    assert found[-1] == high
    assert len(found) == BETWEEN + 2
    assert [option.share for option in found] == pytest.approx([0.0625, 0.125, 0.25, 0.5, 1.0])
    assert found[2].factors == pytest.approx({"fit": math.sqrt(0.1)})
    assert [option.lost for option in found] == pytest.approx([2.0, 1.5, 1.0, 0.5, 0.0])
    assert [option.sd for option in found] == [0.5, 0.5, 0.5, 0.5, 0.0]


def test_curves_of_two_methods_are_united_at_the_shares_of_either_and_their_losses_averaged() -> None:
    """Halfway between the shares 1/4 and 1, in the logarithm, the first has lost half as much."""
    one = [Option("x", 0.25, {"fit": 0.25, "render": 0.3}, 2.0, 0.1), Option("x", 1.0, {"fit": 1.0}, 0.0, 0.0)]
    two = [Option("x", 0.5, {"nerf": 0.4, "sort": 0.2}, 3.0, 0.3), Option("x", 1.0, {"nerf": 1.0}, 0.0, 0.0)]
    for curves in ((one, two), (two, one)):
        found = united(curves)
        assert [option.share for option in found] == [0.5, 1.0]
        assert [option.lost for option in found] == pytest.approx([2.0, 0.0])
        assert [option.sd for option in found] == pytest.approx([math.hypot(0.1, 0.3) / 2, 0.0])
        assert found[0].factors == pytest.approx({"fit": 0.5, "nerf": 0.4, "sort": 0.2})


def test_a_setting_between_two_others_mixes_factors_and_losses_alike_from_either_end() -> None:
    curve = [Option("x", 0.25, {"fit": 0.2}, 2.0, 0.1), Option("x", 1.0, {"fit": 1.0}, 0.0, 0.3)]
    quarter = along(curve, 0.25 * 4**0.25)
    assert quarter.factors["fit"] == pytest.approx(0.2**0.75)
    assert (quarter.lost, quarter.sd) == (pytest.approx(1.5), 0.3)
    assert along(curve, 0.25) == curve[0]
    assert along(curve, 1.0) == curve[1]


def test_between_settings_only_parts_that_both_measured_have_a_factor() -> None:
    low, high = Option("x", 0.25, {"fit": 0.2, "render": 0.5}, 2.0, 0.1), Option("x", 1.0, {"fit": 1.0}, 0.0, 0.3)
    ends = (low, high), (Option("x", 0.25, high.factors, 2.0, 0.1), Option("x", 1.0, low.factors, 0.0, 0.3))
    assert [along(curve, 0.5).factors.keys() for curve in ends] == [{"fit"}, {"fit"}]
