"""Claims about the results site in a browser: rows are found, and pages fit small screens."""

import json
import os
from collections.abc import Callable
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
    table = {"variant": {"better": {"method": "naive"}}, "grid": axes}
    (folder / "study.json").write_text(json.dumps({"file": "l.toml", "table": table}))
    return folder


@pytest.fixture(scope="module")
def site(study: Path, experiment: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "site"
    write_site([study, experiment], out, QUIET)
    return out


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
