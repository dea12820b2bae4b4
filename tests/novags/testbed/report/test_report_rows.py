"""Claims about how runs appear in a report: colours, the main run, deviations from the published method."""

import colorsys
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.methods import METHODS, chosen
from novags.testbed.folders.run import Run
from novags.testbed.ledger.contents import jsonable
from novags.testbed.report import verdict
from novags.testbed.report.rows import Deviation, deviations, distinct, enhancement_of, looks_of, main_row, rows_of


def run(name: str, *, cameras: str = "known", **settings: Any) -> Run:
    variant = chosen(name)
    config = variant.config(METHODS[variant.method].config(), settings)
    record = {
        "name": name, "method": variant.method, "title": variant.title or METHODS[variant.method].title,
        "variant": dict(variant.settings), "config": jsonable(asdict(config)), "cameras": {"source": cameras},
    }  # fmt: skip
    return Run(path=Path(name), record=record)


def runs(*names: str) -> dict[str, Run]:
    return {name: run(name) for name in names}


def test_a_method_as_published_deviates_in_its_cameras_alone() -> None:
    assert deviations(run("nova")) == [Deviation("cameras", "vggt", "known")]
    assert deviations(run("nova", cameras="vggt:checkpoint=w.pt")) == []
    assert deviations(run("naive")) == []


def test_every_setting_of_a_variant_is_listed_with_both_values() -> None:
    found = {d.setting: (d.published, d.here) for d in deviations(run("nova-fast"))}
    assert found.keys() == {*chosen("nova-fast").settings, "cameras"}
    assert found["denoiser.network.widths"] == ("32, 64, 128, 256", "16, 32, 64")
    assert found["denoiser.denoise_every"] == ("1", "off")
    assert found["denoiser.blind_spots.per_channel"] == ("False", "off")


def test_a_part_that_is_switched_off_is_listed() -> None:
    found = {d.setting: (d.published, d.here) for d in deviations(run("nova-no-geo"))}
    assert found["consistency.weight"] == ("1", "off")
    assert "sh_weight" not in found


def test_size_counts_as_a_deviation_and_bookkeeping_does_not() -> None:
    settings = {"fit.iterations": 10, "fit.seed": 4, "fit.checkpoint_every": 3, "fit.extent": 2.0}
    assert deviations(run("naive", **settings)) == [Deviation("fit.iterations", "7000", "10")]


def test_every_run_has_a_colour_of_its_own_and_a_method_as_it_is_keeps_its_own() -> None:
    rows = rows_of(runs("nova", "nova-fast", "nova-no-sh", "nova-no-geo", "naive", "naive-l1", "oracle"))
    assert rows["nova"].color == METHODS["nova"].color
    assert rows["naive"].color == METHODS["naive"].color
    assert len({row.color for row in rows.values()}) == len(rows)
    assert len({row.key for row in rows.values()}) == len(rows)


@pytest.mark.parametrize("color", ["#0072b2", "#777777", "#000000", "#ffffff"])
def test_colours_stay_distinct_however_many_runs_share_a_method(color: str) -> None:
    used: list[str] = []
    for _ in range(12):
        used.append(distinct(color, used))
    assert len(set(used)) == 12
    assert used[0] == color


def test_the_centre_is_ours_then_whatever_competes() -> None:
    assert main_row(rows_of(runs("oracle", "naive", "nova-fast")).values()) == "nova-fast"
    assert main_row(rows_of(runs("oracle", "naive", "naive-l1")).values()) == "naive-l1"
    assert main_row(rows_of(runs("oracle")).values()) == "oracle"


def test_only_methods_as_they_are_bound_the_scale() -> None:
    rows = rows_of(runs("naive", "naive-l1", "oracle"))
    assert [rows[name].bound for name in ("naive", "naive-l1", "oracle")] == ["floor", None, "ceiling"]
    assert [rows[name].competes for name in ("naive", "naive-l1", "oracle")] == [True, True, False]


@pytest.mark.parametrize("color", ["#c8590a", "#0072b2", "#008560"])
def test_made_up_colours_can_be_seen_on_white(color: str) -> None:
    """A line needs a contrast of 3 : 1 (WCAG 2.1, 1.4.11): a relative luminance of at most 0.3."""
    used = [color]
    for _ in range(6):
        found = distinct(color, used)
        used.append(found)
        parts = [(int(found[i : i + 2], 16) / 255) ** 2.2 for i in (1, 3, 5)]
        assert 1.05 / (0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2] + 0.05) > 2.95


def test_runs_share_a_noise_free_reference_if_enhancer_and_settings_are_the_same() -> None:
    def enhanced(**enhancement: Any) -> str:
        return enhancement_of({"enhancement": enhancement or None})

    one = enhanced(enhancer="gamma", pictures="8bit", config={"gamma": 0.2, "target": 0.5})
    assert one == enhanced(enhancer="gamma", pictures="16bit", config={"target": 0.5, "gamma": 0.2})
    assert one != enhanced(enhancer="gamma", pictures="8bit", config={"gamma": None, "target": 0.5})
    assert one != enhanced(enhancer="gain", pictures="8bit", config={"gamma": 0.2, "target": 0.5})
    assert enhanced() == ""


@pytest.mark.parametrize(
    ("floor", "best", "shown"),
    [
        ("naive", "nova-plus", ("render-naive", "render-nova-plus")),
        (None, "nova-plus", ("enhanced", "render-nova-plus")),
        ("naive", "naive", ("enhanced", "render-naive")),
    ],
)
def test_the_leader_is_compared_at_first_and_never_with_itself(
    floor: str | None, best: str, shown: tuple[str, str]
) -> None:
    scores = {"nova-fast": 25.0, "naive": 24.0, "oracle": 30.0, best: 28.0}
    rows = {name: SimpleNamespace(competes=name != "oracle") for name in scores}
    metrics = {"methods": {name: {"mean": {"enhanced": {"aligned_psnr": score}}} for name, score in scores.items()}}
    bound = {"floor": floor}.__getitem__
    material = SimpleNamespace(bound=bound, main="nova-fast", rows=rows, metrics=metrics, one_reference=True)
    assert verdict.compared(material) == shown  # type: ignore[arg-type]


@pytest.mark.parametrize(("color", "light"), [("#000000", 0.3), ("#0072b2", 0.349 + 0.14), ("#303030", 0.188 + 0.14)])
def test_a_made_up_colour_is_a_little_lighter_and_neither_dark_nor_pale(color: str, light: float) -> None:
    made = distinct(color, [color])
    red, green, blue = (int(made[i : i + 2], 16) / 255 for i in (1, 3, 5))
    assert colorsys.rgb_to_hls(red, green, blue)[1] == pytest.approx(light, abs=0.01)


@pytest.mark.parametrize("color", ["#e0e0ff", "#f5c040", "#9ecae1", "#888888"])
def test_what_a_pale_colour_is_changed_to_is_no_grey(color: str) -> None:
    used = [color]
    for _ in range(4):
        used.append(distinct(color, used))
        parts = [int(used[-1][i : i + 2], 16) for i in (1, 3, 5)]
        assert max(parts) - min(parts) > 0.42 * max(parts)


def test_every_method_variant_and_program_of_a_study_has_a_look_of_its_own() -> None:
    study = {"variant": {"mine": {"method": "naive", "fit": {"iterations": 3}}, "other": {"method": "oracle"}},
             "method": {"theirs": {}}}  # fmt: skip
    found = looks_of(["naive", "mine", "theirs", "other", "gone"], study)
    assert [(row.name, row.method) for row in found.values()] == [
        ("naive", "naive"), ("mine", "naive"), ("theirs", "theirs"), ("other", "oracle"), ("gone", "gone")
    ]  # fmt: skip
    assert [row.competes for row in found.values()] == [True, True, True, False, True]
    assert len({row.color for row in found.values()}) == len({row.key for row in found.values()}) == 5
