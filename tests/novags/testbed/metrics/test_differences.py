"""Differences carry errors that cover the truth as often as they say; nothing is ranked that is not seen to differ."""

import numpy as np
import pytest
from scipy import stats

from novags.testbed.metrics.differences import (
    LEVEL,
    POWER,
    Estimate,
    Scatter,
    Values,
    difference,
    estimate,
    order,
    places,
    quantile,
    share,
    smallest_seen,
)

TRUE, TIMES = 0.7, 600  # dB; simulated studies
SPREAD = Scatter(scenes=0.5, seeds=0.2, views=0.3)
BOUND = 5 * np.sqrt(LEVEL * (1 - LEVEL) / TIMES)  # of a share of so many


def values(table: np.ndarray) -> Values:
    """Of [scenes, seeds, views]."""
    return {(f"scene {s}", f"seed {k}", f"view {v}"): float(x) for (s, k, v), x in np.ndenumerate(table)}


def study(rng: np.random.Generator, scenes: int, seeds: int, views: int, gain: float = TRUE) -> tuple[Values, Values]:
    """Two methods of which one is better: views and scenes differ by far more than they do, and both share that."""
    shape = (scenes, seeds, views)
    shared = 25 + rng.normal(0, 3, (scenes, 1, views)) + rng.normal(0, 1, shape)
    apart = (
        gain
        + rng.normal(0, SPREAD.scenes, (scenes, 1, 1)) * (scenes > 1)  # of one scene, this scene is meant
        + rng.normal(0, SPREAD.seeds, (scenes, seeds, 1)) * (seeds > 1)  # one seed cannot tell of others
        + rng.normal(0, 0.2, (scenes, 1, views)) * (views > 1)
        + rng.normal(0, SPREAD.views, shape)
    )
    return values(shared + apart), values(shared)


@pytest.mark.parametrize(("scenes", "seeds", "views"), [(3, 1, 3), (5, 2, 2), (2, 1, 1), (1, 1, 3), (1, 6, 1)])
def test_intervals_cover_the_true_difference_as_often_as_they_say(scenes: int, seeds: int, views: int) -> None:
    rng, hits = np.random.default_rng(scenes + 10 * seeds + 100 * views), []
    for _ in range(TIMES):
        found = difference(*study(rng, scenes, seeds, views))
        assert found is not None
        assert found.half is not None
        hits.append(abs(found.value - TRUE) <= found.half)
    assert np.mean(hits) == pytest.approx(LEVEL, abs=BOUND)


def test_of_one_scene_with_several_seeds_and_views_intervals_cover_at_least_that_often() -> None:
    """Both kinds of effects are estimated from few: the interval errs to the wide side."""
    for seeds, views in ((2, 3), (4, 3), (6, 8)):
        rng, hits = np.random.default_rng(seeds + views), []
        for _ in range(TIMES):
            found = difference(*study(rng, 1, seeds, views))
            assert found is not None
            assert found.half is not None
            hits.append(abs(found.value - TRUE) <= found.half)
        assert LEVEL - BOUND <= np.mean(hits) <= 1.0


def test_equal_methods_are_told_apart_as_seldom_as_the_level_says() -> None:
    rng = np.random.default_rng(0)
    firsts = []
    for _ in range(TIMES):
        one, other = study(rng, 3, 1, 3, gain=0.0)
        firsts.append(sorted(places({"one": one, "other": other}, True, 2).values()))
    assert np.mean([found == [1, 2] for found in firsts]) == pytest.approx(1 - LEVEL, abs=BOUND)


def test_an_error_says_what_it_is_over_and_how_many() -> None:
    rng = np.random.default_rng(0)
    for shape, over, freedom, where in (
        ((4, 2, 3), "scenes", 3, "4 scenes"),
        ((1, 1, 3), "views", 2, "this scene, 3 views"),
        ((1, 5, 1), "seeds", 4, "this scene, 5 seeds"),
        ((1, 5, 3), "views and seeds", None, "this scene, 3 views and 5 seeds"),
    ):
        found = difference(*study(rng, *shape))
        assert found is not None
        assert (found.over, found.where) == (over, where)
        assert freedom is None or found.freedom == freedom
    alone = difference(*study(rng, 1, 1, 1))
    assert alone is not None
    assert (alone.error, alone.half, alone.seen) == (None, None, False)
    assert estimate({}) is None


def test_seeds_and_views_are_counted_where_they_are_most() -> None:
    small, large = values(np.ones((1, 1, 1))), {("other", *key[1:]): x for key, x in values(np.ones((1, 3, 2))).items()}
    for both in (small | large, large | small):
        found = estimate(both)
        assert found is not None
        assert (found.scenes, found.seeds, found.views) == (2, 3, 2)


def test_only_what_both_have_is_compared() -> None:
    one = {("s", "0", "a"): 3.0, ("s", "0", "b"): 5.0, ("s", "0", "c"): float("inf")}
    other = {("s", "0", "a"): 1.0, ("s", "0", "b"): 2.0, ("s", "0", "c"): 9.0, ("s", "0", "d"): 9.0}
    found = difference(one, other)
    assert found is not None
    assert (found.value, found.views) == (2.5, 2)
    assert found.error == pytest.approx(0.5)
    assert difference(one, {("elsewhere", "0", "a"): 1.0}) is None


def test_a_share_has_the_error_that_it_scatters_by() -> None:
    """Half of the span is won; the floor's own scatter is in both differences, and cancels in part."""
    rng, found = np.random.default_rng(1), []
    for _ in range(TIMES):
        floor = 20 + rng.normal(0, 3, (1, 1, 8))
        gain = 4 + rng.normal(0, 0.5, (1, 1, 8))
        one = floor + 0.5 * gain + rng.normal(0, 0.3, (1, 1, 8))
        known = share(values(one), values(floor), values(floor + gain))
        assert known is not None
        assert known.half is not None
        found.append(abs(known.value - 0.5) <= known.half)
    assert np.mean(found) == pytest.approx(LEVEL, abs=BOUND)


def test_a_share_is_of_what_all_three_have() -> None:
    """Half of the span is won in each scene that has all three; where the ceiling failed the gain is 20 dB."""
    floor, gain = np.full((4, 1, 1), 20.0), np.array([[[4.0]], [[4.2]], [[3.9]], [[40.0]]])
    one, ceiling = values(floor + gain / 2 + np.array([[[0.01]], [[-0.01]], [[0.0]], [[0.0]]])), values(floor + gain)
    ceiling = {key: value for key, value in ceiling.items() if key[0] != "scene 3"}
    known = share(one, values(floor), ceiling)
    assert known is not None
    assert known.value == pytest.approx(0.5, abs=0.002)
    assert known.scenes == 3


@pytest.mark.parametrize("more", [True, False])
def test_two_are_compared_by_the_values_that_both_have_whatever_else_either_has(more: bool) -> None:
    """a is 1 worse than b wherever it has values, and has none where all do badly."""
    sign, jitter = (1 if more else -1), np.array([[[0.03]], [[-0.02]], [[0.01]]])
    easy, hard = np.array([[[30.0]], [[31.0]], [[30.5]]]), np.full((3, 1, 1), 20.0)
    a, b = values(sign * (easy - 1 + jitter)), values(sign * np.concatenate([easy, hard]))
    c = values(sign * (np.concatenate([easy, hard]) - 3 + np.linspace(0, 0.1, 6).reshape(6, 1, 1)))
    assert places({"a": a, "b": b, "c": c}, more, 2) == {"b": 1, "a": 2, "c": 3}
    assert order({"a": a, "b": b, "c": c}, more) == order({"c": c, "a": a, "b": b}, more) == ["b", "a", "c"]


def test_without_a_value_in_common_nothing_is_seen_and_means_order() -> None:
    a, b = {("s", "0", "v"): 25.0}, {("s", "1", "v"): 26.0}
    assert places({"a": a, "b": b}, True, 2) == {"a": 1, "b": 1}
    assert order({"a": a, "b": b}, True) == ["b", "a"]
    assert order({"a": a, "b": {}, "c": {("s", "0", "v"): np.inf}}, True) == ["c", "a"]


def test_a_mean_is_over_scenes_however_many_views_each_has() -> None:
    """One scene of 100 views, where a is 1 above; ten of 2 views, where it is 1 below, by .1 of them more or less."""
    views = {("large", "0", str(v)): 1.0 for v in range(100)}
    views |= {(f"{s}", "0", str(v)): -1 - 0.01 * s for s in range(10) for v in range(2)}
    zero = dict.fromkeys(views, 0.0)
    assert places({"a": views, "b": zero}, True, 2) == {"a": 2, "b": 1}
    assert order({"a": views, "b": zero}, True) == ["b", "a"]


@pytest.mark.parametrize(("span", "known"), [(0.25, False), (3.0, True), (-3.0, False)])
def test_there_is_no_share_of_a_span_that_is_mostly_scatter(span: float, known: bool) -> None:
    floor = np.array([[[20.0, 24.0, 22.0]]])
    ceiling = floor + span + np.array([0.1, -0.12, 0.02])
    assert (share(values(floor + span / 2), values(floor), values(ceiling), 0.3) is not None) == known
    two = {key: value for key, value in values(floor).items() if key[2] != "view 2"}
    assert share(two, two, values(ceiling)) is None or span == 3.0  # of two views 12.7 errors are asked for


def test_methods_that_are_not_seen_to_differ_share_a_place() -> None:
    """b is .03 above a, by views that are dB apart; c is clearly below both, and its place is the third."""
    views = np.array([[[20.0, 23.7, 25.0]]])
    found = places(
        {"a": values(views), "b": values(views + [0.5, -0.6, 0.19]), "c": values(views - [4.0, 4.2, 4.1])}, True, 2
    )
    assert found == {"a": 1, "b": 1, "c": 3}


def test_numbers_that_are_printed_alike_share_a_place_whatever_their_errors() -> None:
    same = np.full((1, 1, 4), 0.001)
    found = places({"a": values(same), "b": values(same + 0.0002), "c": values(same + 0.002)}, False, 3)
    assert found == {"a": 1, "b": 1, "c": 3}
    alone = {name: values(np.full((1, 1, 1), x)) for name, x in (("a", 3.0), ("b", 5.0), ("c", 5.0), ("d", np.inf))}
    assert places(alone, True, 2) == {"d": 1, "b": 2, "c": 2, "a": 4}
    assert places(alone, False, 2) == {"a": 1, "b": 2, "c": 2, "d": 4}
    assert places({}, True, 2) == {}
    assert places({"a": values(same[..., :1]), "b": values(same[..., :1] + 1)}, True, 3) == {"a": 2, "b": 1}


@pytest.mark.parametrize(("scenes", "seeds", "views"), [(4, 1, 3), (1, 1, 12), (6, 2, 2)])
def test_a_study_sees_the_difference_that_it_says_it_can_see(scenes: int, seeds: int, views: int) -> None:
    spread = Scatter(scenes=SPREAD.scenes, seeds=SPREAD.seeds * (seeds > 1), views=float(np.hypot(SPREAD.views, 0.2)))
    least = smallest_seen(scenes, seeds, views, spread)
    assert least is not None
    rng, seen = np.random.default_rng(2), []
    for _ in range(TIMES):
        found = difference(*study(rng, scenes, seeds, views, gain=least))
        seen.append(isinstance(found, Estimate) and found.seen)
    assert np.mean(seen) == pytest.approx(POWER, abs=0.1)
    assert smallest_seen(1, 1, 1, spread) is None
    freedom = scenes - 1 if scenes > 1 else views - 1
    within = spread.seeds**2 / seeds + spread.views**2 / (seeds * views)
    error = np.sqrt((spread.scenes**2 + within) / scenes if scenes > 1 else within)
    drawn = (rng.normal(least / error, 1, 200_000)) / np.sqrt(rng.chisquare(freedom, 200_000) / freedom)
    assert np.mean(drawn > stats.t.ppf(0.975, freedom)) == pytest.approx(POWER, abs=0.005)  # 5 errors of so many draws
    assert quantile(1e9) == pytest.approx(1.96, abs=1e-3)
