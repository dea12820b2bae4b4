"""Claims about --dry-run: every command that makes something says what it would do, and writes nothing."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature
from pathlib import Path

import pytest

from novags.cli import COMMANDS, main
from tests.fuzz.commands import world

SMALL = ("--views", "4", "--width", "24", "--height", "24", "--spp", "4")
SHORT = ("--points", "60", "--iterations", "5", "--device", "cpu")


def whole(folder: Path) -> dict[str, tuple[int, ...]]:
    """All that is there, and when it was written last: a folder, when something in it came or went."""
    found = {path: path.lstat() for path in (folder, *folder.rglob("*"))}
    return {
        str(path): (of.st_ino, of.st_mode, of.st_size, of.st_mtime_ns, of.st_ctime_ns) for path, of in found.items()
    }


def test_every_stage_can_be_asked_before_it_is_done(
    tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    ball_xml: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("ball.xml").write_text(ball_xml)
    lines = (
        ("render", "ball.xml", "--out", "set", "--variant", "scalar", *SMALL),
        ("capture", "set", "--out", "capture"),
        ("reconstruct", "capture", "--method", "naive", "--out", "run", *SHORT),
        ("score", "run"),
        ("denoise", "capture", "--out", "clean", "--no-adapt", "--turns", "1"),
    )
    for words in lines:
        for expected in ("to be made in", "unchanged, kept"):
            before = whole(tmp_path)
            assert call(*words, "--dry-run") == 0
            said = capsys.readouterr()
            assert expected in said.err
            assert "next:" not in said.err
            assert whole(tmp_path) == before
            assert call(*words) == 0
            capsys.readouterr()
        assert whole(tmp_path).keys() >= before.keys()


def test_a_run_says_of_every_part_what_it_would_do(
    tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    ball_xml: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("ball.xml").write_text(ball_xml)
    words = ("run", "--scene", "ball.xml", "--out", "all", "--methods", "naive", *SMALL, *SHORT)
    assert call(*words, "--dry-run") == 0
    said = capsys.readouterr().err
    parts = ["render", "capture", "naive", "score naive", "run", "run", "run", "run", "run"]
    assert [line.split(":")[0] for line in said.splitlines()] == parts
    assert not Path("all").exists()
    assert call(*words) == 0
    capsys.readouterr()
    before = whole(tmp_path)
    assert call(*words[:7], "oracle", *words[7:], "--dry-run") == 0
    said = capsys.readouterr().err
    assert said.count("unchanged, kept") == 4  # the score too
    assert "reconstruct oracle: to be made in all/oracle" in said
    assert "score oracle: to be made (dry run" in said
    assert "run: to be made again in all: report.html is there" in said
    assert call("score", "all", "--dry-run") == 0
    said = capsys.readouterr().err
    assert "score: unchanged, kept all/naive" in said
    assert "score: to be made again in all: results.json is there" in said
    assert whole(tmp_path) == before


DONE = "(dry run: nothing is done)"
# What makes the project that all lines work on.
MADE = (
    ("render", "ball.xml", "--out", "set", "--variant", "scalar", *SMALL),
    ("capture", "set", "--out", "capture"),
    ("reconstruct", "capture", "--out", "exp/naive", "--method", "naive", *SHORT),
    ("score", "exp"),
)


@dataclass(frozen=True)
class Line:
    """A command line that makes something.

    Attributes:
        words: Of it.
        says: What its dry run says, line by line.
        again: What it says once all is made, with --overwrite; None: it is not done here.
    """

    words: tuple[str, ...]
    says: tuple[str, ...]
    again: tuple[str, ...] | None = None


def made(*files: str, by: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is said of files that are not there, and of those that are."""
    places = [(str(Path(file).parent), Path(file).name) for file in files]
    return (
        tuple(f"{by}: to be made in {folder}: {name} {DONE}" for folder, name in places),
        tuple(f"{by}: to be made again in {folder}: {name} is there {DONE}" for folder, name in places),
    )


TOLD = re.compile(r"to be made (?:again )?in (.*?): (.*?)(?: is there)? \(dry run")
LINES = (
    Line((*MADE[0], "--export", "blender"), *made("set/blender", by="export")),
    Line((*MADE[1], "--export", "llff"), *made("capture/llff", by="export")),
    Line((*MADE[2], "--export", "splat", "spz"),
         *made("exp/naive/viewers/scene.splat", "exp/naive/viewers/scene.spz", by="viewers")),
    Line(("reconstruct", "capture", "--out", "new", "--method", "naive", *SHORT, "--export", "splat"),
         (f"reconstruct naive: to be made in new {DONE}", f"viewers: to be made in new/viewers: scene.splat {DONE}")),
    Line(("poses", "photos", "--out", "new"), (f"poses: to be made in new {DONE}",)),
    Line(("import", "own/dark", "--out", "new"), (f"import: to be made in new {DONE}",)),
    Line(("denoise", "capture", "--out", "new"), (f"denoise: to be made in new {DONE}",)),
    Line(("run", "--scene", "set", "--out", "new", "--methods", "naive", *SHORT),
         (f"capture: to be made in new/capture {DONE}", f"naive: to be made {DONE}", f"score naive: to be made {DONE}",
          *made("new/experiment.json", "new/results.csv", "new/results.json", "new/report.html", by="run")[0])),
    Line(("run", "--scene", "set", "--out", "new", "--methods", "naive", "--points", "60", "--budget", "60s"),
         ("budget 60 s: the experiment to be tried on a small scale, for 6 s at most", "iterations 2400 -> ",
          f"run: naive to be made, scored and reported with these settings {DONE}",
          *made("new/budget.json", by="budget")[0])),
    Line(("study", "study.toml", "--out", "new"), ("1 runs",)),
    Line(("dataset", "data.toml", "--out", "new"), ("1 capture",)),
    Line(("store", "prune", "store", "study.toml"), ("would remove 0 entries",)),
    Line(("score", "exp"), ("score: unchanged, kept exp/naive",)),
    Line(("site", "exp", "--out", "pages"),
         *made("pages/index.html", "pages/index.files", "pages/studies", "pages/methods", "pages/scenes",
               "pages/site.json", by="site")),
    Line(("score", "--renders", "renders", "--set", "set", "--out", "new/scores.json"),
         *made("new/scores.json", by="score")),
    Line(("explain", "exp/naive", "--swaps", "noise"),
         ("explain: 1 runs to make", *made("exp/naive/explain/explain.json", by="explain")[0])),
    Line(("verify", "exp", "--out", "new"),
         ("verify: naive in ", *made("new/verify.json", by="verify")[0])),
    Line(("compare", "naive", "naive-l1", "--captures", "capture", "--seeds", "0", "--out", "new", *SHORT),
         ("compare: 1 pairs of fits",
          *made("new/base", "new/changed", "new/logs", "new/compare.json", "new/compare.csv", by="compare")[0])),
    Line(("report", "exp/naive"), *made("exp/naive/report.html", by="report")),
    Line(("report", "exp", "set/../exp", "--out", "new/all.html"), *made("new/all.html", by="report")),
    Line(("report", "light"), *made("light/report.html", "light/light.csv", by="report")),
    Line(("video", "exp/naive", "--out", "exp/film.mp4", "--seconds", "0.2", "--fps", "10"),
         *made("exp/film.mp4", by="video")),
    Line(("export-results", "exp", "--out", "new/nb"),
         *made("new/nb/results.json", "new/nb/naive/ball-a7s2-iso6400-3chip-20e-s0/predictions", by="export-results")),
    Line(("pareto", "sensor", "--out", "new/p", "--quick", "--repeats", "1", "--knobs", "light", "precision"),
         (f"pareto sensor: light: 2 measurements to be made, 0 kept {DONE}",
          f"pareto sensor: precision: 2 measurements to be made, 0 kept {DONE}",
          *made("new/p/curves.jsonl", "new/p/sensor.svg", "new/p/sensor.md", by="pareto")[0]),
         ("pareto sensor: light: unchanged, kept 2 measurements",
          *made("new/p/curves.jsonl", "new/p/sensor.svg", "new/p/sensor.md", by="pareto")[1])),
    Line(("characterise", "frames", "--out", "new/camera.toml", "--window", "8"),
         *made("new/camera.toml", by="characterise")),
)  # fmt: skip
MAKES_NOTHING = {
    "list": "prints what there is",
    "help": "prints a page",
    "plan": "prints what would be simulated",
    "view": "shows runs until it is stopped",
    "doctor": "prints what works here",
    "new": "writes one small file, and none over another",
    "compare-sets": "prints a verdict; writes one small file where one is asked for, and none over another",
}


def test_every_command_has_a_dry_run_or_makes_nothing() -> None:
    able = {name for name, command in COMMANDS.items() if "dry_run" in signature(command).parameters}
    assert able == COMMANDS.keys() - MAKES_NOTHING.keys()
    assert MAKES_NOTHING.keys() <= COMMANDS.keys()
    assert {line.words[0] for line in LINES} | {words[0] for words in MADE} == able


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory, ball_xml: str) -> Path:
    """Scene, set, capture, run, photographs, frames, and a study over light that refers to the run."""
    folder = tmp_path_factory.mktemp("project")
    world.write_inputs(folder)
    (folder / "ball.xml").write_text(ball_xml)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for words in MADE:
            patch.setattr(sys, "argv", ["novags", *words])
            patch.setattr("signal.signal", lambda *_: None)  # pytest keeps its own handlers
            main()
    rows = [
        {
            "run": run,
            "scene": "a",
            "electrons": electrons,
            "method": "naive",
            "seed": 0,
            "state": "done",
            "folder": "../exp/naive",
            "enhanced.aligned_psnr": 20.0 + run,
        }
        for run, electrons in ((1, 5), (2, 50))
    ]
    axes = {"scene": ["a"], "electrons": [5, 50], "method": ["naive"], "seed": [0]}
    (folder / "light").mkdir()
    (folder / "light" / "results.json").write_text(json.dumps({"axes": axes, "columns": [], "rows": rows}))
    (folder / "light" / "study.json").write_text(json.dumps({"file": "light.toml", "table": {"grid": axes}}))
    (folder / "store" / "set").mkdir(parents=True)
    for left in ("exp/.film.%d.partial.mp4", "exp/naive/.report.%d.partial.html", "light/.light.%d.partial.csv"):
        (folder / (left % 2**30)).touch()  # of a process that was killed; no process has this number
    return folder


@pytest.fixture
def place(project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the project, where commands run."""
    folder = tmp_path / "project"
    shutil.copytree(project, folder)
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize("line", LINES, ids=lambda line: " ".join(line.words[:3]))
def test_a_dry_run_says_what_would_be_made_and_touches_nothing(
    line: Line, place: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    for words, says in ((line.words, line.says), ((*line.words, "--overwrite"), line.again)):
        if says is None:
            continue
        before = whole(place)
        capsys.readouterr()
        assert call(*words, "--dry-run") == 0
        said = "".join(capsys.readouterr())
        for text in says:
            assert text in said
        assert "next:" not in said
        assert whole(place) == before
        if line.again is not None:
            assert call(*words) == 0
            told = {place / Path(*found) for found in TOLD.findall(said)}
            came = {Path(path) for path in whole(place).keys() - before.keys() if Path(path).is_file()}
            assert all(path.exists() for path in told)
            assert all(told & {path, *path.parents} for path in came if place / "new" / "store" not in path.parents)


@pytest.mark.parametrize("words", [("list",), ("help", "scores"), ("plan", "set", "--sensor", "ideal", "--electrons",
                                                                   "20")], ids=lambda words: words[0])  # fmt: skip
def test_what_has_no_dry_run_makes_nothing(words: tuple[str, ...], place: Path, call: Callable[..., int]) -> None:
    before = whole(place)
    assert call(*words) == 0
    assert whole(place) == before


@pytest.mark.parametrize("words", [
    ("video", "set"),
    ("video", "exp/naive", "--out", "film.txt"),
    ("video", "exp/naive", "--out", "there.mp4"),
    ("video", "exp/naive", "--out", "ball.xml/film.mp4"),
    ("video", "exp/naive", "--out", "ball.xml/deeper/film.mp4"),
    ("video", "exp/naive", "--seconds", "0"),
    ("compare", "naive", "nonsense"),
    ("compare", "naive", "photos"),
    ("compare", "naive", "oracle", "--captures", "photos", "--out", "new"),
    ("compare", "naive", "oracle", "--captures", "capture", "--methods", "nerf", "--out", "new"),
    ("export-results", "set", "--out", "new"),
    ("export-results", "exp", "--out", "light"),
    ("export-results", "exp", "--out", "new", "--reference", "nothing"),
    ("report", "set"),
    ("report", "exp/naive", "--out", "ball.xml"),
    ("report", "light", "--out", "ball.xml"),
    ("score", "--renders", "photos", "--set", "set", "--out", "new.json"),
    ("score", "--renders", "renders", "--set", "set", "--out", "ball.xml"),
    ("score", "--renders", "renders", "--set", "set", "--reference", "clean", "--out", "new.json"),
    ("pareto", "nonsense", "--out", "new"),
    ("pareto", "sensor", "--out", "new", "--knobs", "nonsense"),
    ("pareto", "sensor", "--out", "ball.xml"),
    ("characterise", "set", "--out", "new.toml"),
    ("characterise", "frames", "--window", "8", "--out", "ball.xml"),
    ("run", "--scene", "set", "--budget", "60s", "--out", "new", "--curves", "set"),
    ("run", "--scene", "set", "--budget", "soon", "--out", "new"),
    ("run", "--scene", "set", "--budget", "60s", "--out", "ball.xml"),
    ("run", "--scene", "set", "--budget", "60s", "--out", "new", "--variant", "set=naive:fit.iterations=3",
     "--methods", "set"),
    ("run", "--scene", "set", "--out", "new", "--variant", "set=naive:fit.iterations=3", "--methods", "set"),
    ("reconstruct", "capture", "--out", "exp/naive", "--method", "averaging", "--export", "splat"),
], ids=" ".join)  # fmt: skip
def test_a_dry_run_refuses_what_the_command_refuses_in_the_same_words(
    words: tuple[str, ...], place: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("there.mp4").touch()
    before = whole(place)
    code = call(*words, "--dry-run")
    said = capsys.readouterr().err.splitlines()[-1]
    assert code in (1, 2)
    assert whole(place) == before
    assert (call(*words), capsys.readouterr().err.splitlines()[-1]) == (code, said)


def test_a_dry_run_beside_a_process_that_writes_is_refused_and_leaves_its_lock(
    place: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    code = "from sensor_model.files.lock import locked\nwith locked('exp/naive'): print(flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        before = whole(place)
        assert call("report", "exp/naive", "--dry-run") == 1
        assert "exp/naive is in use by" in capsys.readouterr().err
        assert whole(place) == before
        holder.communicate(b"\n")
