"""Claims about a report in a browser: what its controls do, and that what they show is what the files say."""

import csv
import math
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[4]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from novags.testbed.console.terminal import Console  # noqa: E402
from novags.testbed.folders.capture import open_capture  # noqa: E402
from novags.testbed.folders.run import open_run  # noqa: E402
from novags.testbed.folders.runs import runs_in  # noqa: E402
from novags.testbed.metrics import METRICS  # noqa: E402
from novags.testbed.report.again import run_again  # noqa: E402
from novags.testbed.report.look import album  # noqa: E402
from novags.testbed.report.page import write_report  # noqa: E402
from simscenes.sets.pictures.exr import read_exr  # noqa: E402
from simscenes.sets.pictures.png import read_codes  # noqa: E402

QUIET = Console(quiet=True)
FITTING = 9  # scores that fit beside each other at 1300 px; of more, the last may lie beyond the edge


def column(tab: Any, table: str, index: int) -> list[str]:
    """The texts of a column of a table, from top to bottom."""
    found: list[str] = tab.eval_on_selector_all(
        f'table[data-name="{table}"] tbody tr', f"rows => rows.map(row => row.cells[{index}].textContent.trim())"
    )
    return found


def link_of(tab: Any) -> str:
    """The address, once it says what is shown."""
    tab.wait_for_function("location.hash === `#${novags.state.values}`")
    return str(tab.evaluate("location.hash"))


@pytest.mark.parametrize(("width", "theme"), [(390, "light"), (1300, "dark")])
def test_no_page_is_wider_than_the_screen_and_every_hidden_column_is_told(
    visit: Callable[..., Any], experiment: Path, width: int, theme: str
) -> None:
    tab = visit(experiment / "report.html", width=width, theme=theme)
    assert tab.evaluate("document.documentElement.scrollWidth") == width
    told = tab.eval_on_selector_all(
        "table[data-name]",
        """tables => tables.filter(table => table.offsetParent).map(table => {
            const box = table.parentElement, note = box.previousElementSibling.querySelector('.more');
            const edge = box.getBoundingClientRect().right + 1;
            const beyond = [...table.rows[0].cells].filter(cell => cell.getBoundingClientRect().right > edge).length;
            return [beyond, note.hidden ? 0 : parseInt(note.textContent.slice(2))];
        })""",
    )
    assert all(beyond == said for beyond, said in told)
    if width == 390:
        assert any(beyond for beyond, _ in told)
    else:
        assert max(beyond for beyond, _ in told) <= max(0, len(METRICS) - FITTING)
    tab.eval_on_selector('table[data-name="scores-enhanced"]', "table => { table.parentElement.scrollLeft = 1e5 }")
    if width == 390:
        tab.wait_for_function("document.querySelector('[data-name=scores-enhanced]').parentElement"
                              ".previousElementSibling.textContent.startsWith('←')")  # fmt: skip


def test_tables_sort_by_any_column_with_places_and_the_link_keeps_it(
    visit: Callable[..., Any], experiment: Path
) -> None:
    tab = visit(experiment / "report.html")
    assert column(tab, "scores-enhanced", 1) == ["oracle†", "better", "naive"]
    assert column(tab, "scores-enhanced", 0) == ["†", "1", "2"]
    heads = tab.locator('table[data-name="scores-enhanced"] thead th')
    flip = heads.filter(has_text="FLIP")
    flip.get_by_role("button").click()
    assert flip.get_attribute("aria-sort") == "ascending"  # less is better
    assert column(tab, "scores-enhanced", 1) == ["naive", "better", "oracle†"]
    assert column(tab, "scores-enhanced", 0) == ["1", "2", "†"]
    flip.get_by_role("button").press("Enter")
    assert column(tab, "scores-enhanced", 1) == ["oracle†", "better", "naive"]
    assert column(tab, "scores-enhanced", 0) == ["†", "2", "1"]
    again = visit(experiment / "report.html", link_of(tab))
    assert column(again, "scores-enhanced", 0) == ["†", "2", "1"]
    again.evaluate("location.hash = ''")
    again.wait_for_function("document.querySelector('[data-name=scores-enhanced] td.rank').textContent === '†'")
    assert column(again, "scores-enhanced", 0) == ["†", "1", "2"]


def test_csv_has_the_numbers_of_the_files_in_the_order_that_is_shown(
    visit: Callable[..., Any], experiment: Path
) -> None:
    tab = visit(experiment / "report.html", "#sort.scores-enhanced=1a")
    with tab.expect_download() as loading:
        tab.get_by_label("Download “Scores against enhanced” as CSV").click()
    assert loading.value.suggested_filename == "scores-enhanced.csv"
    rows = list(csv.DictReader(Path(loading.value.path()).read_text(encoding="utf-8").splitlines()))
    metrics = {name: run.scores() or {} for name, run in runs_in([experiment]).items()}
    assert [row["Method"] for row in rows] == sorted(metrics)
    assert [row["sees truth"] for row in rows] == ["no", "no", "yes"]
    for row in rows:
        assert float(row["PSNR aligned dB"]) == metrics[row["Method"]]["mean"]["enhanced"]["aligned_psnr"]
        assert float(row["FLIP"]) == metrics[row["Method"]]["mean"]["enhanced"]["flip"]
        assert row["LPIPS"] == ""


def border(tab: Any) -> float:
    """Where the left picture ends, % of the width."""
    return float(tab.evaluate("getComputedStyle(document.getElementById('compare')).getPropertyValue('--at')")[:-1])


@pytest.mark.parametrize("width", [390, 1300])
def test_the_border_follows_the_slider_the_keys_and_the_pointer(
    visit: Callable[..., Any], experiment: Path, width: int
) -> None:
    tab = visit(experiment / "report.html", width=width)
    tab.locator("#slider").fill("20")
    assert border(tab) == 20
    tab.locator("#slider").press("ArrowRight")
    assert border(tab) == 20.5
    box = tab.locator("#compare").bounding_box()
    y = box["y"] + box["height"] / 2
    tab.mouse.move(box["x"] + 0.5 * box["width"], y)
    tab.mouse.down()
    tab.mouse.move(box["x"] + 0.6 * box["width"], y)
    tab.mouse.move(box["x"] + 0.75 * box["width"], y)
    tab.mouse.up()
    assert border(tab) == pytest.approx(75, abs=0.5)
    clip = tab.evaluate("getComputedStyle(document.getElementById('left-layer')).clipPath")
    right = float(clip.split()[1].removesuffix("%"))  # what lies right of the border is not of the left picture
    assert right == pytest.approx(100 - border(tab), abs=0.01)
    link = link_of(tab)
    assert border(visit(experiment / "report.html", link)) == pytest.approx(border(tab), abs=1e-3)


def place_under(tab: Any, side: str, x: float, y: float) -> tuple[float, float]:
    """Which place of a picture, in shares, lies under a point of the screen."""
    frame = tab.evaluate(f"(({{x, y, width, height}}) => [x, y, width, height])("
                         f"document.getElementById('{side}-image').getBoundingClientRect())")  # fmt: skip
    return (x - frame[0]) / frame[2], (y - frame[1]) / frame[3]


@pytest.mark.parametrize("width", [390, 1300])
def test_both_pictures_zoom_around_the_pointer_and_move_in_step(
    visit: Callable[..., Any], experiment: Path, width: int
) -> None:
    tab = visit(experiment / "report.html", width=width)
    tab.locator("#compare").scroll_into_view_if_needed()
    box = tab.locator("#compare").bounding_box()
    x, y = round(box["x"] + 0.7 * box["width"]), round(box["y"] + 0.4 * box["height"])  # events have whole pixels
    before = place_under(tab, "left", x, y)
    tab.mouse.move(x, y)
    tab.keyboard.down("Control")
    tab.mouse.wheel(0, -720)
    tab.keyboard.up("Control")
    tab.wait_for_function("document.getElementById('compare').classList.contains('zoomed')")
    assert place_under(tab, "left", x, y) == pytest.approx(before, abs=1e-3)
    assert place_under(tab, "right", x, y) == pytest.approx(before, abs=1e-3)
    assert tab.evaluate("novags.stage.zoom") == pytest.approx(8)
    tab.mouse.down()
    for step in range(1, 5):
        tab.mouse.move(x - 10 * step, y + 5 * step)
    tab.mouse.up()
    for side in ("left", "right"):  # what was under the pointer still is
        assert place_under(tab, side, x - 40, y + 20) == pytest.approx(before, abs=2e-3)
    link = link_of(tab)
    again = visit(experiment / "report.html", link, width=width)
    assert again.evaluate("[novags.stage.x, novags.stage.y]") == pytest.approx(
        tab.evaluate("[novags.stage.x, novags.stage.y]"), abs=1e-4
    )
    tab.get_by_label("Show the whole picture").click()
    assert tab.evaluate("novags.stage.zoom") == 1


def probed(tab: Any, x: int, y: int) -> dict[str, list[float | None]]:
    """The rows of the probe at a pixel, once they are shown."""
    tab.wait_for_function(
        "wanted => document.querySelector('[data-pixel]')?.textContent === wanted"
        " && document.querySelectorAll('#probe tbody tr').length > 2", arg=f"{x}, {y}"
    )  # fmt: skip
    rows = tab.eval_on_selector_all(
        "#probe tbody tr",
        "rows => rows.map(row => [row.cells[0].textContent, ...[1, 2, 3].map(k => row.cells[k].dataset.value)])",
    )
    return {name: [float(v) if v else None for v in values] for name, *values in rows}


def test_the_probe_shows_what_the_files_say(visit: Callable[..., Any], experiment: Path) -> None:
    capture = open_capture(experiment / "capture")
    assert capture.sensor is not None
    tab = visit(experiment / "report.html", "#left=dark")
    for i, (x, y) in ((0, (0, 0)), (0, (31, 23)), (2, (17, 5))):
        name = capture.names[i]
        tab.locator("#view").select_option(label=tab.locator(f"#view option:has-text('{name} ·')").text_content())
        tab.evaluate(f"novags.stage.probe({{x: ({x} + 0.5) / 32, y: ({y} + 0.5) / 24}}, true)")
        found = probed(tab, x, y)
        truth, _ = read_exr(experiment / "capture" / "truth" / f"{name}.exr")
        mean, variance = (np.array([truth[f"{kind}.{c}"][y, x] for c in "RGB"]) for kind in ("mean", "variance"))
        dn, gain = capture.raw(i)[y, x].astype(float), capture.sensor.gain
        black = capture.sensor.black_level
        assert found["Digital number, DN"] == dn.tolist()
        assert found["True mean, DN"] == pytest.approx(mean.tolist(), rel=1e-3)
        assert found["Electrons, measured"] == pytest.approx((dn - black) / gain)
        assert found["Electrons, true mean"] == pytest.approx((mean - black) / gain, rel=1e-3)
        assert found["True noise, electrons"] == pytest.approx(np.sqrt(variance) / gain, rel=1e-3)
        assert found["Signal to noise"] == pytest.approx((mean - black) / np.sqrt(variance), rel=2e-3)
        assert found["Linear light, measured"] == pytest.approx(capture.linear16(i)[y, x], abs=2e-5)
        assert found["Linear light, noise-free"] == pytest.approx(capture.clean_linear(i)[y, x], abs=1e-4, rel=2e-3)
        codes = read_codes(experiment / "capture" / "images" / f"{name}.png")
        assert found["Dark input, 8-bit code"] == codes[y, x].tolist()


def test_of_a_mosaic_the_probe_shows_the_channel_of_the_filter(visit: Callable[..., Any], experiment: Path) -> None:
    tab = visit(experiment / "report.html")
    codes = [[300 * y + x for x in range(3)] for y in range(2)]
    found = tab.evaluate(
        """codes => {
            const flat = codes.flat(), header = { cfa: "GRBG", width: 3, height: 2 };
            const bytes = { low: flat.map(v => v & 255), high: flat.map(v => v >> 8) };
            const found = { header, planes: { dn: { channels: 1, whole: true, scale: 1, ...bytes } } };
            return [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1]].map(([x, y]) => novags.probe.at(found, "dn", x, y));
        }""",
        codes,
    )
    assert found == [[None, 0, None], [1, None, None], [None, 2, None], [None, None, 300], [None, 301, None]]


def test_pointing_and_arrow_keys_choose_the_pixel(visit: Callable[..., Any], experiment: Path) -> None:
    tab = visit(experiment / "report.html")
    tab.locator("#compare").scroll_into_view_if_needed()  # a long verdict pushes it below the window
    box = tab.locator("#compare").bounding_box()
    tab.mouse.move(box["x"] + box["width"] * 10.5 / 32, box["y"] + box["height"] * 7.5 / 24)
    probed(tab, 10, 7)
    tab.mouse.click(box["x"] + box["width"] * 20.5 / 32, box["y"] + box["height"] * 3.5 / 24)
    assert "pixel=20" in link_of(tab)
    tab.mouse.move(0, 0)
    tab.locator("#compare").press("ArrowDown")
    probed(tab, 20, 4)
    tab.locator("#compare").press("Shift+ArrowLeft")
    probed(tab, 10, 4)
    tab.locator("#compare").press("+")
    assert tab.evaluate("novags.stage.zoom") == 2


def test_a_small_picture_is_compared_by_a_click_or_a_key(visit: Callable[..., Any], experiment: Path) -> None:
    tab = visit(experiment / "report.html")
    shown = "[...document.querySelectorAll('#left, #right')].map(select => select.value)"
    assert tab.evaluate(shown) == ["render-naive", "render-better"]
    tab.locator(".grid.shown figure[data-key='normal-true'] img").click()
    assert tab.evaluate(shown) == ["render-naive", "normal-true"]
    tab.locator(".grid.shown figure[data-key='error-oracle'] img").click(modifiers=["Shift"])
    tab.locator(".grid.shown figure[data-key='depth-naive'] img").press("Enter")
    assert tab.evaluate(shown) == ["error-oracle", "depth-naive"]
    same = """['left', 'right'].map(side => document.getElementById(side + '-image').src === document.querySelector(
              `.grid.shown figure[data-key='${document.getElementById(side).value}'] img`).src)"""
    assert tab.evaluate(same) == [True, True]
    tab.locator("#view").select_option(index=1)
    assert tab.evaluate(shown) == ["error-oracle", "depth-naive"]
    tab.locator("details#departures-m0 summary").click()
    link = link_of(tab)
    again = visit(experiment / "report.html", link, width=390)
    assert again.evaluate(shown) == ["error-oracle", "depth-naive"]
    assert again.locator("#view").input_value() == "1"
    assert again.locator("details#departures-m0").get_attribute("open") == tab.locator(
        "details#departures-m0").get_attribute("open")  # fmt: skip


def test_single_views_show_any_score_with_its_spread(visit: Callable[..., Any], experiment: Path, psnr: dict) -> None:
    tab = visit(experiment / "report.html")
    assert column(tab, "views-enhanced", 0) == ["0000", "0001"]
    assert column(tab, "views-enhanced", 1) == ["21.25", "19.75"]
    foot = tab.locator('table[data-name="views-enhanced"] tfoot tr')
    spread = [float(value) for value in foot.locator("td:nth-of-type(1)").all_text_contents()]
    told = dict(zip(("mean", "sd", "worst", "best"), spread, strict=True))
    assert told == {"mean": 20.5, "sd": pytest.approx(1.5 / math.sqrt(2), abs=6e-3), "worst": 19.75, "best": 21.25}
    assert tab.locator('[data-strip="enhanced"] circle').count() == 6
    tab.locator('select[data-views="enhanced"]').select_option("flip")
    assert column(tab, "views-enhanced", 1) == [f"{psnr['naive'] / 100:.3f}"] * 2
    again = visit(experiment / "report.html", link_of(tab))
    assert column(again, "views-enhanced", 1) == column(tab, "views-enhanced", 1)


def test_a_number_tells_the_command_that_makes_it_again(visit: Callable[..., Any], experiment: Path) -> None:
    tab = visit(experiment / "report.html")
    tab.evaluate(
        """document.querySelector("[data-name='scores-enhanced'] tbody tr:nth-child(2)").dataset.command ??= "x" """
    )
    cell = tab.locator("[data-name='scores-enhanced'] tbody tr:nth-child(2) td.num").first
    cell.click()
    told = tab.locator(".told")
    assert told.locator("strong").text_content() == "better, PSNR aligned dB: 23.75, place 1 of 2."
    run = open_run(experiment / "better")
    assert told.locator("pre").text_content() == f"{run_again(run, experiment)} && novags score better-again"
    told.get_by_role("button", name="Close").click()
    assert told.count() == 0


def test_the_theme_can_be_switched(visit: Callable[..., Any], experiment: Path) -> None:
    tab = visit(experiment / "report.html", theme="dark")
    back = "getComputedStyle(document.body).backgroundColor"
    dark = tab.evaluate(back)
    tab.get_by_role("button", name="Theme").click()
    light = tab.evaluate(back)
    assert sum(map(int, light[4:-1].split(","))) > 600 > 150 > sum(map(int, dark[4:-1].split(",")))
    tab.get_by_role("button", name="Theme").click()
    assert tab.evaluate(back) == dark
    assert tab.get_by_role("button", name="Theme").text_content() == "Theme: dark"


def test_a_printed_page_is_light_and_its_tables_have_headings_and_all_columns(
    visit: Callable[..., Any], experiment: Path
) -> None:
    """Rationale: paper cannot be moved sideways. Printers shrink pages that are wider, if nothing is cut off."""
    tab = visit(experiment / "report.html", width=700, theme="dark")
    tab.get_by_role("button", name="Theme").click()
    tab.get_by_role("button", name="Theme").click()
    tab.emulate_media(media="print")
    assert tab.get_by_role("button", name="PSNR aligned").first.is_visible()
    assert not tab.get_by_role("button", name="CSV").first.is_visible()
    cut = "boxes => boxes.filter(box => box.scrollWidth > box.clientWidth).map(box => getComputedStyle(box).overflowX)"
    assert set(tab.eval_on_selector_all(".scroll", cut)) == {"visible"}
    assert sum(map(int, tab.evaluate("getComputedStyle(document.body).backgroundColor")[4:-1].split(","))) > 600


def test_a_name_too_long_for_the_strip_of_views_is_cut_in_its_middle(
    visit: Callable[..., Any], experiment: Path
) -> None:
    tab = visit(experiment / "report.html", width=390)
    name = "with-" + "a-long-" * 20 + "name"
    label = tab.evaluate("""name => {
        const found = novags.data.views.enhanced;
        novags.data.looks[name] = novags.data.looks[found.methods[0]];
        found.methods[0] = name;
        novags.views.strip("enhanced", found.scores.aligned_psnr);
        const text = document.querySelector("[data-strip=enhanced] text.name");
        const beyond = text.ownerSVGElement.getBoundingClientRect().left - text.getBoundingClientRect().left;
        return [text.firstChild.textContent, text.querySelector("title").textContent, beyond];
    }""", name)  # fmt: skip
    assert label[0].startswith("with-a-")
    assert label[0].endswith("g-name")
    assert label[1] == name
    assert label[2] <= 0


def test_many_pictures_lie_beside_the_page_and_thumbnails_in_it(
    visit: Callable[..., Any], experiment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(experiment, tmp_path / "run")
    monkeypatch.setattr(album, "INSIDE", 20_000)
    monkeypatch.setattr(album, "THUMB", 8)
    page = write_report(tmp_path / "run", QUIET)
    tab = visit(page, "#pixel=3,4&left=dark")
    probed(tab, 3, 4)
    tab.wait_for_function("document.getElementById('left-image').naturalWidth === 32")
    assert tab.locator(".grid.shown figure img").first.evaluate("image => image.naturalWidth") == 8
    assert page.stat().st_size < (experiment / "report.html").stat().st_size - 100_000
    shutil.rmtree(tmp_path / "run" / "report.files")
    lost = visit(page, lost=True)
    lost.wait_for_selector("#lost:visible")
    assert lost.evaluate("document.getElementById('left-image').naturalWidth") == 8
