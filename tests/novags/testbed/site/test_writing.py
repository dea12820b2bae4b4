"""Claims about the pages of a site: each study, method and scene has its own, with all rows, pictures and facts."""

import json
import os
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from novags.methods import METHODS
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.ledger.contents import jsonable
from novags.testbed.report.look import album
from novags.testbed.report.page import write_reports
from novags.testbed.site.writing import write_site
from novags.testbed.stages import capture
from novags.testbed.stages.configs.capturing import CaptureConfig
from simscenes.sets.pictures.exr import write_exr
from simscenes.sets.pictures.png import write_png
from tests.fuzz.readers.records import SIZE, make_run, make_set

QUIET = Console(quiet=True)
HELD_OUT, PSNR = "0000", "PSNR aligned, noise-free dB ↑"
VARIANTS = {name: {"method": "naive"} for name in ("better", "lone")}
# Scene, electrons, method, seed, aligned PSNR; grey of the render, iterations of the fit and memory of the run.
DIM = (("attic", 7, "lone", 0, 20.0, 50, 100, 300), ("attic", 7, "lone", 1, 20.0, 50, 100, 200),
       ("hall", 5, "naive", 0, 21.0, 60, 200, 100),
       ("hall", 5, "naive", 1, 23.0, 70, 200, 900), ("hall", 5, "better", 0, 25.0, 80, 300, 800),
       ("hall", 50, "naive", 0, 27.5, 90, 200, 100), ("hall", 50, "better", 0, 26.5, 100, 300, 200))  # fmt: skip
LONG = (("hall", 5, "naive", 0, 31.0, None, 0, 0), ("hall", 50, "naive", 0, 33.0, 110, 200, 500),
        ("hall", 50, "better", 0, 35.0, 120, 400, 700))  # fmt: skip
TRUTHS = {("attic", 7): 150, ("hall", 5): 180, ("hall", 50): 210}  # grey of the well-lit pictures of each capture
NOISE = 130  # grey of the pictures of the experiment


def make_captures(folder: Path) -> None:
    """A capture of each place, of noise, whose well-lit pictures are of its own grey."""
    for (scene, electrons), grey in TRUTHS.items():
        place = folder / f"{scene}-{electrons}"
        (place / "set").mkdir(parents=True)
        make_set(place / "set")
        for file in (place / "set" / "images").iterdir():
            write_png(file, np.full((*SIZE, 3), grey, np.uint8))
        capture(place / "set", place / "capture", CaptureConfig(electrons=electrons), QUIET)


def make_study(folder: Path, captures: Path, model: dict[str, Any], rows: Any) -> Path:
    """A study whose runs show their grey; a run without one has lost its folder, and one more has failed."""
    keys, table = ("scene", "electrons", "method", "seed"), []
    for number, (*place, score, grey, iterations, memory) in enumerate(rows, 1):
        own = dict(zip(keys, place, strict=True))
        table.append(own | {"run": number, "state": "done", "folder": str(number), "enhanced.aligned_psnr": score})
        if grey is None:
            continue
        run, path = folder / str(number), captures / f"{own['scene']}-{own['electrons']}" / "capture"
        captured = open_capture(path)
        assert captured.record.simulated is not None
        config = jsonable(METHODS["naive"].config())
        config["fit"]["iterations"] = iterations
        stage = model["stage"] | {"inputs": {"capture": captured.content, "set": captured.record.simulated.set_content}}
        record = model | {"name": own["method"], "capture": os.path.relpath(path, run), "config": config,
                          "stage": stage, "peak_bytes": memory * 10**6}  # fmt: skip
        write_png(run / "renders" / f"{HELD_OUT}.png", np.full((*SIZE, 3), grey, np.uint8))
        light = np.full(SIZE, grey / 255, np.float32)
        write_exr(run / "exr" / f"{HELD_OUT}.exr", dict.fromkeys(("R", "G", "B", "Z", "alpha"), light))
        (run / "run.json").write_text(json.dumps(record))
        (run / "events.jsonl").write_text("")
    table.append(table[-1] | {"run": len(table) + 1, "seed": 2, "state": "failed", "reason": "the <disk> broke"})
    axes = {key: list(dict.fromkeys(row[key] for row in table)) for key in keys}
    (folder / "results.json").write_text(json.dumps({"axes": axes, "columns": [], "rows": table}))
    (folder / "study.json").write_text(
        json.dumps({"file": f"{folder.name}.toml", "table": {"variant": VARIANTS, "grid": axes}})
    )
    for name in ("results.csv", "differences.csv"):
        (folder / name).write_text(f"{name} of {folder.name}\n")
    return folder


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two studies, of which one has a place more and the other has lost its first run, and an experiment."""
    folder = tmp_path_factory.mktemp("of")
    for name in ("dim & low", "long", "plain"):
        (folder / name).mkdir()
    make_run(folder / "plain")
    model = json.loads((folder / "plain" / "naive" / "run.json").read_text())
    make_captures(folder / "captures")
    studies = [make_study(folder / name, folder / "captures", model, rows)
               for name, rows in (("dim & low", DIM), ("long", LONG))]  # fmt: skip
    return [*studies, folder / "plain"]


@pytest.fixture(scope="module")
def site(folders: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "site"
    assert write_site(folders, out, QUIET) == out / "index.html"
    return out


def text(page: Path) -> str:
    """A page without its scripts."""
    return re.sub(r"<script.*?</script>", "", page.read_text(encoding="utf-8"), flags=re.S)


def said(html: str) -> str:
    return " ".join(re.sub(r"<[^>]+>", "", html).split())


def rows(page: Path, name: str) -> list[dict[str, str]]:
    """The rows of a table, by the headings."""
    (table,) = re.findall(rf'<table data-name="{name}".*?</table>', text(page), re.S)
    heads, *found = [[said(cell) for cell in re.findall(r"<t[hd].*?</t[hd]>", row, re.S)]
                     for row in re.findall(r"<tr.*?</tr>", table, re.S)]  # fmt: skip
    return [dict(zip(heads, row, strict=True)) for row in found]


def facts(html: str) -> dict[str, str]:
    return {said(what): said(why) for what, why in re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", html)}


def grey(page: Path, html: str) -> int:
    """The mean code of a picture, to the nearest ten."""
    (source,) = re.findall(r'<img src="([^"]+)"', html)
    picture = cv2.imread(str(page.parent / source))
    assert picture is not None, source
    return 10 * round(float(picture.mean()) / 10)


def pictures(page: Path, html: str) -> list[tuple[str, int]]:
    """The label and the grey of each picture."""
    return [(said(figure.partition("</strong>")[0]), grey(page, figure))
            for figure in re.findall(r"<figure>.*?</figure>", html, re.S)]  # fmt: skip


def links(html: str) -> list[str]:
    return [link for link in re.findall(r'(?:href|src)="([^"]+)"', html) if not link.startswith(("#", "data:"))]


def test_a_site_lies_in_no_folder_that_it_is_about(folders: list[Path], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="name at least one folder"):
        write_site([], tmp_path / "site", QUIET)
    for folder in folders:
        for place in (folder, folder / "site"):
            told = f"lies in {folder}, which the site is about: choose a folder beside it"
            with pytest.raises(ValueError, match=re.escape(told)):
                write_site(folders, place, QUIET, overwrite=True)


def test_every_link_and_picture_lies_in_the_site(site: Path) -> None:
    pages, reached = [*site.rglob("*.html")], set[Path]()
    for page in pages:
        for link in links(text(page)):
            target = (page.parent / link.partition("#")[0]).resolve()
            assert target.is_file(), f"{page}: {link}"
            assert target.is_relative_to(site.resolve()), f"{page}: {link}"
            reached.add(target)
    assert reached >= {file.resolve() for kind in ("html", "webp", "csv", "tex") for file in site.rglob(f"*.{kind}")}
    assert {page.relative_to(site).as_posix() for page in pages} == {
        "index.html", "studies/dim-low/index.html", "studies/long/index.html", "studies/plain/index.html",
        "methods/lone.html", "methods/naive.html", "methods/better.html", "methods/oracle.html",
        "scenes/attic.html", "scenes/hall.html", "scenes/set.html",
    }  # fmt: skip


def test_the_first_page_has_a_card_of_each_study_with_a_picture_its_runs_and_its_tables(site: Path) -> None:
    page, found = site / "index.html", []
    for card in re.findall(r"<article>(.*?)</article>", text(page), re.S):
        report, _, *files = links(card)
        title, done = re.findall(r"<p>(.*)\. (\d of \d) runs\.</p>", card)[0]
        found.append((title.partition(":")[0], grey(page, card), done, report, [Path(file).name for file in files]))
        assert {Path(file).parent for file in files} == {Path(report).parent}
    tables = ["results.csv", "differences.csv", "ranking.tex"]
    assert found == [
        ("dim &amp; low", TRUTHS["attic", 7], "7 of 8", "studies/dim-low/index.html", tables),
        ("long", TRUTHS["hall", 50], "3 of 4", "studies/long/index.html", tables),  # of its first run there is none
        ("set at 200 electrons per pixel", NOISE, "2 of 2", "studies/plain/index.html", tables[2:]),
    ]  # fmt: skip
    assert "<h1>3 studies of reconstruction in the dark</h1>" in text(page)


def test_the_first_page_has_a_row_of_each_method_at_each_place_with_the_mean_of_its_seeds(site: Path) -> None:
    found = [(row["Study"], row["Scene"], row["Light"], row["Place"], row["Method"], row[PSNR].split(" ")[0])
             for row in rows(site / "index.html", "entries")]  # fmt: skip
    assert found == [
        ("dim-low", "attic", "7 electrons", "1", "lone", "20.00"),
        ("dim-low", "hall", "5 electrons", "1", "better", "25.00"),
        ("dim-low", "hall", "5 electrons", "2", "naive", "22.00"),
        ("dim-low", "hall", "50 electrons", "1", "naive", "27.50"),
        ("dim-low", "hall", "50 electrons", "2", "better", "26.50"),
        ("long", "hall", "5 electrons", "1", "naive", "31.00"),
        ("long", "hall", "50 electrons", "1", "better", "35.00"),
        ("long", "hall", "50 electrons", "2", "naive", "33.00"),
        ("plain", "set", "200 electrons", "1", "naive", "20.00"),
        ("plain", "set", "200 electrons", "†", "oracle†", "20.00"),
    ]


def test_the_first_page_leads_to_each_method_with_its_title_and_to_each_scene(site: Path) -> None:
    page = text(site / "index.html")
    naive, oracle = METHODS["naive"].title, METHODS["oracle"].title
    assert facts(page) == {"lone": naive, "better": naive, "naive": naive, "oracle†": oracle}
    scenes = page.partition('<h2 id="scenes">')[2]
    assert re.findall(r'<a href="([^"]+)">([^<]+)</a>', scenes) == [
        (f"scenes/{name}.html", name) for name in ("attic", "hall", "set")
    ]


@pytest.mark.parametrize(
    ("name", "method", "scores", "memory"),
    [("lone", "naive", ["20.00"], "300 MB"), ("better", "naive", ["25.00", "26.50", "35.00"], "800 MB"),
     ("naive", "naive", ["22.00", "27.50", "31.00", "33.00", "20.00"], "900 MB"),
     ("oracle", "oracle", ["20.00"], "100 MB")],
)  # fmt: skip
def test_a_page_of_a_method_has_its_facts_over_all_runs_and_all_its_rows(
    site: Path, name: str, method: str, scores: list[str], memory: str
) -> None:
    page, known = site / "methods" / f"{name}.html", METHODS[method]
    bound = {"sees the truth": "yes: a bound and no rival"} if method == "oracle" else {}
    assert facts(text(page).partition("</header>")[0]) == {
        "method": method, "family": known.family, "source": known.source, **bound, "peak memory": memory
    }  # fmt: skip
    found = rows(page, "places")
    assert [row[PSNR].split(" ")[0] for row in found] == scores
    assert "Method" not in found[0]  # the page is of one


def test_a_page_of_a_method_has_a_picture_of_each_place_beside_the_truth(site: Path) -> None:
    page = site / "methods" / "better.html"
    assert pictures(page, text(page)) == [
        ("hall, 5 electrons", 80), ("Truth", 180), ("hall, 50 electrons", 100), ("Truth", 210),
        ("hall, 50 electrons", 120), ("Truth", 210),
    ]  # fmt: skip


def test_a_page_of_a_method_says_for_each_study_what_differs_and_all_settings(site: Path) -> None:
    page = text(site / "methods" / "better.html").partition('<h2 id="settings">')[2]
    differing, _, every = page.partition("<details")
    assert {said(study).partition(":")[0]: facts(found)
            for study, found in re.findall(r"<h3>(.*?)</h3>(.*?</dl>)", differing, re.S)} == {
        "dim-low": {"fit.iterations": "7000 → 300"}, "long": {"fit.iterations": "7000 → 400"},
    }  # fmt: skip
    found = facts(every)
    assert (found["fit.iterations"], found["pictures"]) == ("300", "8bit")


def test_a_page_of_a_scene_has_its_rows_and_a_strip_of_pictures_for_each_place_of_each_study(site: Path) -> None:
    page = site / "scenes" / "hall.html"
    found = [(row["Study"], row["Light"], row["Method"], row[PSNR].split(" ")[0]) for row in rows(page, "methods")]
    assert found == [
        ("dim-low", "5 electrons", "better", "25.00"), ("dim-low", "5 electrons", "naive", "22.00"),
        ("dim-low", "50 electrons", "naive", "27.50"), ("dim-low", "50 electrons", "better", "26.50"),
        ("long", "5 electrons", "naive", "31.00"),
        ("long", "50 electrons", "better", "35.00"), ("long", "50 electrons", "naive", "33.00"),
    ]  # fmt: skip
    strips = re.findall(r"<h3>(.*?)</h3>(.*?)</div>", text(page), re.S)
    shown = {where: pictures(page, strip) for where, strip in strips}
    assert {strip[0][0] for strip in shown.values()} == {"Dark input"}
    assert {where: strip[1:] for where, strip in shown.items()} == {
        "dim-low: scene hall, electrons 5": [("Truth: well lit", 180), ("better", 80), ("naive", 60)],
        "dim-low: scene hall, electrons 50": [("Truth: well lit", 210), ("naive", 90), ("better", 100)],
        "long: scene hall, electrons 50": [("Truth: well lit", 210), ("better", 120), ("naive", 110)],
    }
    alone = site / "scenes" / "set.html"
    assert re.findall(r"<h3>(.*?)</h3>", text(alone)) == ["plain"]
    assert [label for label, _ in pictures(alone, text(alone))][2:] == ["naive", "oracle"]


def test_the_tables_of_each_study_lie_there_as_csv_and_latex(site: Path, folders: list[Path]) -> None:
    for study, name, method in zip(folders, ("dim-low", "long", "plain"), ("lone", "better", "oracle"), strict=True):
        place = site / "studies" / name
        for table in ("results.csv", "differences.csv"):
            assert (place / table).is_file() == (study / table).is_file()
            assert not (place / table).is_file() or (place / table).read_text() == f"{table} of {study.name}\n"
        told = (place / "ranking.tex").read_text()
        assert told.startswith("\\begin{tabular}{")
        assert method in told
        assert "± is " in told.splitlines()[-1].removeprefix("% ")


def test_a_second_site_replaces_all_files_of_the_first_and_nothing_else(
    folders: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def files() -> set[str]:
        return {file.relative_to(out).as_posix() for file in out.rglob("*") if file.is_file()}

    out, (study, _, experiment) = tmp_path / "site", folders
    monkeypatch.setattr(album, "INSIDE", 0)  # pictures of the reports lie beside them
    write_site([study], out, QUIET)
    before = files()
    assert {"light.csv", "index.files"} <= {Path(file).relative_to("studies/dim-low").parts[0]
                                            for file in before if file.startswith("studies")}  # fmt: skip
    mine = out / "studies" / "dim-low" / "index.files" / "mine.txt"
    mine.write_text("mine")
    write_site([study], out, QUIET)
    write_site([experiment, experiment], out, QUIET)
    assert before & files() == {"index.html", "site.json", "methods/naive.html"}
    assert (out / "studies" / "plain-2" / "index.html").is_file()
    assert mine.read_text() == "mine"


def test_a_site_goes_into_a_folder_of_other_things_only_when_told_to(folders: list[Path], tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match=r"holds thesis\.tex and no site\.json"):
        write_site(folders[2:], tmp_path, QUIET)
    write_site(folders[2:], tmp_path, QUIET, overwrite=True)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"
    assert "<h1>1 study of reconstruction in the dark</h1>" in text(tmp_path / "index.html")


def test_a_record_of_a_site_removes_no_page_outside_of_it(folders: list[Path], tmp_path: Path) -> None:
    out, kept = tmp_path / "site", tmp_path / "kept.txt"
    out.mkdir()
    kept.write_text("kept")
    (out / "old.html").write_text("old")
    (out / "site.json").write_text(json.dumps({"pages": ["../kept.txt", str(kept), "old.html"]}))
    write_site(folders[2:], out, QUIET)
    assert kept.read_text() == "kept"
    assert not (out / "old.html").exists()


def test_a_report_does_not_replace_the_page_of_a_site_on_the_same_run(folders: list[Path], tmp_path: Path) -> None:
    run = folders[2] / "oracle"
    write_site([run], tmp_path, QUIET)
    page = tmp_path / "studies" / "oracle" / "index.html"
    before = page.read_bytes()
    with pytest.raises(ValueError, match="is not a report on these runs: choose another --out"):
        write_reports([run], QUIET, out=page)
    assert page.read_bytes() == before
