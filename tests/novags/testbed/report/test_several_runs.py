"""Claims about scores and reports of several runs: what is compared with what, and where the page goes."""

import json
import re
import sys
from copy import deepcopy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[4]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from novags.testbed import stages  # noqa: E402
from novags.testbed.console.terminal import Console  # noqa: E402
from novags.testbed.folders.runs import runs_in  # noqa: E402
from novags.testbed.metrics.differences import Estimate  # noqa: E402
from novags.testbed.report.page import report_path, write_reports  # noqa: E402
from novags.testbed.report.place import merged, places_in, title_of  # noqa: E402
from novags.testbed.stages.configs.capturing import CaptureConfig  # noqa: E402
from tests.fuzz.readers.records import make_run  # noqa: E402

QUIET = Console(quiet=True)
PSNR = {("one", "naive"): 20.0, ("one", "oracle"): 30.0, ("two", "naive"): 22.0, ("two", "oracle"): 32.0,
        ("dim", "naive"): 10.0, ("dim", "oracle"): 12.0}  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two experiments on equal captures and one on a darker one, with scores that are made up."""
    folder = tmp_path_factory.mktemp("many")
    for name in ("one", "two", "dim"):
        (folder / name).mkdir()
        make_run(folder / name)
    stages.capture(folder / "dim" / "set", folder / "dim" / "capture", CaptureConfig(electrons=5.0), QUIET,
                   overwrite=True)  # fmt: skip
    from novags.testbed.folders.capture import open_capture

    content = open_capture(folder / "dim" / "capture").content
    for (experiment, method), value in PSNR.items():
        record = folder / experiment / method / "metrics.json"
        found = json.loads(record.read_text())
        mean = found["methods"][method]["mean"]
        found["methods"][method]["views"]["0001"] = deepcopy(found["methods"][method]["views"]["0000"])
        for own in (mean, *found["methods"][method]["views"].values()):
            own["enhanced"]["aligned_psnr"], own["lit"]["tone_aligned_psnr"] = value, value / 2
        record.write_text(json.dumps(found))
        if experiment == "dim":
            run = json.loads((folder / experiment / method / "run.json").read_text())
            run["stage"]["inputs"]["capture"] = content
            (folder / experiment / method / "run.json").write_text(json.dumps(run))
    third = folder / "one" / "naive-l1"
    (folder / "one" / "naive").rename(third)  # a variant, beside the experiments and not named by any
    for name in ("run.json", "metrics.json"):
        text = (third / name).read_text()
        (third / name).write_text(text.replace('"name": "naive"', '"name": "naive-l1"').replace(
            '{"naive": {', '{"naive-l1": {').replace("20.0", "24.5"))  # fmt: skip
    table = (folder / "one" / "results.json").read_text()
    (folder / "one" / "results.json").write_text(table.replace('"naive"', '"naive-l1"'))
    return folder


def test_a_page_on_several_folders_goes_where_all_of_them_lie(tmp_path: Path) -> None:
    assert report_path([tmp_path / "a"]) == tmp_path / "a" / "report.html"
    assert report_path([tmp_path / "b" / "x", tmp_path / "b" / "y"]) == tmp_path / "b" / "comparison.html"
    for folders in ([tmp_path / "x", tmp_path / "b" / "y"], [tmp_path / "b" / "y", tmp_path / "x"]):
        assert report_path(folders) == tmp_path / "comparison.html"


def values(found: dict[str, Estimate]) -> dict[str, float]:
    return {name: estimate.value for name, estimate in found.items()}


def test_runs_of_a_folder_of_experiments_have_names_that_differ(runs: Path) -> None:
    assert list(runs_in([runs])) == ["dim/naive", "dim/oracle", "naive-l1", "one/oracle", "two/naive", "two/oracle"]
    assert list(runs_in([runs / "two", runs / "two" / "naive"])) == ["naive", "oracle"]
    with pytest.raises(ValueError, match="holds no finished run: neither a run.json"):
        runs_in([runs / "one" / "set" / "images"])


@pytest.mark.parametrize(
    ("variety", "title"), [("", "hall, 5 electrons, mine"), ("jpeg", "hall, 5 electrons, jpeg, mine")]
)
def test_the_title_of_a_capture_says_scene_electrons_and_camera(variety: str, title: str) -> None:
    record = SimpleNamespace(simulated=SimpleNamespace(electrons=5.0), variety=variety, sensor_name="mine")
    lit: Any = SimpleNamespace(views=SimpleNamespace(meta={"scene": "hall"}))
    capture: Any = SimpleNamespace(record=record)
    assert title_of(capture, lit) == title


def test_only_runs_of_one_capture_are_compared_and_bounds_are_found_among_them(runs: Path) -> None:
    dim, bright = places_in([runs], QUIET)
    assert list(dim.runs) == ["dim/naive", "dim/oracle"]
    over, base = dim.deltas("enhanced")
    assert (values(over), base) == ({"dim/oracle": 2.0}, "dim/naive")
    # Floor 22, ceiling (30 + 32) / 2.
    assert values(bright.metrics["recovered"]) == {"naive-l1": pytest.approx((24.5 - 22) / 9)}
    over, base = bright.deltas("enhanced")
    assert base == "two/naive"
    assert values(over) == {"naive-l1": 2.5, "one/oracle": 8.0, "two/oracle": 10.0}
    lit, _ = bright.deltas("lit")
    assert lit["two/oracle"].value == pytest.approx(5.0)


def test_a_run_that_is_enhanced_otherwise_has_no_share_of_the_noise_free_exposure(runs: Path) -> None:
    _, bright = places_in([runs], QUIET)
    bright.runs["naive-l1"].record["enhancement"] = {"enhancer": "darker", "config": {}}
    found = merged(bright.runs)
    assert found["recovered"] == {}
    assert found["recovered_lit"].keys() == {"naive-l1"}
    assert values(bright.deltas("enhanced")[0]) == {"one/oracle": 8.0, "two/oracle": 10.0}


def test_without_a_floor_differences_are_to_the_first_run_and_nothing_is_recovered(runs: Path) -> None:
    (group,) = places_in([runs / "one"], QUIET)
    over, base = group.deltas("enhanced")
    assert (values(over), base) == ({"oracle": 5.5}, "naive-l1")
    assert group.metrics["recovered"] == {}
    assert "needs the method(s) naive:" in group.metrics["unavailable"]["recovered"]


def test_a_report_on_several_captures_compares_runs_of_each_and_replaces_nothing_else(runs: Path) -> None:
    path = write_reports([runs / "two", runs / "dim"], QUIET)
    assert path == runs / "comparison.html"
    page = path.read_text()
    table = page[page.index('data-name="combinations"') :].partition("</table>")[0]
    assert len(set(re.findall(r'data-of="([^"]+)"', table))) == 2
    assert page.count("+10.00") == 1
    assert page.count("+2.00") == 1
    # these runs state settings of an enhancement that this version does not have: all pictures but those through it
    assert "Pictures that cannot be shown" not in page
    assert 'alt="Rendered by two/naive' in page
    assert page.count("<dt>enhancer guided</dt>") == 1
    assert "run it again" in page
    write_reports([runs / "dim", runs / "two"], QUIET)  # the same request
    before = path.read_bytes()
    with pytest.raises(ValueError, match="is not a report on these runs: choose another --out, or add --overwrite"):
        write_reports([runs / "one", runs / "dim"], QUIET)
    assert path.read_bytes() == before
    write_reports([runs / "one", runs / "dim"], QUIET, overwrite=True)
    assert "+5.50" in path.read_text()


def test_a_run_that_is_not_scored_is_named(runs: Path, tmp_path: Path) -> None:
    import shutil

    shutil.copytree(runs / "two", tmp_path / "two")
    (tmp_path / "two" / "naive" / "metrics.json").unlink()
    with pytest.raises(ValueError, match=r"two/naive is not scored: run novags score"):
        write_reports([tmp_path / "two", runs / "dim"], QUIET)
