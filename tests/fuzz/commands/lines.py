"""The command lines that are run on the project, and what each of them reads."""

from __future__ import annotations

import shlex
from dataclasses import dataclass

from tests.fuzz.commands.world import SHORT, SMALL

SMALL_, SHORT_ = shlex.join(SMALL), shlex.join(SHORT)


@dataclass(frozen=True)
class Line:
    """A command line.

    Attributes:
        name: In the table.
        words: What is typed behind `novags`.
        reads: Patterns of files that it reads.
        weight: Of its share of the cases; less for the slow ones.
        code: How it ends on the valid project: what has no features has no poses.
    """

    name: str
    words: tuple[str, ...]
    reads: tuple[str, ...]
    weight: float = 1.0
    code: int = 0


def _line(name: str, words: str, reads: str, weight: float = 1.0, code: int = 0) -> Line:
    return Line(name, tuple(shlex.split(words)), tuple(reads.split()), weight, code)


LINES = {line.name: line for line in (
    _line("list", "list", "", 0.3),
    _line("help", "help electrons", "", 0.3),
    _line("score", "score exp", "exp/* capture/* set/*", 3),
    _line("score --renders", "score --renders renders --set set --out scores.json", "renders/* set/*", 2),
    _line("score --renders, capture",
          "score --renders renders --set capture --reference clean --out scores.json", "renders/* capture/* set/*"),
    _line("report", "report exp --overwrite", "exp/* capture/* set/*", 3),
    _line("report of a study", "report study/light", "study/*", 2),
    _line("view", "view exp", "exp/* capture/* set/*", 2),
    _line("video", "video exp/naive --out film.mp4 --seconds 0.2 --fps 10", "exp/naive/* capture/* set/*", 2),
    _line("export-results", "export-results exp study/light --out exported", "exp/* study/* capture/* set/*", 2),
    _line("plan", "plan set --sensor camera.toml --electrons 20", "camera.toml set/*", 1),
    _line("render", f"render scene.xml --out new {SMALL_}", "scene.xml t.png m.ply", 1.5),
    _line("render again", f"render scene.xml --out set {SMALL_}", "scene.xml t.png m.ply set/*", 1.5),
    _line("poses", "poses photos --out new --max-size 64", "photos/*", 1, code=2),
    _line("poses of a film", "poses film/walk.avi --out new --max-size 64", "film/*", 1, code=2),
    _line("import", "import own/dark --out new --lit own/lit --clean own/long --demosaic bilinear",
          "own/*", 2),
    _line("capture", "capture set --out new --sensor camera.toml", "set/* camera.toml", 2),
    _line("capture again", "capture set --out capture --electrons 200", "set/* capture/*", 1),
    _line("capture of photographs", "capture posed --out new --demosaic bilinear", "posed/*", 2),
    _line("denoise", "denoise capture --out new --no-adapt --turns 1 --device cpu", "capture/* set/*", 1),
    _line("reconstruct", f"reconstruct capture --out new --variant variants.toml {SHORT_}",
          "capture/* set/* variants.toml", 2),
    _line("reconstruct again", f"reconstruct capture --out exp/naive --method naive {SHORT_}",
          "capture/* set/* exp/naive/*", 1),
    _line("run", "run --scene set --out new --methods naive --iterations 3 --points 60 --device cpu",
          "set/*", 1),
    _line("study --dry-run", "study study.toml --out study/light --dry-run", "study.toml scene.xml study/*", 2),
    _line("study", "study study.toml --out study/light --workers 1", "study.toml scene.xml study/*", 0.7),
    _line("dataset --dry-run", "dataset data.toml --out made --dry-run", "data.toml scene.xml study/store/*", 2),
    _line("characterise", "characterise frames --out found.toml --window 8", "frames/*", 2),
)}  # fmt: skip
