"""A made report of three runs, and a browser to look at it with."""

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[4]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from novags.methods.variant import Variant  # noqa: E402
from novags.testbed import stages  # noqa: E402
from novags.testbed.console.terminal import Console  # noqa: E402
from novags.testbed.folders.capture import Capture, open_capture  # noqa: E402
from novags.testbed.ledger.contents import jsonable  # noqa: E402
from novags.testbed.report.page import write_report  # noqa: E402
from novags.testbed.stages.configs.capturing import CaptureConfig  # noqa: E402
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted  # noqa: E402
from tests.fuzz.readers.records import STAGE, make_run, make_set  # noqa: E402

QUIET = Console(quiet=True)
PSNR = {"naive": 20.25, "better": 23.75, "oracle": 30.5}
VIEW = {"0000": 1.0, "0001": -0.5}  # added to the mean score of a view


@pytest.fixture(scope="session")
def psnr() -> dict[str, float]:
    """The aligned PSNR of each run of the made report; of view 0000 1 more, of 0001 0.5 less."""
    return PSNR


@pytest.fixture(scope="session")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three runs of a real capture of noise, with scores that are made up; `better` is a variant."""
    folder = tmp_path_factory.mktemp("page")
    make_run(folder)
    facts = json.loads((folder / "set" / "set.json").read_text())
    del facts["camera_matrix"]  # light in linear sRGB, as of most sets
    (folder / "set" / "set.json").write_text(json.dumps(facts))
    stages.capture(folder / "set", folder / "capture", CaptureConfig(electrons=200.0), QUIET, overwrite=True)
    captured = open_capture(folder / "capture")
    inputs = {"capture": captured.content, "set": captured.record.simulated.set_content}
    shutil.copytree(folder / "naive", folder / "better")
    better = Variant(name="better", method="naive", settings={"fit.dssim_weight": "0.1"})
    preset = adapted(EXPERIMENTS["demo"], variants=(better,))
    known = {
        name: json.loads((folder / name / "metrics.json").read_text())["methods"][name] for name in ("naive", "oracle")
    }
    for name, value in PSNR.items():
        asked = jsonable(preset.reconstruct(name).resolved())
        run = json.loads((folder / name / "run.json").read_text()) | {"name": name, "config": asked["config"]}
        run["stage"]["config"], run["enhancement"]["config"] = asked, {}
        run["stage"]["inputs"] = inputs
        (folder / name / "run.json").write_text(json.dumps(run))
        scores = json.loads(json.dumps(known.get(name, known["naive"])))
        for kind in ("enhanced", "lit"):
            scores["mean"][kind] |= {"aligned_psnr": value, "tone_aligned_psnr": value / 2, "flip": value / 100}
        scores["views"] = {view: {kind: scores["mean"][kind] | {"aligned_psnr": value + off}
                                  for kind in ("enhanced", "lit")} for view, off in VIEW.items()}  # fmt: skip
        scores["noise"] = {"known": 0.0625, "targets": 1.0, "renders": value / 100, "bias_floor": 31.257}
        (folder / name / "metrics.json").write_text(
            json.dumps({"methods": {name: scores}, "unavailable": {"lpips": "not installed"}, "stage": STAGE})
        )
        events = [{"iteration": k, "photometric": 2.0**-k * value} for k in range(1, 6)]
        (folder / name / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    rows = [{"run": run, "method": name, "state": "done", "folder": name} for run, name in enumerate(PSNR, 1)]
    (folder / "results.json").write_text(json.dumps({"axes": {"method": list(PSNR)}, "rows": rows}))
    (folder / "experiment.json").write_text(json.dumps({"command": "novags run", "preset": {}}))
    write_report(folder, QUIET)
    return folder


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    found = shutil.which("chromium")
    if found is None:
        # Playwright cannot download one everywhere, and a user of the library needs none. What the pages contain is
        # tested without a browser beside this.
        pytest.skip("no chromium on this machine (Debian: apt-get install chromium)")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (scripts/setup dev)")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=found, args=["--no-sandbox", "--disable-gpu"])
        yield opened
        opened.close()


@pytest.fixture
def visit(browser: Any) -> Iterator[Callable[..., Any]]:
    """Open a page; anything that it complains of, or asks the network for, fails the test."""
    contexts, complaints = [], list[str]()

    def complain(said: Any, lost: bool) -> None:
        if said.type in ("error", "warning") and not (lost and "ERR_FILE_NOT_FOUND" in said.text):
            complaints.append(said.text)

    def go(page: Path, link: str = "", *, width: int = 1300, theme: str = "light", lost: bool = False) -> Any:
        context = browser.new_context(
            viewport={"width": width, "height": 900}, color_scheme=theme, has_touch=width < 500
        )
        contexts.append(context)
        tab = context.new_page()
        tab.on("console", lambda said: complain(said, lost))
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.on("request", lambda asked: None if asked.url.startswith(("file:", "data:", "blob:"))
               else complaints.append(asked.url))  # fmt: skip
        tab.goto(page.as_uri() + link)
        return tab

    yield go
    for context in contexts:
        context.close()
    assert complaints == []


@pytest.fixture(scope="session")
def captures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Capture]:
    """Of a set through colour filters of its own: three chips, and a Bayer mosaic."""
    folder = tmp_path_factory.mktemp("captures")
    (folder / "set").mkdir()
    make_set(folder / "set")
    found = {}
    for name, sensor in (("chips", "a7s2-iso6400-3chip"), ("mosaic", "a7s2-iso6400")):
        stages.capture(folder / "set", folder / name, CaptureConfig(sensor=sensor, electrons=60.0), QUIET)
        found[name] = open_capture(folder / name)
    return found
