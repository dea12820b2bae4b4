"""The table of differences: which runs are paired, what they are said to be apart, and what a study can see."""

import csv
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.metrics.differences import Scatter
from novags.testbed.study.differences import ALL, DIFFERENCES, Finished, foreseen, rows_of, write_differences

AXES: dict[str, Any] = {"scene": ("s", "t"), "electrons": (5,), "method": ("naive", "mine", "oracle"), "seed": (0, 1)}
LEVEL = {"naive": 20.0, "mine": 22.0, "oracle": 30.0}


def finished(scene: str, seed: int, method: str, tone: str = "x") -> Finished:
    """Views are dB apart, and alike for all methods; of scene t `mine` is 1 dB better."""
    score = LEVEL[method] + 3 * seed + (scene == "t") * (method == "mine")
    views = {f"{k:04d}": {"enhanced": {"aligned_psnr": score + k}, "lit": {"tone_aligned_psnr": score / 2 + k}}
             for k in (-2, 0, 2)}  # fmt: skip
    place = {"scene": scene, "electrons": 5, "method": method, "seed": seed}
    return Finished(place, method, {"mean": views["0000"], "views": views}, tone)


def runs() -> list[Finished]:
    return [finished(scene, seed, method) for scene in "st" for seed in (0, 1) for method in LEVEL]


def row(rows: list[dict[str, Any]], scene: str, method: str, than: str, score: str) -> dict[str, Any]:
    (found,) = (each for each in rows if (each["scene"], each["method"], each["than"], each["score"]) ==
                (scene, method, than, score))  # fmt: skip
    return found


def test_every_pair_of_methods_has_a_row_in_each_scene_and_over_all_of_them() -> None:
    rows = rows_of(AXES, runs())
    assert len(rows) == 3 * 3 * 2  # pairs, scenes and all, scores
    alone = row(rows, "s", "mine", "naive", "enhanced.aligned_psnr")
    assert (alone["difference"], alone["seen"], alone["electrons"]) == (pytest.approx(2.0), True, 5)
    assert (alone["over"], alone["scenes"], alone["seeds"], alone["views"]) == ("views and seeds", 1, 2, 3)
    over = row(rows, ALL, "mine", "naive", "enhanced.aligned_psnr")
    assert (over["difference"], over["error"], over["freedom"]) == (pytest.approx(2.5), pytest.approx(0.5), 1)
    assert over["over"] == "scenes"
    assert over["seen"] is False  # of two scenes 12.7 errors are asked for
    assert over["low"] == pytest.approx(2.5 - 12.706 * 0.5, abs=1e-3)


def test_the_share_that_a_method_recovers_stands_beside_its_gain_over_the_floor_alone() -> None:
    rows = rows_of(AXES, runs())
    shares = {(each["method"], each["than"]): each["recovered"] for each in rows if each["scene"] == "t"
              and each["score"] == "enhanced.aligned_psnr"}  # fmt: skip
    assert shares == {("mine", "naive"): pytest.approx(0.3), ("oracle", "naive"): None, ("oracle", "mine"): None}


def test_scenes_stand_in_the_order_of_the_study_also_where_it_goes_through_them_once_for_each_method() -> None:
    rows = rows_of(AXES, [finished(scene, 0, method) for method in LEVEL for scene in "ts"])
    assert list(dict.fromkeys(each["scene"] for each in rows)) == ["t", "s", ALL]


@pytest.mark.parametrize("order", [("naive", "mine", "oracle"), ("mine", "oracle", "naive")])
def test_a_share_is_given_in_any_order_of_the_methods_and_none_of_two_enhancements(order: tuple[str, ...]) -> None:
    found = [finished("s", seed, method) for method in order for seed in (0, 1)]
    assert row(rows_of(AXES, found), "s", "mine", "naive", "enhanced.aligned_psnr")["recovered"] == pytest.approx(0.2)
    found = [finished("s", seed, method, "xy"[method == "oracle"]) for method in order for seed in (0, 1)]
    rows = rows_of(AXES, found)
    assert row(rows, "s", "mine", "naive", "enhanced.aligned_psnr")["recovered"] is None
    assert row(rows, "s", "mine", "naive", "lit.tone_aligned_psnr")["recovered"] == pytest.approx(0.2)


def test_noise_free_references_of_two_enhancements_are_not_compared() -> None:
    mixed = [finished("s", 0, "naive"), finished("s", 0, "mine", tone="y")]
    assert [each["score"] for each in rows_of(AXES, mixed)] == ["lit.tone_aligned_psnr"]


def test_runs_that_lack_an_axis_for_scenes_and_seeds_are_of_this_scene(tmp_path: Path) -> None:
    """As those of a study of one place."""
    here = [Finished({"method": name}, name, finished("s", 0, name).scores, "x") for name in ("naive", "mine")]
    write_differences(tmp_path, {"method": ("naive", "mine")}, here)
    with (tmp_path / DIFFERENCES).open() as file:
        found = list(csv.DictReader(file))
    assert [(each["score"], each["method"], each["than"], each["over"]) for each in found] == [
        ("enhanced.aligned_psnr", "mine", "naive", "views"), ("lit.tone_aligned_psnr", "mine", "naive", "views")
    ]  # fmt: skip
    assert float(found[0]["difference"]) == pytest.approx(2.0)


def test_methods_are_paired_where_every_other_axis_is_alike(tmp_path: Path) -> None:
    places = [{"electrons": electrons, "camera": camera} for electrons, camera in ((5, "x"), (5, "y"), (50, "x"))]
    axes = {"electrons": (5, 50), "camera": ("x", "y"), "scene": ("s",), "method": ("naive", "mine"), "seed": (0,)}
    table = [replace(each, place={**each.place, **place}) for place in places
             for each in (finished("s", 0, "naive"), finished("s", 0, "mine"))]  # fmt: skip
    write_differences(tmp_path, axes, table)
    with (tmp_path / DIFFERENCES).open() as file:
        found = [each for each in csv.DictReader(file) if each["score"] == "lit.tone_aligned_psnr"]
    assert list(found[0])[:4] == ["electrons", "camera", "scene", "score"]
    assert [(each["electrons"], each["camera"], each["views"], float(each["difference"])) for each in found] == [
        ("5", "x", "3", 1.0), ("5", "y", "3", 1.0), ("50", "x", "3", 1.0)
    ]  # fmt: skip


def test_a_study_says_the_smallest_difference_that_it_can_see() -> None:
    """More scenes see more, and one run of one view nothing."""
    scatter = Scatter(scenes=0.5, seeds=0.2, views=0.3)

    def said(scenes: int, seeds: int, *views: int) -> str:
        cells: Any = [
            SimpleNamespace(
                preset=SimpleNamespace(render=SimpleNamespace(n_views=count), folder=None, photos=None, dark=None)
            )
            for count in views
        ]
        return foreseen({"scene": range(scenes), "seed": range(seeds)}, cells, scatter)

    found = [float(said(scenes, 2, 20).split()[2]) for scenes in (2, 4, 12)]
    assert found == sorted(found, reverse=True)
    assert "on scenes like these, four times in five (4 scenes, 2 seeds, 3 held-out views)" in said(4, 2, 20)
    assert said(4, 2, 40, 20, 30) == said(4, 2, 20)  # of cells with several numbers of views the fewest count
    assert "on this scene" in said(1, 2, 20)
    assert said(1, 1, 8) == (
        "no difference between methods, of 1 scene, 1 seed, 1 held-out view: nothing repeats, and so no error is known"
    )
