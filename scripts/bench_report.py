"""How long the report on a large study takes to build and to open: bench_report.py STUDY [--runs 1000] [--out DIR].

STUDY is the folder of a finished study. Its runs are repeated, each copy as a value of a further axis, until there
are enough: every row is read, drawn and written as a run of its own. Opening is measured in headless Chromium, from
the request to the load event and to an answer of the page's scripts, best of three.
"""

import argparse
import itertools
import json
import os
import resource
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

from novags.process import settle
from novags.testbed.report.look.album import files_of
from novags.testbed.report.page import write_study


def repeated(study: Path, out: Path, runs: int) -> None:
    """Write the tables of a study whose finished runs repeat the runs of `study` again and again."""
    results = json.loads((study / "results.json").read_text())
    done = [row for row in results["rows"] if row["state"] == "done"]
    rows: list[dict[str, Any]] = []
    for copy in itertools.count():
        for row in done[: runs - len(rows)]:
            folder = os.path.relpath((study / row["folder"]).resolve(), out.resolve())
            rows.append({**row, "run": len(rows) + 1, "copy": copy, "folder": folder})
        if len(rows) == runs:
            break
    axes = {**results["axes"], "copy": list(range(copy + 1))}
    (out / "results.json").write_text(json.dumps({"axes": axes, "columns": results["columns"], "rows": rows}))
    shutil.copyfile(study / "study.json", out / "study.json")


def opened(page: Path) -> tuple[float, float] | None:
    """Seconds until the page is loaded, and until its scripts answer; None without a browser."""
    if (chromium := shutil.which("chromium")) is None:
        return None
    from playwright.sync_api import sync_playwright

    found = []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for _ in range(3):
            tab = browser.new_page(viewport={"width": 1300, "height": 900})
            start = time.perf_counter()
            tab.goto(page.resolve().as_uri())
            loaded = time.perf_counter() - start
            tab.locator("thead button").first.click()
            found.append((loaded, time.perf_counter() - start))
            tab.close()
        browser.close()
    return min(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", type=Path)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--out", type=Path, help="keep the report there")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="novags-bench-") as temporary:
        out = options.out or Path(temporary)
        out.mkdir(parents=True, exist_ok=True)
        repeated(options.study, out, options.runs)
        start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF)
        page = write_study(out)
        after = resource.getrusage(resource.RUSAGE_SELF)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        beside = sum(path.stat().st_size for path in files_of(page).glob("*")) if files_of(page).is_dir() else 0
        print(f"{options.runs} runs: built in {time.perf_counter() - start:.1f} s ({cpu:.1f} s of processor time), "
              f"{page.stat().st_size / 1e6:.1f} MB, {beside / 1e6:.1f} MB beside it")  # fmt: skip
        if (found := opened(page)) is not None:
            print(f"loaded in {found[0]:.2f} s, a click answered after {found[1]:.2f} s")


if __name__ == "__main__":
    settle()
    main()
