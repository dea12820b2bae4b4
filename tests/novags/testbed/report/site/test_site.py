"""Claims about the results site: every study, method and scene has a page, all links lead somewhere, numbers agree."""

import json
import os
import re
import shutil
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.site.writing import write_site

QUIET = Console(quiet=True)
SCORES = {("naive", 5): 20.0, ("better", 5): 23.0, ("naive", 50): 26.0, ("better", 50): 25.0}


@pytest.fixture(scope="module")
def study(experiment: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two methods at two light levels by two seeds and two sizes, whose runs are those of the made report."""
    folder = tmp_path_factory.mktemp("of") / "light & more"
    folder.mkdir()
    axes = {"scene": ["a:1"], "electrons": [5, 50], "method": ["naive", "better"], "seed": [0, 1], "width": [64]}
    rows = [{"run": 2 * n + seed, "scene": "a:1", "electrons": electrons, "method": method, "seed": seed, "width": 64,
             "state": "done", "folder": os.path.relpath(experiment / method, folder),
             "enhanced.aligned_psnr": value + seed, "lit.flip": 0.25}
            for n, ((method, electrons), value) in enumerate(SCORES.items()) for seed in (0, 1)]  # fmt: skip
    rows[-1] |= {"state": "failed", "reason": "the <disk> broke"}
    (folder / "results.json").write_text(json.dumps({"axes": axes, "columns": [], "rows": rows}))
    (folder / "results.csv").write_text("run\n1\n")
    table = {"variant": {"better": {"method": "naive"}}, "grid": axes}
    (folder / "study.json").write_text(json.dumps({"file": "l.toml", "table": table}))
    return folder


@pytest.fixture(scope="module")
def site(study: Path, experiment: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "site"
    assert write_site([study, experiment], out, QUIET) == out / "index.html"
    return out


class Links(HTMLParser):
    """What a page refers to, and its cells."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.found: list[str] = []
        self.feed(re.sub(r"<script.*?</script>", "", page.read_text(encoding="utf-8"), flags=re.S))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [value for name, value in attrs if name in ("href", "src") and value]


def test_every_link_and_picture_lies_in_the_site(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert {page.relative_to(site).as_posix() for page in pages} >= {
        "index.html", "methods/naive.html", "methods/better.html", "methods/oracle.html", "scenes/a-1.html",
        "studies/light-more/index.html",
    }  # fmt: skip
    reached = set[Path]()
    for page in pages:
        for link in Links(page).found:
            if not link.startswith(("#", "data:")):
                target = (page.parent / link.partition("#")[0]).resolve()
                assert target.is_file(), f"{page}: {link}"
                assert target.is_relative_to(site.resolve()), f"{page}: {link}"
                reached.add(target)
    assert reached >= {page.resolve() for page in pages}
    assert reached >= {file.resolve() for file in site.rglob("*.webp")}
    assert len([*site.rglob("*.webp")]) >= 4


def cells(page: Path, name: str) -> list[list[str]]:
    """The texts of the rows of a table."""
    (table,) = re.findall(rf'<table data-name="{name}".*?</table>', page.read_text(encoding="utf-8"), re.S)
    return [
        [re.sub(r"<[^>]+>", "", cell).strip() for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.S)]
        for row in re.findall(r"<tr[^>]*>(.*?)</tr>", table, re.S)
    ]


def test_a_row_is_a_method_at_a_place_with_the_mean_of_its_seeds_and_its_place_there(site: Path) -> None:
    heads, *rows = cells(site / "index.html", "entries")
    assert heads[:7] == ["Place", "Method", "Scene", "Light", "Camera", "Else", "Study"]
    column = next(k for k, head in enumerate(heads) if head.startswith("PSNR aligned"))
    of_study = [row for row in rows if row[6] == "light-more"]
    found = {(row[1], row[3]): (row[0], row[column].split()[0]) for row in of_study}
    assert found == {("better", "5 electrons"): ("1", "23.50"), ("naive", "5 electrons"): ("2", "20.50"),
                     ("naive", "50 electrons"): ("1", "26.50"), ("better", "50 electrons"): ("2", "25.00")}  # fmt: skip
    assert {row[5] for row in of_study} == {"width 64"}
    others = [row for row in rows if row[6] != "light-more"]
    assert {(row[0], row[1]) for row in others} == {("†", "oracle†"), ("1", "better"), ("2", "naive")}
    assert {row[3] for row in others} == {"200 electrons"}


def test_a_page_of_a_method_has_all_its_rows_settings_and_pictures(site: Path) -> None:
    page = site / "methods" / "better.html"
    heads, *rows = cells(page, "places")
    assert "Method" not in heads  # the page is of one
    assert len(rows) == 3
    told = page.read_text(encoding="utf-8")
    assert "enhance, then fit the noisy pictures" in told
    assert "fit.dssim_weight</dt><dd>0.2 → 0.1" in told
    assert told.count("<figure>") >= 2
    assert "yes: a bound and no rival" not in told
    assert "yes: a bound and no rival" in (site / "methods" / "oracle.html").read_text(encoding="utf-8")
    scene = site / "scenes" / "a-1.html"
    assert {row[1] for row in cells(scene, "methods")[1:]} == {"naive", "better"}


def test_tables_lie_there_as_csv_and_latex(site: Path, study: Path) -> None:
    folder = site / "studies" / "light-more"
    assert (folder / "results.csv").read_bytes() == (study / "results.csv").read_bytes()
    told = (folder / "ranking.tex").read_text(encoding="utf-8")
    assert told.startswith("\\begin{tabular}{")
    assert "better" in told
    assert "results.csv" in (site / "index.html").read_text(encoding="utf-8")


def test_a_second_site_replaces_the_first_and_nothing_else(study: Path, experiment: Path, tmp_path: Path) -> None:
    out = tmp_path / "site"
    write_site([experiment], out, QUIET)
    assert (out / "methods" / "oracle.html").is_file()
    (out / "mine.txt").write_text("mine")
    pictures = {file.name for file in out.rglob("*.webp")}
    write_site([study, study], out, QUIET)
    assert not (out / "methods" / "oracle.html").exists()
    assert (out / "studies" / "light-more-2" / "index.html").is_file()
    assert (out / "mine.txt").read_text() == "mine"
    assert {file.name for file in out.rglob("*.webp")} < pictures
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match=r"other holds thesis\.tex and no site\.json"):
        write_site([experiment], tmp_path / "other", QUIET)
    write_site([experiment], tmp_path / "other", QUIET, overwrite=True)
    assert (tmp_path / "other" / "thesis.tex").read_text() == "years of work"


def test_a_site_stays_out_of_what_it_is_about_and_pages_out_of_other_folders(experiment: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="name at least one folder"):
        write_site([], tmp_path / "site", QUIET)
    own = Path(shutil.copytree(experiment, tmp_path / "own"))
    for place in (own, own / "site"):
        with pytest.raises(ValueError, match="which the site is about: choose a folder beside it"):
            write_site([own], place, QUIET, overwrite=True)
    (tmp_path / "site").mkdir()
    (tmp_path / "kept.txt").write_text("kept")
    (tmp_path / "site" / "site.json").write_text(json.dumps({"pages": ["../kept.txt", str(tmp_path / "kept.txt")]}))
    write_site([experiment], tmp_path / "site", QUIET)
    assert (tmp_path / "kept.txt").read_text() == "kept"


def test_rows_are_found_by_words_and_by_values_and_the_address_keeps_both(
    site: Path, visit: Callable[..., Any]
) -> None:
    page = visit(site / "index.html")
    rows = page.locator("table[data-name=entries] tbody tr:visible")
    assert rows.count() == 7
    page.locator("input[type=search]").fill("better 50")
    assert rows.count() == 1
    page.locator("input[type=search]").fill("BETTER")
    assert rows.count() == 3
    page.locator("select[data-key='only.entries.Light']").select_option("5 electrons")
    assert rows.count() == 1
    page.wait_for_timeout(300)
    link = page.evaluate("location.hash")
    again = visit(site / "index.html", link)
    assert again.locator("table[data-name=entries] tbody tr:visible").count() == 1
    assert again.locator("input[type=search]").input_value() == "BETTER"


@pytest.mark.parametrize("page", ["index.html", "methods/better.html", "scenes/a-1.html"])
def test_pages_fit_a_telephone(page: str, site: Path, visit: Callable[..., Any]) -> None:
    for width in (1300, 390):
        shown = visit(site / page, width=width)
        assert shown.evaluate("document.documentElement.scrollWidth") <= width
        assert shown.evaluate("[...document.images].every(image => image.complete && image.naturalWidth > 0)") or (
            shown.evaluate("[...document.images].forEach(i => i.loading = 'eager')"), shown.wait_for_timeout(300),
            shown.evaluate("[...document.images].every(image => image.naturalWidth > 0)"),
        )[-1]  # fmt: skip
