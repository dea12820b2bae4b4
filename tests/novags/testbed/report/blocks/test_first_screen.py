"""Claims about what is seen without scrolling, and about copies of tables, in a browser."""

import csv
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

SIZES = [(1300, 900), (390, 844)]


@pytest.fixture
def at(visit: Callable[..., Any], experiment: Path) -> Callable[[int, int], Any]:
    """The page on a screen of this size."""

    def open_at(width: int, height: int, link: str = "") -> Any:
        tab = visit(experiment / "report.html", link, width=width)
        tab.set_viewport_size({"width": width, "height": height})
        return tab

    return open_at


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_strip_ranking_chart_and_contents_are_seen_without_scrolling(at: Any, width: int, height: int) -> None:
    tab = at(width, height)
    bottoms = tab.evaluate("""() => Object.fromEntries(Object.entries({
        contents: ".contents", strip: ".film", ranking: ".ranking table", chart: ".ranking .chart", verdict: ".verdict",
    }).map(([name, where]) => [name, document.querySelector(where).getBoundingClientRect().bottom]))""")
    assert all(0 < bottom <= height for bottom in bottoms.values()), bottoms
    assert tab.evaluate("document.documentElement.scrollWidth") == width
    assert tab.locator(".film figure").evaluate_all("all => all.map(one => one.dataset.film)") == [
        "dark", "render-naive", "render-better", "truth-enhanced"
    ]  # fmt: skip
    assert tab.locator(".film img").evaluate_all("all => all.every(one => one.complete && one.naturalWidth === 32)")
    rows = tab.locator(".ranking tbody tr").evaluate_all("all => all.map(row => [...row.cells].map(c => c.innerText))")
    assert [row[:3] for row in rows] == [["†", "oracle†", "30.50"], ["1", "better", "23.75"], ["2", "naive", "20.25"]]
    assert rows[1][3].startswith("+3.50")


def test_the_contents_lead_to_every_part_and_keep_what_is_chosen(at: Any) -> None:
    tab = at(1300, 900, "#left=dark&view=0001")
    links = tab.locator(".contents a").evaluate_all("all => all.map(one => one.hash.slice(1))")
    assert links == tab.locator("h2").evaluate_all("all => all.map(one => one.id)")
    tab.locator(".contents a", has_text="Cost").press("Enter")
    tab.wait_for_function("document.getElementById('cost').getBoundingClientRect().top < innerHeight")
    assert tab.locator("#left").input_value() == "dark"
    assert tab.evaluate("novags.state.values.toString()") == "left=dark&view=0001&at=cost"


def test_no_picture_is_twice_in_the_page_and_the_grid_shows_those_of_the_strip(at: Any, experiment: Path) -> None:
    heads, *grids = (experiment / "report.html").read_text(encoding="utf-8").split('<div class="grid"')
    film = re.findall(r'data-film="([^"]+)"', heads)
    assert re.findall(r'data-key="([^"]+)"><img data-strip', grids[0]) == film
    assert not any("<img data-strip" in grid for grid in grids[1:])
    tab = at(1300, 900)
    assert tab.locator(".grid.shown img").evaluate_all("all => all.every(one => one.src.startsWith('data:'))")
    tab.locator('.film [data-film="truth-enhanced"] a').press("Enter")
    assert tab.evaluate("novags.byId('right').value") == "truth-enhanced"
    same = "document.querySelector('.film [data-film=truth-enhanced] img').src === novags.byId('right-image').src"
    assert tab.evaluate(same)


def test_pictures_keep_their_codes_and_maps_take_half_their_bytes(experiment: Path) -> None:
    page = (experiment / "report.html").read_text(encoding="utf-8")
    found = re.findall(
        r'<figure data-key="([^"-]+)[^"]*"><img src="data:image/webp;base64,([^"]+)"( data-exact)?', page
    )
    kinds = {kind for kind, *_ in found}
    assert kinds == {"dark", "enhanced", "render", "truth", "error", "depth", "normal"}
    maps = {"error", "depth", "normal"}
    assert all(bool(exact) == (kind not in maps) for kind, _, exact in found)
    size = {on: [len(data) for kind, data, _ in found if (kind in maps) == on] for on in (True, False)}
    assert sum(size[True]) / len(size[True]) < 0.5 * sum(size[False]) / len(size[False])


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_choices_are_unique_and_read_whole(at: Any, width: int, height: int) -> None:
    """Rationale: "Rendered by nov" stood for three methods."""
    tab = at(width, height)
    for side in ("left", "right"):
        labels = tab.locator(f"#{side} option").all_text_contents()
        assert len(set(labels)) == len(labels) > 12
        cut = tab.evaluate("""side => {
            const select = document.getElementById(side), pen = document.createElement("canvas").getContext("2d");
            pen.font = getComputedStyle(select).font;
            const room = select.clientWidth - 20;  // the arrow
            return [...select.options].map(o => o.text).filter(text => pen.measureText(text).width > room);
        }""", side)  # fmt: skip
        assert cut == []


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_pictures_stand_in_a_grid_of_methods_by_picture_error_depth_and_normals(
    at: Any, width: int, height: int
) -> None:
    tab = at(width, height)
    rows = tab.locator(".grid.shown .row:not(.heads)").evaluate_all("""all => all.map(row => [
        row.querySelector("strong").textContent, [...row.querySelectorAll("figure")].map(one => one.dataset.key)])""")
    for name in ("naive", "better", "oracle"):
        assert [name, [f"{kind}-{name}" for kind in ("render", "error", "depth", "normal")]] in rows
    assert rows[0][0] == "Camera"
    assert ["Truth", ["truth-enhanced", "depth-true", "normal-true"]] in rows
    lefts = tab.evaluate("""() => ["naive", "oracle", "true"].map(name => Math.round(
        document.querySelector(`.grid.shown [data-key=depth-${name}]`).getBoundingClientRect().left))""")
    assert len(set(lefts)) == 1


def test_columns_that_say_the_same_in_every_row_are_folded_away_and_said_once(at: Any) -> None:
    tab = at(1300, 900)
    table = tab.locator('table[data-name="scores-enhanced"]')
    heads = table.locator("thead th").evaluate_all(
        "all => all.filter(one => one.offsetParent).map(one => one.innerText)"
    )
    assert not any("LPIPS" in head for head in heads)
    note = table.evaluate("one => one.parentElement.nextElementSibling.textContent")
    assert note.startswith("The same in every row:")
    assert "LPIPS unavailable" in note
    cell = table.locator("tbody tr td.num").first
    for _ in range(40):  # no key leads into what is not seen
        tab.keyboard.press("ArrowRight") if _ else cell.press("ArrowRight")
        assert tab.evaluate("document.activeElement.offsetParent !== null")


def test_ticks_are_round(at: Any) -> None:
    tab = at(1300, 900)
    ticks = tab.locator("[data-strip=enhanced] .tick").all_text_contents()
    assert len(ticks) > 2
    steps = {round(float(b.split()[0]) - float(a.split()[0]), 9) for a, b in zip(ticks, ticks[1:], strict=False)}
    assert len(steps) == 1
    assert str(steps.pop()).strip("0.") in ("1", "2", "5")
    found = tab.evaluate("[[23.81, 30.77], [0.031, 0.052], [0, 1]].map(ends => novags.views.ticks(...ends))")
    assert found == [
        [24, 26, 28, 30],
        pytest.approx([0.035, 0.04, 0.045, 0.05]),
        pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1]),
    ]


def copied(tab: Any, kind: str) -> str:
    tab.evaluate("navigator.clipboard.writeText = async (text) => { window.copied = text; }")
    tab.locator(f'[aria-label="Copy “Scores against enhanced” as {kind}"]').press("Enter")
    tab.wait_for_function("window.copied !== undefined")
    return str(tab.evaluate("window.copied"))


def test_a_table_is_copied_as_it_is_shown(at: Any, experiment: Path) -> None:
    markdown = copied(at(1300, 900, "#sort.scores-enhanced=2a"), "Markdown").splitlines()
    assert markdown[0].startswith("| # | Method | PSNR aligned dB | ")
    assert markdown[1].startswith("| --- | --- | ---: | ")
    assert [line.split(" | ")[:3] for line in markdown[2:]] == [
        ["| 2", "naive", "20.25"], ["| 1", "better", "**23.75**"], ["| †", "oracle†", "30.50"]
    ]  # fmt: skip
    assert "LPIPS" not in markdown[0]
    lines = copied(at(1300, 900), "LaTeX").splitlines()
    columns = markdown[0].count(" | ") + 1
    assert lines[0] == f"\\begin{{tabular}}{{ll{'r' * (columns - 2)}}}"
    assert [lines[1], lines[3], lines[-2], lines[-1]] == ["\\toprule", "\\midrule", "\\bottomrule", "\\end{tabular}"]
    assert all(line.count(" & ") == columns - 1 and line.endswith("\\\\") for line in lines[4:-2])
    assert lines[4].startswith("$^\\dagger$ & oracle$^\\dagger$ & 30.50 & ")
    assert lines[5].startswith("1 & better & \\textbf{23.75} & ")
    assert "\\# & Method & PSNR aligned dB & " in lines[2]
    rows = list(csv.DictReader(io.StringIO(copied(at(1300, 900), "CSV"))))
    assert [(row["Method"], float(row["PSNR aligned dB"])) for row in rows] == [
        ("oracle", 30.5), ("better", 23.75), ("naive", 20.25)
    ]  # fmt: skip


def test_a_browser_that_refuses_the_clipboard_still_copies(at: Any) -> None:
    tab = at(1300, 900)
    tab.evaluate("""() => {
        navigator.clipboard.writeText = async () => { throw new Error("refused"); };
        document.execCommand = () => { window.copied = document.activeElement.value; };
    }""")
    tab.locator('[aria-label="Copy “The ranking” as Markdown"]').press("Enter")
    tab.wait_for_function("window.copied !== undefined")
    assert "| 1 | better |" in tab.evaluate("window.copied")


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_first_second_and_third_are_red_orange_and_yellow_and_can_be_read(
    visit: Callable[..., Any], experiment: Path, theme: str
) -> None:
    """Contrast of text with its ground: 4.5 : 1 (WCAG 2.1, 1.4.3)."""
    tab = visit(experiment / "report.html", theme=theme)
    found = tab.evaluate("""() => {
        const cells = document.querySelectorAll("[data-name=scores-enhanced] tbody tr td.num:nth-child(3)");
        const pen = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
        const drawn = (...colours) => {
            for (const colour of colours) { pen.fillStyle = colour; pen.fillRect(0, 0, 1, 1); }
            return [...pen.getImageData(0, 0, 1, 1).data.slice(0, 3)];
        };
        const cell = cells[0], back = getComputedStyle(document.body).backgroundColor;
        return [["best", 1], ["", 2], ["", 3]].map(([kind, rank]) => {
            cell.className = `num ${kind}`;
            cell.dataset.rank = rank;
            cell.append(document.createElement("small"));  // errors
            const texts = [getComputedStyle(cell), getComputedStyle(cell.lastChild), getComputedStyle(cell, "::after")];
            return [drawn(back, getComputedStyle(cell).backgroundColor), texts.map((text) => drawn(text.color))];
        });
    }""")

    def luminance(colour: list[int]) -> float:
        parts = [part / 255 / 12.92 if part <= 10 else ((part / 255 + 0.055) / 1.055) ** 2.4 for part in colour]
        return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), parts, strict=True))

    for back, texts in found:
        for text in texts:
            low, high = sorted((luminance(back), luminance(text)))
            assert (high + 0.05) / (low + 0.05) >= 4.5
    (red, orange, yellow) = ([back[0] - back[1], back[1] - back[2]] for back, _ in found)
    assert red[0] > orange[0] > yellow[0]  # ever more green
    assert yellow[1] > red[1]
    assert min(red[0], orange[0], orange[1], yellow[1]) > 20


def test_the_page_opens_without_scripts(browser: Any, experiment: Path) -> None:
    context = browser.new_context(java_script_enabled=False, viewport={"width": 1300, "height": 900})
    tab = context.new_page()
    tab.goto((experiment / "report.html").as_uri())
    assert tab.locator(".film img").count() == 4
    assert tab.locator(".ranking tbody tr").count() == 3
    assert tab.locator(".ranking svg.chart").is_visible()
    context.close()
