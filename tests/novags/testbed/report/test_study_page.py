"""Claims about the report on a study: places at each combination, spread, filters, pictures, commands."""

import csv
import json
import os
import re
import shlex
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.report.blocks import light
from novags.testbed.report.blocks.look import look
from novags.testbed.report.grid import by_place, first_places, lines_of, main_column, verdict
from novags.testbed.report.look.album import Album
from novags.testbed.report.material import Material
from novags.testbed.report.page import write_study
from novags.testbed.report.parts import Page
from novags.testbed.report.study import chosen, read_made, study_material
from novags.testbed.study.results import flat_scores
from simscenes.sets.pictures.exr import read_exr

COMPETES = {"naive": True, "better": True, "oracle": False}
SCORES = {("naive", 5): (20.0, 22.0), ("naive", 50): (26.0, 26.5), ("better", 5): (23.0, 24.9),
          ("better", 50): (25.0, 25.5), ("oracle", 5): (29.0, 29.5), ("oracle", 50): (30.0, 30.5)}  # fmt: skip


def rows(folder: str = "{method}") -> list[dict[str, Any]]:
    """Three methods at two light levels by two seeds; the last run has failed."""
    found: list[dict[str, Any]] = []
    for (method, electrons), values in SCORES.items():
        for seed, value in enumerate(values):
            found.append({
                "run": len(found) + 1, "scene": "a", "electrons": electrons, "method": method, "seed": seed,
                "state": "done", "reason": None, "stage": None, "folder": folder.format(method=method),
                "enhanced.aligned_psnr": value, "lit.tone_aligned_psnr": 40 - value, "peak_bytes": 10**8,
            })  # fmt: skip
    found[-1] |= {"state": "failed", "reason": "the <disk> broke", "stage": "fit"}
    return found


AXES = {"scene": ["a"], "electrons": [5, 50], "method": list(COMPETES), "seed": [0, 1]}


def test_lines_are_means_over_seeds_with_places_at_each_combination() -> None:
    lines = lines_of(rows(), AXES, COMPETES)
    assert [(line.place["electrons"], line.method) for line in lines] == [
        (5, "oracle"), (5, "better"), (5, "naive"), (50, "oracle"), (50, "naive"), (50, "better")
    ]  # fmt: skip
    naive = lines[2]
    assert naive.spread["enhanced.aligned_psnr"] == (21.0, pytest.approx(2**0.5))
    assert naive.spread["peak_bytes"] == (100.0, 0.0)
    assert naive.places == {"enhanced.aligned_psnr": 2, "lit.tone_aligned_psnr": 1, "peak_bytes": 1}
    assert lines[3].spread["enhanced.aligned_psnr"] == (30.0, None)  # the other seed has failed
    assert lines[3].places == {}


def test_the_headline_counts_who_comes_first_and_says_where_another_does() -> None:
    made = [row | ({"enhanced.aligned_psnr": 27.0 + 0.5 * row["seed"]} if row["electrons"] == 50 and
                   row["method"] == "better" else {}) for row in rows()]  # fmt: skip
    lines = lines_of(made, AXES, COMPETES)
    assert first_places(lines, "enhanced.aligned_psnr") == {"better": 2}
    assert verdict(lines, COMPETES) == (
        "better comes first in 2 of 2 comparisons by PSNR aligned, noise-free. Not so by PSNR tone-aligned, lit: there "
        "naive comes first in 1 of 2, better in 1."
    )


def test_the_headline_hides_no_score_by_which_another_comes_first() -> None:
    scores = {"naive": {"lit.flip": 0.1, "lit.psnr": 30.0, "recovered": 0.9, "peak_bytes": 1},
              "better": {"lit.flip": 0.2, "lit.psnr": 25.0, "recovered": 0.5, "peak_bytes": 2}}  # fmt: skip
    made = [row | {"enhanced.aligned_psnr": 25.0 + (row["method"] == "better"), "lit.tone_aligned_psnr": 20.0}
            | scores.get(row["method"], {}) for row in rows()]  # fmt: skip
    assert verdict(lines_of(made, AXES, COMPETES), COMPETES) == (
        "better comes first in 2 of 2 comparisons by PSNR aligned, noise-free. Not so by PSNR, lit; FLIP, lit: there "
        "naive comes first in 2 of 2, better in 0."
    )
    linear = [row | ({"linear.linear_psnr": 30.0} if row["method"] == "better" else {}) for row in made]
    third = [row | {"method": "third", "run": row["run"] + 100} for row in made if row["method"] == "naive"]
    competes = COMPETES | {"third": True}
    said = verdict(lines_of([*linear, *third], AXES, competes), competes)
    assert "Not so" not in said  # by those of pictures that truth has exposed, better takes no place


def test_a_method_that_nothing_competes_with_comes_first_of_nothing() -> None:
    alone = [row for row in rows() if row["method"] != "better"]
    assert verdict(lines_of(alone, AXES, COMPETES), COMPETES) == (
        "Nowhere do two methods that see no truth compete by PSNR aligned, noise-free, so none comes first."
    )
    bounds = [row for row in alone if row["method"] == "oracle"]
    assert verdict(lines_of(bounds, AXES, COMPETES), COMPETES) == "Only methods that see truth were run."


def test_scores_against_references_of_their_own_rank_nothing_and_the_lit_one_decides() -> None:
    enhancements = {row["run"]: "a" if row["method"] == "naive" else "b" for row in rows()}
    lines = lines_of(rows(), AXES, COMPETES, enhancements)
    assert not any(line.alike for line in lines)
    assert [line.method for line in lines[:3]] == ["naive", "better", "oracle"]  # by the lit score
    assert lines[0].places == {"lit.tone_aligned_psnr": 1, "peak_bytes": 1}
    assert verdict(lines, COMPETES).startswith("naive comes first in 1 of 2 comparisons by PSNR tone-aligned, lit")
    same = lines_of(rows(), AXES, COMPETES, dict.fromkeys(enhancements, "a"))
    assert all(line.alike for line in same)
    assert same[2].places["enhanced.aligned_psnr"] == 2
    assert main_column(lines) == "lit.tone_aligned_psnr"
    assert main_column(same) == "enhanced.aligned_psnr"


@pytest.mark.parametrize("linear", [{"linear_psnr": 30.0}, None])  # None: of photographs without noise-free exposures
def test_plain_scores_of_linear_light_which_truth_exposes_take_no_place(linear: dict[str, float] | None) -> None:
    own = flat_scores({"mean": {"linear": linear}, "seconds": {}, "peak_bytes": 1})
    made = [row | {"lit.psnr": 30.0, **(own if row["method"] == "better" else {})} for row in rows()]
    lines = lines_of(made, AXES, COMPETES)[:3]
    assert [line.method for line in lines if line.in_linear_light] == ["better"]
    places = {line.method: line.places for line in lines}
    assert "lit.psnr" not in places["better"]
    assert places["naive"]["lit.psnr"] == 1
    assert places["better"]["lit.tone_aligned_psnr"] == 2


@pytest.fixture(scope="module")
def study(experiment: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study whose runs are those of the made report, again and again."""
    folder = tmp_path_factory.mktemp("study")
    place = os.path.relpath(experiment, folder)
    (folder / "results.json").write_text(json.dumps({"axes": AXES, "columns": [], "rows": rows(f"{place}/{{method}}")}))
    table = {"variant": {"better": {"method": "naive"}}, "grid": AXES}
    (folder / "study.json").write_text(json.dumps({"file": "l.toml", "table": table}))
    write_study(folder)
    return folder


def test_a_run_whose_folder_is_gone_is_counted_and_the_others_are_shown(study: Path, tmp_path: Path) -> None:
    table = json.loads((study / "results.json").read_text())
    for row in table["rows"][:3]:
        row["folder"] = "s3://bucket/run"
    made, lost = read_made(study, table["rows"])
    assert lost == [1, 2, 3]
    assert sorted(made) == list(range(4, 12))


def test_the_work_on_a_data_set_has_no_report_and_says_so(tmp_path: Path) -> None:
    row = {"run": 1, "scene": "a", "seed": 0, "state": "done"}
    (tmp_path / "results.json").write_text(json.dumps({"axes": {"scene": ["a"], "seed": [0]}, "rows": [row]}))
    with pytest.raises(ValueError, match="is the work on a data set, which has no runs to report on"):
        write_study(tmp_path)


def test_runs_that_were_not_tried_say_why(study: Path, tmp_path: Path) -> None:
    before = write_study(study, tmp_path / "before" / "report.html").read_text()
    assert "or were not tried" not in before
    assert "The tables have other scores than run 1, run 2, run 3," in before  # all are made up
    results = json.loads((study / "results.json").read_text())
    results["rows"][0] |= {"state": "skipped", "reason": "no lamp in the scene", "stage": "render"}
    for name, text in (("results.json", json.dumps(results)), ("study.json", (study / "study.json").read_text())):
        (tmp_path / name).write_text(text)
    page = write_study(tmp_path).read_text(encoding="utf-8")
    assert "Runs that failed, or were not tried" in page
    assert "<dd>a task it needs has failed: no lamp in the scene</dd>" in page
    assert "<dd>the &lt;disk&gt; broke</dd>" in page


def test_the_page_says_that_references_differ(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = "have noise-free references of their own"
    assert said not in write_study(study, tmp_path / "same" / "report.html").read_text()
    monkeypatch.setattr("novags.testbed.report.material.enhancement_of", lambda record: str(id(record)))
    assert said in write_study(study, tmp_path / "report.html").read_text()


def material(study: Path) -> Material:
    return study_material(study, study / "report.html")


def test_the_commands_of_a_study_can_be_run_one_after_the_other(study: Path) -> None:
    found = material(study)
    commands = [shlex.split(command) for command in found.commands.values() if command]
    places = [words[words.index("--out") + 1] for words in commands]
    assert len(commands) == len(set(places)) == len(found.made)
    assert [words[-1] for words in commands] == places  # each scores what it has made


def copied(study: Path, experiment: Path, folder: Path) -> None:
    """A study with its runs beside it, in folders of its own."""
    (folder / "study").mkdir()
    shutil.copytree(experiment, folder / "runs")
    for name in ("results.json", "study.json"):
        text = (study / name).read_text().replace(os.path.relpath(experiment, study), "../runs")
        (folder / "study" / name).write_text(text)


def test_a_damaged_picture_costs_its_place_and_not_the_page(study: Path, tmp_path: Path, experiment: Path) -> None:
    copied(study, experiment, tmp_path)
    (tmp_path / "runs" / "capture" / "images" / "0000.png").write_bytes(b"no picture")
    page = write_study(tmp_path / "study").read_text(encoding="utf-8")
    assert "Pictures that cannot be shown: electrons 5" in page.replace("scene a, ", "")
    assert "images/0000.png not as written (checksum)" in page
    assert 'data-name="combinations"' in page


def texts(tab: Any, table: str, column: int) -> list[str]:
    rows = f'table[data-name="{table}"] tbody tr:not([hidden])'
    return list(tab.eval_on_selector_all(rows, f"rows => rows.map(row => row.cells[{column}].textContent)"))


@pytest.mark.parametrize("width", [390, 1300])
def test_a_study_is_narrowed_sorted_compared_and_downloaded(visit: Callable[..., Any], study: Path, width: int) -> None:
    tab = visit(study / "report.html", width=width)
    assert tab.evaluate("document.documentElement.scrollWidth") == width
    assert texts(tab, "combinations", 0) == ["†", "1", "2", "†", "1", "2"]
    tab.locator(".filters").get_by_label("electrons").first.select_option("5")
    assert texts(tab, "combinations", 1) == ["oracle†", "better", "naive"]
    lit = tab.locator('table[data-name="combinations"] thead button').filter(has_text="tone-aligned")
    lit.click()
    assert texts(tab, "combinations", 1) == ["naive", "better", "oracle†"]
    assert texts(tab, "combinations", 0) == ["1", "2", "†"]
    with tab.expect_download() as loading:
        tab.get_by_label("Download “Scores of every combination” as CSV").click()
    lines = list(csv.DictReader(Path(loading.value.path()).read_text(encoding="utf-8").splitlines()))
    assert [(line["Method"], line["electrons"], float(line["PSNR aligned, noise-free dB"])) for line in lines] == [
        ("naive", "5", 21.0), ("better", "5", 23.95), ("oracle", "5", 29.25)
    ]  # fmt: skip
    assert float(lines[0]["PSNR aligned, noise-free dB, standard deviation"]) == pytest.approx(2**0.5)
    tab.locator("#runs summary").click()
    tab.wait_for_selector('table[data-name="runs"]')
    assert len(texts(tab, "runs", 0)) == 12
    assert tab.locator("dd", has_text="the <disk> broke").count() == 1
    tab.wait_for_function("location.hash === `#${novags.state.values}`")
    again = visit(study / "report.html", tab.evaluate("location.hash"), width=width)
    again.wait_for_selector('table[data-name="runs"]')
    assert texts(again, "combinations", 1) == ["naive", "better", "oracle†"]


def long_study(folder: Path, experiment: Path) -> dict[int, float]:
    """A study of one method at 260 levels, and its scores by level, in no order."""
    scores = {level: 10 + (level * 37 % 260) / 13 for level in range(1, 261)}
    place = os.path.relpath(experiment / "naive", folder)
    first = rows(place)[0]
    table = [
        first | {"run": n, "electrons": n, "scene": "ab"[n % 2], "enhanced.aligned_psnr": scores[n]} for n in scores
    ]
    axes = AXES | {"electrons": list(scores), "method": ["naive"], "seed": [0], "scene": ["a", "b"]}
    folder.mkdir()
    (folder / "results.json").write_text(json.dumps({"axes": axes, "columns": [], "rows": table}))
    (folder / "study.json").write_text(json.dumps({"file": "l.toml", "table": {"grid": axes}}))
    write_study(folder)
    return scores


def test_of_a_long_table_every_row_counts_and_those_that_are_wanted_are_laid_out(
    visit: Callable[..., Any], tmp_path: Path, experiment: Path
) -> None:
    scores = long_study(tmp_path / "study", experiment)
    tab = visit(tmp_path / "study" / "report.html")
    more = tab.locator(".further").first
    assert len(texts(tab, "combinations", 1)) == 100
    assert more.text_content() == "100 of 260 rows: show more"
    score = tab.locator("[data-name=combinations] thead button", has_text="PSNR aligned").first
    column = tab.locator("[data-name=combinations] thead th").evaluate_all(
        "heads => heads.findIndex(head => head.textContent.includes('PSNR aligned'))"
    )
    score.click()
    best = sorted(scores.values(), reverse=True)
    assert [float(text) for text in texts(tab, "combinations", column)] == pytest.approx(best[:100], abs=0.006)
    score.click()
    assert [float(text) for text in texts(tab, "combinations", column)] == pytest.approx(best[:-101:-1], abs=0.006)
    tab.locator(".filters select[data-column]").filter(has_text="b").first.select_option("a")
    assert more.text_content() == "100 of 130 rows: show more"
    with tab.expect_download() as loading:
        tab.get_by_label("Download “Scores of every combination” as CSV").click()
    saved = list(csv.DictReader(Path(loading.value.path()).read_text(encoding="utf-8").splitlines()))
    assert sorted(int(row["electrons"]) for row in saved) == [level for level in scores if level % 2 == 0]
    more.evaluate("button => button.scrollIntoView()")  # which asks for more by itself
    tab.wait_for_function("document.querySelectorAll('[data-name=combinations] tbody tr').length == 130")
    assert more.is_hidden()
    tab.locator(".filters select[data-column]").filter(has_text="b").first.select_option("")
    tab.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert len(texts(tab, "combinations", 1)) == 260
    tab.evaluate("dispatchEvent(new Event('afterprint'))")
    assert len(texts(tab, "combinations", 1)) < 260
    tab.locator("#runs > summary").click()
    tab.wait_for_function("document.querySelectorAll('[data-name=runs] tbody tr').length >= 100")
    assert tab.locator(".further").nth(1).text_content().endswith("of 260 rows: show more")
    short = """() => {
        const box = document.createElement("div");
        box.innerHTML = `<div><table><tbody><tr><td>1</td></tr></tbody></table>
            <script type="text/plain" class="rest"><tr><td>2</td></tr></script></div>`;
        document.body.append(box);
        novags.rows.adopt(box.querySelector("table"));
        return [...box.querySelectorAll("tbody tr")].map(row => row.textContent);
    }"""
    assert tab.evaluate(short) == ["1", "2"]  # nothing is lost where few rows were put aside
    linked = visit(tmp_path / "study" / "report.html", f"#sort.combinations={column}a")
    assert [float(text) for text in texts(linked, "combinations", column)] == pytest.approx(best[:-101:-1], abs=0.006)


def pictures(page: Path, view: int = 0) -> dict[str, str]:
    """What a view of a page shows, by key."""
    head, *grids = page.read_text(encoding="utf-8").split('<div class="grid"')
    text = grids[view] if view else head + grids[0]  # the strip has some of the first view
    return dict(re.findall(r'data-(?:film|key)="([^"]+)"><img src="([^"]+)"', text))


def test_a_place_shows_the_pictures_and_maps_that_the_page_of_its_runs_shows(study: Path, experiment: Path) -> None:
    for view in (0, 1):  # both places are of one capture
        found, single = pictures(study / "report.html", view), pictures(experiment / "report.html")
        assert found == single
        for name in ("naive", "better", "oracle"):
            assert {f"{kind}-{name}" for kind in ("render", "error", "depth", "normal")} <= set(found)
        assert {"depth-true", "normal-true", "truth-lit", "truth-enhanced"} <= set(found)


def test_where_the_set_is_gone_the_truth_that_the_capture_holds_is_shown(
    study: Path, tmp_path: Path, experiment: Path
) -> None:
    copied(study, experiment, tmp_path)
    shutil.rmtree(tmp_path / "runs" / "set")
    found = set(pictures(write_study(tmp_path / "study")))
    assert {"dark", "truth-enhanced", "error-naive", "depth-better"} <= found
    assert not {"truth-lit", "depth-true", "normal-true"} & found


def test_the_runs_shown_of_a_place_are_of_one_capture_and_the_rest_is_told(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = material(study)
    made = dict(found.made)
    made[2], made[5] = (
        replace(made[k], capture=Path("elsewhere")) for k in (2, 5)
    )  # naive, second; better, first seed
    made.pop(9)  # oracle, first seed
    lines = [line for line in found.lines if line.place["electrons"] == 5]
    capture, runs = chosen(lines, replace(found, made=made))
    assert capture == made[1].capture
    assert sorted(runs) == ["better", "naive", "oracle"]
    assert runs["naive"] is made[1].run
    assert runs["better"] is made[6].run
    assert runs["oracle"] is made[10].run
    made[6] = replace(made[6], capture=Path("elsewhere"))
    monkeypatch.setattr("novags.testbed.report.study.read_made", lambda folder, rows: (
        {number: each for number, each in made.items() if number in {1, 2, 5, 6, 10}}, []))  # fmt: skip
    shown = look(material(study), Page(study / "other.html", Album(study / "other.html"), lambda *_: None))
    assert shown is not None
    (place,) = {view.name.partition(", view")[0] for view in shown["views"]}
    assert shown["unseen"] == {f"{place}, better": "no finished run of it is from the same capture as the others"}


@pytest.mark.parametrize("width", [390, 1300])
def test_a_click_on_a_place_or_its_command_shows_its_pictures(
    visit: Callable[..., Any], study: Path, width: int
) -> None:
    tab = visit(study / "report.html", width=width)
    row = tab.locator('table[data-name="combinations"] tbody tr', has_text="naive").nth(1)
    row.locator("td.axis").click()
    shown = "['view', 'right'].map(id => novags.byId(id).selectedOptions[0].textContent)"
    assert tab.evaluate(shown) == ["electrons 50", "naive"]
    tab.wait_for_function("document.getElementById('compare').getBoundingClientRect().top < innerHeight")
    tab.locator(".grid.shown figure[data-key='depth-better'] img").click()
    assert tab.evaluate(shown)[1] == "better: depth"
    cell = tab.locator('table[data-name="combinations"] tbody tr', has_text="better").first.locator("td.num").nth(1)
    cell.click()
    tab.get_by_role("button", name="Show its pictures").press("Enter")
    assert tab.evaluate(shown) == ["electrons 5", "better"]


def test_pictures_and_commands_of_a_study_are_those_of_its_runs(
    visit: Callable[..., Any], study: Path, experiment: Path
) -> None:
    tab = visit(study / "report.html")
    tab.locator("#view").select_option(index=1)
    assert "electrons 50" in tab.locator("#view option:checked").text_content()
    tab.evaluate("novags.stage.probe({x: 10.5 / 32, y: 7.5 / 24}, true)")
    tab.wait_for_function("document.querySelectorAll('#probe tbody tr').length > 8")
    truth, _ = read_exr(experiment / "capture" / "truth" / "0000.exr")
    shown = tab.locator("#probe tbody tr", has_text="True mean, DN").locator("td").evaluate_all(
        "cells => cells.map(cell => +cell.dataset.value)")  # fmt: skip
    assert shown == pytest.approx([truth[f"mean.{c}"][7, 10] for c in "RGB"], rel=1e-3)
    cell = tab.locator('table[data-name="combinations"] tbody tr').nth(1).locator("td.num").nth(1)
    cell.click()
    commands = tab.locator(".told pre").text_content().splitlines()
    assert len(commands) == 2  # one a seed
    assert all("novags reconstruct ../page0/capture --variant" in command for command in commands)


def test_a_study_of_curves_that_cannot_break_has_a_page(
    study: Path, experiment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copied(study, experiment, tmp_path)
    monkeypatch.setattr(light, "knee_rows", lambda curves: [])
    assert "No curve breaks" in write_study(tmp_path / "study").read_text(encoding="utf-8")


def test_lines_are_gathered_by_all_values_of_their_place() -> None:
    places = [{"scene": "a", "electrons": 5}, {"scene": "b", "electrons": 5}, {"scene": "a", "electrons": 20}]
    lines: Any = [SimpleNamespace(place=place, method=method) for method in ("x", "y") for place in places]
    found = {place: [line.method for line in own] for place, own in by_place(lines).items()}
    assert found == dict.fromkeys([("a", "5"), ("b", "5"), ("a", "20")], ["x", "y"])
