"""Claims about the lines of a table: what is gathered, averaged and ranked together."""

from typing import Any

import pytest

from novags.testbed.report.grid import Line, first_places, lines_of, main_column, over_scenes, shown_columns, verdict

PSNR, LIT = "enhanced.aligned_psnr", "lit.tone_aligned_psnr"
AXES = {"scene": ("s", "t"), "electrons": (5, 50), "method": ("a", "b"), "seed": (0, 1)}
COMPETES = {"a": True, "b": True}


def test_a_column_that_any_line_has_a_value_in_is_shown() -> None:
    lines = [
        Line({}, "a", [], {PSNR: (20.0, None)}),
        Line({}, "b", [], {"enhanced.flip": (0.2, None)}),
        Line({}, "c", []),
    ]
    assert [column[0] for column in shown_columns(lines)] == [PSNR, "enhanced.flip"]


def rows() -> list[dict[str, Any]]:
    """In each place both methods by two seeds: a has 20 and 22, b 23 and 25, in scene t the other way round."""
    values = {"a": (20.0, 22.0), "b": (23.0, 25.0)}
    found = [{"scene": scene, "electrons": electrons, "method": method, "seed": seed, "state": "done",
              PSNR: values["ab"[("ab".index(method) + (scene == "t")) % 2]][seed], LIT: 10.0 + seed}
             for scene in AXES["scene"] for electrons in (5, 50) for method in "ab" for seed in (0, 1)]  # fmt: skip
    return [{"run": k, **row} for k, row in enumerate(found, 1)]


def test_runs_that_differ_in_their_seed_alone_are_one_line_with_the_mean_of_all() -> None:
    lines = lines_of(rows(), AXES, COMPETES)
    assert [(line.place["scene"], line.place["electrons"], line.method) for line in lines] == [
        (scene, electrons, method)
        for scene in "st"
        for electrons in (5, 50)
        for method in ("ba" if scene == "s" else "ab")
    ]
    assert {len(line.runs) for line in lines} == {2}
    assert [line.spread[PSNR] for line in lines] == [(24.0, pytest.approx(2**0.5)), (21.0, pytest.approx(2**0.5))] * 4
    assert [line.places[PSNR] for line in lines] == [1, 2] * 4
    assert [line.places[LIT] for line in lines] == [1, 1] * 4
    assert all(line.alike for line in lines)
    assert first_places(lines, PSNR) == {"b": 2, "a": 2}


@pytest.mark.parametrize("other", range(1, 5))
def test_runs_with_a_reference_of_their_own_rank_nothing_in_their_whole_place(other: int) -> None:
    """Whichever run of the place it is, the first one or not, of the first method or not."""
    enhancements = dict.fromkeys(range(1, 17), "x") | {other: "y"}
    lines = lines_of(rows(), AXES, COMPETES, enhancements)
    assert [line.alike for line in lines] == [line.place != {"scene": "s", "electrons": 5} for line in lines]
    assert [PSNR in line.places for line in lines] == [line.alike for line in lines]
    assert all(LIT in line.places for line in lines)
    assert main_column(lines) == LIT


@pytest.mark.parametrize("last", range(4))
def test_light_that_truth_exposes_takes_no_place_by_plain_scores_whichever_run_ends_in_it(last: int) -> None:
    table = [row | {"lit.psnr": 15.0} for row in rows()[:4]]
    table[last]["linear.psnr"] = 30.0
    lines = lines_of(table, AXES, COMPETES)
    assert {line.method: line.in_linear_light for line in lines} == {"a": last < 2, "b": last >= 2}
    assert {line.method: "lit.psnr" in line.places for line in lines} == {"a": last >= 2, "b": last < 2}


def test_the_verdict_counts_every_place() -> None:
    table = [row for row in rows() if (row["scene"], row["electrons"]) != ("t", 50)]
    said = verdict(lines_of(table, AXES, COMPETES), COMPETES)
    assert said.startswith("b comes first in 2 of 3 comparisons by")
    assert "; a in 1." in said


def test_the_score_that_decides_is_one_that_every_line_with_scores_has() -> None:
    both, lit, none = {PSNR: (20.0, None), LIT: (20.0, None)}, {LIT: (20.0, None)}, dict[str, Any]()
    for spreads, main in (((both, lit), LIT), ((lit, both), LIT), ((none, both), PSNR), ((both, none), PSNR)):
        assert main_column([Line({}, "a", [], dict(spread)) for spread in spreads]) == main
    assert main_column([Line({}, "a", [])]) is None


def test_a_method_that_sees_no_truth_is_told_of_though_another_one_is_listed_first() -> None:
    competes = {"a": False, "b": True}
    found = lines_of([row for row in rows() if row["scene"] == "t"], AXES, competes)
    assert [line.method for line in found] == ["a", "b"] * 2
    assert verdict(found, competes).startswith("Nowhere do two methods that see no truth compete")
    assert verdict(found, {"a": False, "b": False}) == "Only methods that see truth were run."
    found = lines_of([row for row in rows() if (row["scene"], row["electrons"]) == ("s", 5)], AXES, competes)
    assert [line.method for line in found] == ["b", "a"]
    assert verdict(found, competes).startswith("Nowhere do two methods that see no truth compete")


def test_the_views_of_every_seed_are_values_of_a_line() -> None:
    table = rows()[:2]
    scores: dict[int, dict[str, Any]] = {
        row["run"]: {"mean": {"enhanced": {"aligned_psnr": row[PSNR]}},
                     "views": {"0": {"enhanced": {"aligned_psnr": row[PSNR] - 1}},
                               "1": {"enhanced": {"aligned_psnr": row[PSNR] + 1}}}} for row in table
    }  # fmt: skip
    (line,) = lines_of(table, AXES, COMPETES, scores=scores)
    assert line.values[PSNR] == {
        ("s", "0", "0"): 19.0, ("s", "0", "1"): 21.0, ("s", "1", "0"): 21.0, ("s", "1", "1"): 23.0,
    }  # fmt: skip
    scores[2]["views"].pop("1")  # scored again since
    (line,) = lines_of(table, AXES, COMPETES, scores=scores)
    assert line.values[PSNR] == {("s", "0", ""): 20.0, ("s", "1", ""): 22.0}  # the means, which all have


def test_where_a_mean_alone_is_known_of_some_run_all_are_compared_by_means() -> None:
    """Of a study of two machines each has the views of another seed; a is above by .03 and .01."""
    means, scores = {"a": (25.03, 25.02), "b": (25.0, 25.01)}, dict[int, Any]()
    table = [{"run": 2 * "ab".index(name) + seed + 1, "scene": "s", "electrons": 5, "method": name, "seed": seed,
              "state": "done", PSNR: mean} for name, own in means.items() for seed, mean in enumerate(own)]  # fmt: skip
    for run in (1, 4):
        mean = next(row[PSNR] for row in table if row["run"] == run)
        scores[run] = {"mean": {"enhanced": {"aligned_psnr": mean}}, "views": {
            view: {"enhanced": {"aligned_psnr": mean + step}} for view, step in (("0", 2.0), ("1", -2.0))}}  # fmt: skip
    lines = lines_of(table, AXES, COMPETES, scores=scores)
    assert [line.method for line in lines] == ["a", "b"]
    assert lines[0].values[PSNR] == {("s", "0", ""): pytest.approx(25.03), ("s", "1", ""): 25.02}
    assert [line.places[PSNR] for line in lines] == [1, 1]


@pytest.mark.parametrize("failed", range(3))
def test_lines_of_a_place_stand_by_their_score_and_a_failed_one_last(failed: int) -> None:
    methods = [*"xy"]
    methods.insert(failed, "failed")
    table = [{"run": k, "scene": "s", "electrons": 5, "method": name, "seed": 0, "state": "done", PSNR: 20.0 + k}
             for k, name in enumerate(methods, 1)]  # fmt: skip
    table[failed]["state"] = "failed"
    lines = lines_of(table, AXES, dict.fromkeys(methods, True))
    assert [line.method for line in lines] == ["y", "x", "failed"]


def test_a_difference_says_how_many_scenes_it_is_of() -> None:
    """c is known of one scene; and of a study under way no scene has both methods at 50 electrons."""
    axes = {"scene": list("stu"), "electrons": (5, 50), "method": list("abc"), "seed": (0, 1)}
    table = [{"scene": scene, "electrons": 5, "method": name, "seed": seed, "state": "done",
              PSNR: 25.0 + k - 2 * "abc".index(name) + 0.1 * seed * k}
             for name in "abc" for k, scene in enumerate("stu") for seed in (0, 1)
             if name != "c" or scene == "t"]  # fmt: skip
    table += [{"scene": scene, "electrons": 50, "method": name, "seed": 0, "state": "done", PSNR: 30.0}
              for name, scene in (("a", "s"), ("b", "t"))]  # fmt: skip
    said = verdict(lines_of([{"run": k, **row} for k, row in enumerate(table, 1)], axes, dict.fromkeys("abc", True)),
                   dict.fromkeys("abc", True))  # fmt: skip
    assert (
        "Over 3 scenes (electrons 5), a is +2.00 ± 0.00 above b and +4.00 ± 0.00 above c (this scene, 2 seeds)." in said
    )
    assert "electrons 50" not in said


def test_scenes_are_gathered_where_all_else_is_alike() -> None:
    found = over_scenes(lines_of(rows(), AXES, COMPETES), PSNR)
    assert found.keys() == {"electrons 5", "electrons 50"}
    for methods in found.values():
        assert {name: {scene for scene, _, _ in own} for name, own in methods.items()} == {
            "a": {"s", "t"},
            "b": {"s", "t"},
        }


def test_scores_that_disagree_are_named_wherever_the_best_method_stands() -> None:
    """The first line of all is of the other method."""
    table = [row | {LIT: 10.0 + 2 * (row["method"] == "b")} for row in rows()
             if (row["scene"], row["electrons"]) != ("s", 50)]  # fmt: skip
    lines = lines_of(table, AXES, COMPETES)
    assert lines[0].method == "b"
    said = verdict(lines, COMPETES)
    assert said.startswith("a comes first in 2 of 3 comparisons")
    assert said.endswith("there b comes first in 3 of 3, a in 0.")


def test_scores_that_disagree_are_named_though_the_best_method_has_them_in_its_first_place_alone() -> None:
    table = [{name: value for name, value in row.items() if name != LIT} for row in rows()
             if (row["scene"], row["electrons"]) != ("t", 50)]  # fmt: skip
    for row in table[:4]:
        row[LIT] = 10.0 + 2 * (row["method"] == "a")
    lines = lines_of(table, AXES, COMPETES)
    assert (lines[0].method, LIT in lines[0].places) == ("b", True)
    said = verdict(lines, COMPETES)
    assert said.startswith("b comes first in 2 of 3 comparisons")
    assert said.endswith("there a comes first in 1 of 1, b in 0.")
