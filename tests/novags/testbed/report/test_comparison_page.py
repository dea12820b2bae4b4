"""Claims about the page on runs of several captures: its tables, and the pictures of each capture."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.ledger.dry import dry_run
from novags.testbed.report.material import titles
from novags.testbed.report.page import write_reports
from novags.testbed.stages.configs.capturing import CaptureConfig
from simscenes.sets.pictures.exr import read_exr
from simscenes.sets.pictures.png import read_png

QUIET = Console(quiet=True)


@pytest.fixture(scope="module")
def comparison(experiment: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page on the runs of the made report and on the same runs, as if they were made from a darker capture."""
    folder = tmp_path_factory.mktemp("comparison")
    for name in ("first", "second"):
        shutil.copytree(experiment, folder / name)
    stages.capture(folder / "second" / "set", folder / "second" / "capture", CaptureConfig(electrons=50.0), QUIET,
                   overwrite=True)  # fmt: skip
    captured = open_capture(folder / "second" / "capture")
    for name in ("naive", "better", "oracle"):
        run = json.loads((folder / "second" / name / "run.json").read_text())
        run["stage"]["inputs"]["capture"] = captured.content
        (folder / "second" / name / "run.json").write_text(json.dumps(run))
    return write_reports([folder / "first", folder / "second"], QUIET)


def test_the_commands_of_runs_of_one_name_write_to_different_folders(comparison: Path) -> None:
    places = re.findall(r'data-command="[^"]* --out ([^ ]+) &amp;', comparison.read_text(encoding="utf-8"))
    assert sorted(places) == sorted(
        f"{folder}-{name}-again" for folder in ("first", "second") for name in ("naive", "better", "oracle")
    )


def test_a_dry_run_names_the_page_and_leaves_it(comparison: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, before = comparison.parent, comparison.stat()
    (folder / "comparison.files").mkdir()
    with dry_run():
        write_reports([folder / "first", folder / "second"], Console())
    (folder / "comparison.files").rmdir()
    said = f"report: to be made again in {folder}: comparison.{{0}} is there (dry run: nothing is done)\n"
    assert capsys.readouterr().err == said.format("html") + said.format("files")
    assert comparison.stat() == before


def shown(tab: Any, *ids: str) -> list[str]:
    found: list[str] = tab.evaluate("ids => ids.map(id => novags.byId(id).selectedOptions[0].textContent)", list(ids))
    return found


def test_every_capture_has_views_with_the_pictures_of_its_own_runs(visit: Callable[..., Any], comparison: Path) -> None:
    tab = visit(comparison)
    views = tab.locator("#view option").all_text_contents()
    assert [view.partition(" electrons")[0].rpartition(" ")[2] for view in views] == ["200", "50"]
    for place, name in enumerate(("first", "second")):
        tab.locator("#view").select_option(index=place)
        keys = tab.eval_on_selector_all(".grid.shown figure", "figures => figures.map(figure => figure.dataset.key)")
        for run in ("naive", "better", "oracle"):
            kinds = {key.partition("-")[0] for key in keys if key.endswith(f"-{name}/{run}")}
            assert kinds == {"render", "error", "depth", "normal"}
        codes = tab.evaluate("""() => {
            const image = document.querySelector(".grid.shown figure[data-key='dark'] img");
            const canvas = Object.assign(document.createElement("canvas"), { width: 32, height: 24 });
            const context = canvas.getContext("2d");
            context.drawImage(image, 0, 0);
            return [...context.getImageData(0, 0, 32, 24).data];
        }""")
        dark = read_png(comparison.parent / name / "capture" / "images" / "0000.png")
        assert (np.array(codes).reshape(24, 32, 4)[..., :3] == np.round(255 * dark)).all()


def test_long_names_of_folders_make_no_page_wider_than_a_phone(visit: Callable[..., Any], comparison: Path) -> None:
    tab = visit(comparison, width=390)
    tab.evaluate("document.querySelectorAll('h1, h2, figcaption strong').forEach(e => e.append('x'.repeat(90)))")
    assert tab.evaluate("document.documentElement.scrollWidth") == 390


@pytest.mark.parametrize("width", [390, 1300])
def test_pictures_of_captures_are_compared_zoomed_and_probed(
    visit: Callable[..., Any], comparison: Path, width: int
) -> None:
    tab = visit(comparison, width=width)
    assert tab.evaluate("document.documentElement.scrollWidth") == width
    table = tab.locator('table[data-name="combinations"]')
    table.locator("tbody tr", has_text="second/oracle").locator("th").click()
    assert shown(tab, "right") == ["second/oracle"]
    assert shown(tab, "view")[0].startswith("50 electrons")
    tab.locator("#slider").fill("25")
    assert tab.evaluate("getComputedStyle(novags.byId('left-layer')).clipPath").split()[1] == "75%"
    tab.locator("#in").click()
    assert tab.evaluate("novags.stage.zoom") == 2
    tab.evaluate("novags.stage.probe({x: 10.5 / 32, y: 7.5 / 24}, true)")
    tab.wait_for_function("document.querySelectorAll('#probe tbody tr').length > 8")
    truth, _ = read_exr(comparison.parent / "second" / "capture" / "truth" / "0000.exr")
    found = tab.locator("#probe tbody tr", has_text="True mean, DN").locator("td").evaluate_all(
        "cells => cells.map(cell => +cell.dataset.value)")  # fmt: skip
    assert found == pytest.approx([truth[f"mean.{c}"][7, 10] for c in "RGB"], rel=1e-3)
    tab.wait_for_function("location.hash === `#${novags.state.values}`")
    again = visit(comparison, tab.evaluate("location.hash"), width=width)
    assert shown(again, "view", "right") == shown(tab, "view", "right")
    table.locator("td.num").nth(1).click()
    assert tab.get_by_role("button", name="Show its pictures").count() == 1


def test_captures_of_the_same_title_are_told_apart_by_their_folders() -> None:
    groups: Any = [SimpleNamespace(title=title, capture=SimpleNamespace(path=Path(path)))
                   for title, path in (("a", "/x/one/capture"), ("b", "/x/two"), ("a", "/x/three"))]  # fmt: skip
    assert titles(groups, Path("/x")) == ["a (one/capture)", "b", "a (three)"]
