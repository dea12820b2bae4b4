"""Claims about pages with many rows, views of several sizes, unusual names, and cameras with a fixed pattern."""

import base64
import json
import os
import re
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.report import page
from novags.testbed.report.look import album
from novags.testbed.report.look.probe import probe_of
from novags.testbed.report.page import report_path, write_report, write_reports, write_study
from novags.testbed.stages.configs.capturing import CaptureConfig

QUIET = Console(quiet=True)
PSNR = {("naive", 5): 20.0, ("better", 5): 23.0, ("naive", 50): 26.0, ("better", 50): 25.0}


@pytest.fixture(scope="module")
def study(experiment: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a study of two methods at two light levels, whose runs are those of the made report."""
    folder = tmp_path_factory.mktemp("study")
    axes = {"scene": ["a"], "electrons": [5, 50], "method": ["naive", "better"], "seed": [0]}
    rows = [{"run": n, "scene": "a", "electrons": electrons, "method": method, "seed": 0, "state": "done",
             "folder": os.path.relpath(experiment / method, folder), "enhanced.aligned_psnr": value}
            for n, ((method, electrons), value) in enumerate(PSNR.items(), 1)]  # fmt: skip
    (folder / "results.json").write_text(json.dumps({"axes": axes, "columns": [], "rows": rows}))
    table = {"variant": {"better": {"method": "naive"}}, "grid": axes}
    (folder / "study.json").write_text(json.dumps({"file": "l.toml", "table": table}))
    return write_study(folder)


@pytest.mark.parametrize("table", ["combinations", "runs"])
def test_a_number_of_a_study_names_its_combination_and_the_rivals_there(
    visit: Callable[..., Any], study: Path, table: str
) -> None:
    tab = visit(study, "#runs=open")
    tab.wait_for_selector('table[data-name="runs"]')
    rows = tab.locator(f'table[data-name="{table}"] tbody tr', has_text="better")
    rows.filter(has_text="50").filter(has_text="25.00").locator("td.num", has_text="25.00").click()
    told = tab.locator(".told strong").text_content()
    if table == "combinations":
        assert told == "better, scene a, electrons 50, PSNR aligned, noise-free dB: 25.0, place 2 of 2."
    else:
        assert told == "better, run 4, PSNR aligned, noise-free dB: 25.0."
    tab.wait_for_function("location.hash === `#${novags.state.values}`")
    again = visit(study, tab.evaluate("location.hash"))
    again.wait_for_selector(".told strong")
    assert again.locator(".told strong").all_text_contents() == [told]


def test_the_keys_reach_every_row_that_is_shown_and_no_other(visit: Callable[..., Any], study: Path) -> None:
    """Rationale: the first row was narrowed away, and no number of the table could be reached by the Tab key."""
    tab = visit(study)
    stop = tab.locator('table[data-name="combinations"] td[tabindex="0"]')
    focused = "document.activeElement.parentElement.dataset.of"
    tab.locator(".filters").get_by_label("Method").first.select_option("naive")
    assert stop.count() == 1
    assert stop.is_visible()
    for key, electrons in (("ArrowDown", 50), ("ArrowDown", 50), ("ArrowUp", 5)):
        stop.press(key)
        assert tab.evaluate(focused) == f"scene a, electrons {electrons}"
    tab.locator(".filters").get_by_label("electrons").first.select_option("50")
    stop.press("ArrowRight")
    assert tab.evaluate(focused) == "scene a, electrons 50"


def test_a_long_name_in_a_filter_does_not_widen_the_page(visit: Callable[..., Any], study: Path) -> None:
    tab = visit(study, width=390)
    tab.locator(".filters select").first.evaluate("select => select.add(new Option('a long name '.repeat(20)))")
    assert tab.evaluate("document.documentElement.scrollWidth") == 390


@pytest.mark.parametrize("width", [390, 1300])
def test_the_reason_of_a_run_with_a_long_name_has_room(visit: Callable[..., Any], experiment: Path, width: int) -> None:
    """Rationale: of runs that failed in scenes with long names the reasons stood in columns of five letters."""
    tab = visit(experiment / "report.html", width=width)
    share = tab.locator("dl.methods > div").first.evaluate(
        """row => {
            row.querySelector("dt").textContent = "run 72, lita-gs, scene a-folder/with-a-long-name ".repeat(3);
            return row.querySelector("dd").clientWidth / row.clientWidth;
        }"""
    )
    assert share > 0.5
    assert tab.evaluate("document.documentElement.scrollWidth") == width


def test_a_pixel_that_the_next_view_does_not_have_is_let_go(visit: Callable[..., Any], experiment: Path) -> None:
    """Rationale: captures of different sizes may share a page, and the numbers of some other pixel were shown."""
    tab = visit(experiment / "report.html", "#pixel=31,5")
    tab.wait_for_selector("#probe tbody tr")
    smaller = "for (const image of novags.look.grid.querySelectorAll('img')) image.setAttribute('width', 16)"
    tab.locator("#view").select_option(index=1)
    assert tab.evaluate("[novags.stage.pixel.x, novags.stage.pixel.y]") == [31, 5]
    tab.evaluate(smaller)
    for index in (0, 1):
        tab.locator("#view").select_option(index=index)
    assert tab.evaluate("novags.stage.pixel") is None
    assert tab.locator("#cross").is_hidden()
    tab.wait_for_timeout(100)
    assert tab.locator("#probe").text_content() == ""
    assert "pixel" not in tab.evaluate("novags.state.values.toString()")


def test_of_more_views_than_are_laid_out_every_one_shows_the_chosen_score(
    visit: Callable[..., Any], experiment: Path, tmp_path: Path
) -> None:
    shutil.copytree(experiment, tmp_path / "run")
    for file in ("naive/metrics.json", "better/metrics.json", "oracle/metrics.json"):
        metrics = json.loads((tmp_path / "run" / file).read_text())
        for scores in metrics["methods"].values():
            scores["views"] = {f"{k:04d}": {"enhanced": {"aligned_psnr": 20.0, "flip": 0.25}} for k in range(130)}
        (tmp_path / "run" / file).write_text(json.dumps(metrics))
    tab = visit(write_report(tmp_path / "run", QUIET))
    tab.locator('select[data-views="enhanced"]').select_option("flip")
    tab.evaluate("novags.rows.show(document.querySelector('[data-name=views-enhanced]'), Infinity)")
    found = tab.locator('table[data-name="views-enhanced"] tbody td:nth-child(2)').all_text_contents()
    assert found == ["0.250"] * 130


def test_what_lies_beside_a_page_is_found_whatever_the_page_is_called(
    visit: Callable[..., Any], experiment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(album, "INSIDE", 20_000)
    monkeypatch.setattr(album, "THUMB", 8)
    page = write_reports([experiment], QUIET, out=tmp_path / "50% dark? #2 <ü>.html")
    tab = visit(page, "#pixel=3,4&left=dark")
    tab.wait_for_function("document.getElementById('left-image').naturalWidth === 32")
    tab.wait_for_function("document.querySelectorAll('#probe tbody tr').length > 8")
    assert tab.locator("#lost").is_hidden()


def test_the_light_without_noise_is_without_the_pattern_of_the_camera_too(
    visit: Callable[..., Any], experiment: Path, tmp_path: Path
) -> None:
    """Rationale: the mean of all exposures was shown, which has the camera's fixed pattern and dark charge."""
    config = CaptureConfig(electrons=20.0, sensor="imx900-hcg-3chip")
    stages.capture(experiment / "set", tmp_path / "capture", config, QUIET)
    capture = open_capture(tmp_path / "capture")
    probe = probe_of(capture, 0)
    assert probe is not None
    tab, planes = visit(experiment / "report.html"), base64.b64encode(probe.data).decode()
    found = tab.evaluate(
        """async ([header, text]) => {
            const dataset = { probe: JSON.stringify(header), name: "made" };
            const grid = { dataset, querySelector: () => ({ textContent: text }) };
            return novags.probe.rows(await novags.probe.planes(grid), 7, 3);
        }""",
        [probe.header, planes],
    )
    shown = {label: values for label, values, _ in found}
    assert shown["Linear light, noise-free"] == pytest.approx(capture.clean_linear(0)[3, 7].tolist(), rel=1e-3)
    assert shown["Linear light, measured"] == pytest.approx(capture.linear(0)[3, 7].tolist(), abs=2e-5)


def test_the_light_of_a_camera_with_a_deep_well_keeps_eleven_bits(
    experiment: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: an electron of such a camera is some 1e-6 of white, of which half precision keeps two bits."""
    capture = open_capture(experiment / "capture")
    light = np.geomspace(3e-7, 0.5, 32 * 24 * 3, dtype=np.float32).reshape(24, 32, 3)
    monkeypatch.setattr(Capture, "clean_linear", lambda *_: light)
    monkeypatch.setattr(Capture, "truth", lambda _, i, kind: np.full((24, 32, 3), 600.0 + (kind == "mean")))
    probe = probe_of(capture, 0)
    assert probe is not None
    plane = next(plane for plane in probe.header["planes"] if plane["name"] == "linear_mean")
    assert plane == probe.header["planes"][-1]
    low, high = np.frombuffer(zlib.decompress(probe.data), np.uint8)[-2 * light.size :].reshape(2, -1)
    found = plane["scale"] * np.stack([low, high], -1).view("<f2").astype(np.float64)[:, 0].reshape(3, 24, 32)
    assert found == pytest.approx(np.moveaxis(light, -1, 0), rel=5e-4)


def test_the_noise_that_all_were_given_makes_no_method_the_first(experiment: Path) -> None:
    table = (experiment / "report.html").read_text(encoding="utf-8").partition('data-name="noise"')[2]
    rows = re.findall(r"<tr.*?</tr>", table.partition("</table>")[0], flags=re.DOTALL)[1:]
    cells = [re.findall(r'<td class="num([^"]*)"[^>]*?( data-rank="\d")?>([\d.]+)</td>', row) for row in rows]
    assert len(cells) == 3
    assert all(cell[2:] == [("", "", "0.062"), ("", "", "31.26")] for cell in cells)
    assert sum("data-rank" in rank for row in cells for _, rank, _ in row) == 4  # two that compete, by what is left


def test_a_report_says_what_recovered_is_measured_by_where_a_bound_has_several_runs(
    experiment: Path, tmp_path: Path
) -> None:
    """Rationale: their means count, and the page named the first run of each as the ends of the scale."""
    for name in ("first", "second"):
        shutil.copytree(experiment, tmp_path / name)
    page = write_reports([tmp_path / "first", tmp_path / "second"], QUIET).read_text(encoding="utf-8")
    assert "from <em>the mean of 2 runs of naive</em> (0 %) to <em>the mean of 2 runs of oracle</em> (100 %)" in page


def test_a_table_saved_as_csv_holds_no_formula(visit: Callable[..., Any], experiment: Path) -> None:
    cell = "document.querySelector('[data-name=scores-enhanced] tbody td:not(.rank)')"
    tab = visit(experiment / "report.html")
    tab.evaluate(f"delete {cell}.dataset.value, {cell}.textContent = '=1'")
    assert "'=1," in tab.evaluate(f"novags.tables.csv({cell}.closest('table'))")


def test_a_report_on_other_runs_is_not_replaced_whichever_run_is_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = list[str]()
    monkeypatch.setattr(page, "build", lambda material, console, identity: made.append(identity))
    monkeypatch.setattr(page, "material_of", lambda places, path: None)
    places = {name: SimpleNamespace(runs={f"{name}{k}": SimpleNamespace(path=tmp_path / f"{name}{k}") for k in (0, 1)})
              for name in "abc"}  # fmt: skip
    for names in ("ab", "ac", "cb", "a", "ba"):
        monkeypatch.setattr(page, "places_in", lambda folders, console, names=names: [places[name] for name in names])
        write_reports([tmp_path / name for name in names], QUIET, out=tmp_path / "out.html")
    assert made[0] == made[-1]
    assert len(set(made)) == 4


def test_a_report_on_one_study_does_not_replace_that_on_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = list[str]()
    monkeypatch.setattr(page, "build", lambda material, console, identity: made.append(identity))
    monkeypatch.setattr(page, "study_material", lambda folder, path: SimpleNamespace(axes={}))
    for name in ("a", "b", "a"):
        write_study(tmp_path / name)
    assert made[0] == made[2] != made[1]
    (tmp_path / "out.html").write_text(f'<meta name="novags-runs" content="{made[0]}">')
    write_study(tmp_path / "a", tmp_path / "out.html")
    with pytest.raises(ValueError, match="is not of a report on this study"):
        write_study(tmp_path / "b", tmp_path / "out.html")


def test_a_report_on_several_folders_lies_above_all_of_them(tmp_path: Path) -> None:
    folders = [tmp_path / "a" / "b" / "x", tmp_path / "a" / "y", tmp_path / "c" / "z"]
    assert report_path(folders) == tmp_path / "comparison.html"
    assert report_path(folders[:2]) == tmp_path / "a" / "comparison.html"
