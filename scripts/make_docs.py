"""Run the commands that the pages in docs/ show, and write their output into the pages.

    python scripts/make_docs.py [PAGE ...] [--cheap]      (all pages, if none is named)

A command stands in a block of the language `console`, on a line that begins with "$ "; the lines below it are its
output. The blocks of a page run in their order in one empty folder, with `novags` and `python` of this checkout.
A comment in front of a block says more: `<!-- cheap -->`: takes a few seconds, always prints the same, and a test
compares it; `<!-- first=8 -->`: only so many lines are kept; `<!-- stop -->`: a server, which is interrupted once it
has printed its address; `<!-- exit=2 -->`: it must fail with this code.

`<!-- file NAME -->` before a block: the page's block of code with that title is written to a file of that name first.

docs/gallery.md is made with a picture of every scene that has none yet; if there is one, docs/scenes.png is made again.
The table of docs/stability.md comes from a run of the tests that hold its cases to their bounds; not with --cheap.
The tables of docs/accuracy-and-time.md show the curves that novags ships.
"""

import argparse
import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
CASES = DOCS / "tables" / "stability" / "cases.csv"
CURVES = DOCS / "tables" / "accuracy-and-time"
BLOCK = re.compile(
    r"(?:^<!-- (?P<wishes>(?:cheap|stop|first=\d+|exit=\d+)(?: \S+)*) -->\n+)?^```console\n(?P<body>.*?)^```$",
    re.M | re.S,
)
WIDTH = 110  # columns
LIMIT = 1800  # s


@dataclass(frozen=True)
class Wishes:
    """What the comment in front of a block says."""

    cheap: bool = False
    stop: bool = False
    first: int | None = None
    exit: int = 0

    @staticmethod
    def of(text: str | None) -> "Wishes":
        """The wishes in the words of a comment."""
        words = dict(word.partition("=")[::2] for word in (text or "").split())
        return Wishes(
            "cheap" in words, "stop" in words, int(words["first"]) if "first" in words else None,
            int(words.get("exit", 0)),
        )  # fmt: skip


def printed(command: str, folder: Path, wishes: Wishes) -> str:
    """What a command prints on standard output and error, without paths of this machine.

    Raises:
        RuntimeError: If it ends with another code than is said.
    """
    words = shlex.split(command)
    if words[0] in ("novags", "python"):
        words[:1] = [sys.executable, *(["-m", "novags"] if words[0] == "novags" else [])]
    environment = {**os.environ, "COLUMNS": str(WIDTH), "PYTHONPATH": str(ROOT), "NO_COLOR": "1"}
    lines = []
    with subprocess.Popen(
        words, cwd=folder, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as process:
        for line in process.stdout or ():
            lines.append(line)
            if wishes.stop and "http://" in line:
                time.sleep(1)  # it says more than its address
                process.send_signal(signal.SIGINT)
        code = process.wait(LIMIT)
    text = portable("".join(lines), folder.resolve())
    if code != wishes.exit:
        raise RuntimeError(f"{command} ended with {code}:\n{text}")
    return text


def portable(text: str, folder: Path) -> str:
    """An output without the places of the working folder, of this checkout and of its virtual environment."""
    for place in (folder, ROOT, Path(sys.prefix).parent):
        text = text.replace(f"file://{place}/", "file://.../").replace(f"{place}/", "")
    return text


def shortened(text: str, first: int | None) -> str:
    """The first lines of an output, without what a line ends with; "..." stands for the others."""
    lines = [line.rstrip() for line in text.rstrip().splitlines()]
    return "\n".join(lines if first is None or len(lines) <= first else [*lines[:first], "..."])


def with_outputs(page: str, folder: Path, failed: list[str] | None = None, *, cheap_only: bool = False) -> str:
    """A page with its blocks run in `folder`; one that fails does not change, and joins `failed` if that is given."""

    def run(found: re.Match[str]) -> str:
        wishes = Wishes.of(found["wishes"])
        if cheap_only and not wishes.cheap:
            return found[0]
        body = ""
        for line in found["body"].splitlines():
            if line.startswith("$ "):
                try:
                    said = shortened(printed(line[2:], folder, wishes), wishes.first)
                except RuntimeError as error:
                    if failed is None:
                        raise
                    failed.append(str(error))
                    return found[0]
                body += f"{line}\n{said}\n" if said else f"{line}\n"
        return found[0].replace(found["body"], body)

    return BLOCK.sub(run, page)


def made(page: str, failed: list[str] | None = None, *, cheap_only: bool = False) -> str:
    """A page as it should be, of its text."""
    with tempfile.TemporaryDirectory(prefix="novags-docs-") as folder:
        for name in re.findall(r"^<!-- file (\S+) -->$", page, re.M):
            content = re.search(rf'^```\w+ title="{re.escape(name)}"\n(.*?)^```$', page, re.M | re.S)
            if content is None:
                raise ValueError(f"no block of code has the title {name}")
            (Path(folder) / name).write_text(content[1], encoding="utf-8")
        return with_outputs(page, Path(folder), failed, cheap_only=cheap_only)


def hard_cases() -> bool:
    """Run the tests of the hard cases, which write their errors into their table; whether all hold."""
    words = ["tests/stability", "-m", "slow or not slow", "-k", "within_its_bound", "--hard-cases", str(CASES)]
    return subprocess.run([sys.executable, "-m", "pytest", *words], cwd=ROOT).returncode == 0


def with_curves(page: str) -> str:
    """A page with the sizes of the curves that novags ships; their settings go to tables."""
    sys.path[:0] = [str(ROOT), str(ROOT / "scripts" / "choices")]
    from tables import write_csv

    from novags.testbed.report.curves.page import embedded
    from novags.testbed.report.curves.table import joined
    from novags.testbed.study.budget.known import SHIPPED
    from novags.testbed.study.curves.curve import read_curves

    points = read_curves(SHIPPED)
    for name in dict.fromkeys(point["knob"].partition(".")[0] for point in points):
        own = [point for point in points if point["knob"].startswith(f"{name}.")]
        write_csv(CURVES / f"{name}.csv", joined(own))
    return embedded(page, points)


def scene_pictures() -> bool:
    """Write the list of scenes, and pictures of new ones (minutes: the sheet has all); whether that succeeds."""
    before = sorted((DOCS / "gallery").iterdir())
    with tempfile.TemporaryDirectory(prefix="novags-docs-") as work:

        def made_by(script: str, *words: str) -> bool:
            line = [sys.executable, ROOT / "scripts" / script, "--work", work, *words]
            environment = {**os.environ, "PYTHONPATH": str(ROOT)}
            return subprocess.run(line, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL).returncode == 0

        done = made_by("pictures/make_gallery.py", "--missing")
        if done and sorted((DOCS / "gallery").iterdir()) != before:
            done = made_by("pictures/make_scene_thumbnails.py")
    return done


def main() -> None:
    """Write the pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pages", nargs="*", type=Path, default=sorted(DOCS.glob("*.md")))
    parser.add_argument("--cheap", action="store_true", help="only what the test compares")
    args = parser.parse_args()
    failed: list[str] = []
    for page in args.pages:
        if page.name == "stability.md" and not args.cheap and not hard_cases():
            failed.append(f"{page}: a hard case fails")
        before = page.read_text(encoding="utf-8")
        if page.name == "gallery.md" and not scene_pictures():
            failed.append(f"{page}: a picture could not be made")
        text = made(page.read_text(encoding="utf-8"), failed, cheap_only=args.cheap)
        if page.name == "accuracy-and-time.md":
            text = with_curves(text)
        if text != before:
            page.write_text(text, encoding="utf-8")
            print(page.relative_to(ROOT) if page.is_relative_to(ROOT) else page, flush=True)
    if failed:
        raise SystemExit("\n".join(failed))


if __name__ == "__main__":
    main()
