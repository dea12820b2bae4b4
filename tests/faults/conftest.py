"""A tiny project on disk, and a process that runs commands on copies of it, each under a fault."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

# The smallest size that every stage takes; checkpoints fall into the middle of the fit.
VARIANT = "tiny=nova-fast:fit.checkpoint_every=10"
SMALL = ["--views", "4", "--width", "24", "--height", "24", "--spp", "4"]
SHORT = ["--points", "60", "--iterations", "20", "--denoiser-steps", "3", "--device", "cpu"]


@dataclass(frozen=True)
class Stage:
    """A command, the folders that it needs, and the one where it writes."""

    command: list[str]
    needs: tuple[str, ...]
    out: str
    later: tuple[str, ...] = ()  # what later stages write there
    before: list[str] | None = None  # a command whose result it replaces


STAGES = {
    "render": Stage(["render", "ball.xml", "--out", "set", "--variant", "scalar", *SMALL], (), "set"),
    "capture": Stage(["capture", "set", "--out", "capture"], ("set",), "capture"),
    "reconstruct": Stage(
        ["reconstruct", "capture", "--out", "run", "--variant", VARIANT, *SHORT], ("set", "capture"), "run",
        later=("metrics.json", ".metrics.json", "report.html"),
    ),
    "score": Stage(["score", "run"], ("set", "capture", "run"), "run", later=("report.html",)),
    "report": Stage(["report", "run"], ("set", "capture", "run"), "run"),
}  # fmt: skip
STAGES["capture again"] = Stage(
    [*STAGES["capture"].command, "--overwrite"],
    ("set",),
    "capture",
    before=[*STAGES["capture"].command, "--electrons", "5"],
)


@dataclass
class Result:
    """How a command ended."""

    code: int
    said: str
    events: list[str] = field(default_factory=list)

    @property
    def line(self) -> str:
        """The last line: what went wrong."""
        return self.said.strip().splitlines()[-1] if self.said.strip() else ""


@dataclass
class Running:
    """A command under way."""

    ask: Callable[[dict[str, Any]], dict[str, Any]]
    process: int
    report: Path

    def wait(self) -> Result:
        """How it ends."""
        return Result(**self.ask({"wait": [self.process, str(self.report)]}))

    def said(self, text: str) -> bool:
        """Whether it has printed this so far."""
        log = self.report.with_suffix(".log")
        return log.exists() and text in log.read_text()

    def stopped(self) -> bool:
        """Whether it waits for SIGCONT."""
        return Path(f"/proc/{self.process}/stat").read_text().rpartition(")")[2].split()[0] == "T"


class Server:
    """Commands in forked children of a process that has loaded everything."""

    def __init__(self, folder: Path, scene: str, warm: list[list[str]]) -> None:
        self.reference, reports = folder / "reference", folder / "reports"
        reports.mkdir(parents=True)
        self.reference.mkdir()
        (self.reference / "ball.xml").write_text(scene)
        root = Path(__file__).resolve().parents[2]
        words = [sys.executable, str(Path(__file__).with_name("server.py")), str(reports), str(self.reference)]
        self.errors = folder / "server.log"
        environment = {**os.environ, "PYTHONPATH": str(root), "OMP_NUM_THREADS": "1", "NOVAGS_TRACEBACK": ""}
        with self.errors.open("w") as errors:
            self.process = subprocess.Popen(
                [*words, json.dumps(warm)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True,
                env=environment,
            )  # fmt: skip
        self._answer()

    def start(self, folder: Path, command: list[str], **request: Any) -> Running:
        process, report = self._ask({"folder": str(folder), "command": command, **request})["process"]
        return Running(self._ask, process, Path(report))

    def run(self, folder: Path, command: list[str], **request: Any) -> Result:
        return self.start(folder, command, **request).wait()

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{json.dumps(request)}\n")
        self.process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, self.errors.read_text()
        return dict(json.loads(line))

    def close(self) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.close()
        self.process.wait(timeout=20)


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory, ball_xml: str) -> Iterator[Server]:
    """The server; its `reference` folder holds set, capture and run, made without interruption."""
    order = ("render", "capture", "reconstruct", "score", "report")
    found = Server(tmp_path_factory.mktemp("faults"), ball_xml, [STAGES[name].command for name in order])
    yield found
    found.close()


@pytest.fixture
def begun(server: Server, tmp_path: Path) -> Callable[..., Path]:
    """Make a folder in which a stage can begin, and what it needs is there."""

    def make(name: str, part: object = "") -> Path:
        stage, folder = STAGES[name], tmp_path / f"{name} {part}"
        folder.mkdir()
        shutil.copy(server.reference / "ball.xml", folder)
        for need in stage.needs:
            # Links: no stage may change what it reads, and what it writes anew gets new files.
            shutil.copytree(server.reference / need, folder / need, copy_function=os.link)
        for later in (*stage.later, *(("metrics.json", ".metrics.json") if name == "score" else ())):
            (folder / stage.out / later).unlink(missing_ok=True)
        if name == "report":
            (folder / "run" / "report.html").unlink()
        if stage.before is not None:
            assert server.run(folder, stage.before).code == 0
        return folder

    return make


@pytest.fixture
def same_as_reference(server: Server, tree: Callable[[Path], dict[str, object]]) -> Callable[[str, Path], list[str]]:
    """Paths at which a stage's folder differs from one that was never interrupted; an empty list if it is the same."""

    def compare(name: str, folder: Path) -> list[str]:
        stage = STAGES[name]
        wanted = tree(server.reference / stage.out)
        for later in stage.later:
            wanted.pop(later)
        found = tree(folder / stage.out)
        return sorted(path for path in wanted.keys() | found.keys() if wanted.get(path) != found.get(path))

    return compare


@pytest.fixture(scope="session")
def tree(without_costs: Callable[[Any], Any]) -> Callable[[Path], dict[str, object]]:
    """A function: every entry of a folder, hidden ones too, with its content but for what it cost."""

    def content(path: Path) -> object:
        if path.is_dir():
            return "a folder"
        if path.suffix == ".json":
            return without_costs(json.loads(path.read_text()))
        if path.suffix == ".html":  # durations and sizes are in its text and in its pictures
            return re.sub(r"\d+(\.\d+)?|base64,[\w+/=]+", "#", path.read_text())
        return path.read_bytes()

    return lambda folder: {path.relative_to(folder).as_posix(): content(path) for path in sorted(folder.rglob("*"))}


@pytest.fixture(scope="session")
def page() -> dict[str, re.Pattern[str]]:
    """What docs/faults.md says that one sees, by fault; "…" stands for anything."""
    found = {}
    for line in (Path(__file__).resolve().parents[2] / "docs" / "faults.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if len(cells) == 4 and (lines := re.findall(r"`([^`]+)`", cells[1])):
            found[cells[0]] = re.compile("|".join(re.escape(text).replace("…", ".*") for text in lines))
    return found


@pytest.fixture(scope="session")
def experiment() -> list[str]:
    """A whole experiment as one command."""
    return ["run", "--scene", "ball.xml", "--out", "all", "--variant", VARIANT, "--methods", "tiny", *SMALL, *SHORT]


@pytest.fixture(scope="session")
def stages() -> dict[str, Stage]:
    return STAGES
