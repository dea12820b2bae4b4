"""The two sides of a comparison: sources and a method each, whose fits are made by a process of their own."""

import io
import os
import subprocess
import tarfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from novags.methods import chosen, with_variants
from novags.methods.variant import Variant
from novags.testbed.folders.run import RECORD
from novags.testbed.ledger.contents import UNFINISHED, read_json, write_json
from sensor_model.files import outside
from sensor_model.files.atomic import remove, write_text
from sensor_model.files.door import resolved
from sensor_model.files.python import ROOT, import_path, python
from sensor_model.files.reading import brief

PACKAGES = ("novags", "simscenes", "sensor_model")
SPENT = {"key": str, "cpu_seconds": float}
# The clock starts once libraries and kernels are loaded: a changed kernel is compiled once on a machine.
# Where this project is installed to be edited, a finder of setuptools would give modules that a side has not.
PROGRAM = """sys.path[:] = {path!r}
sys.meta_path[:] = [finder for finder in sys.meta_path
                    if "novags" not in getattr(sys.modules.get(getattr(finder, "__module__", "")), "MAPPING", ())]
from novags.process import settle
settle()
import time
import novags.cli, novags.testbed.stages.reconstructing
from novags.warm import PARTS, compile_ahead
for part in ("gaussians", "fields"):
    compile_ahead(part, print)
    PARTS[part].warm()
sys.argv[0] = "novags"
before = time.process_time()
novags.cli.main()
print(time.process_time() - before)
"""


@dataclass(frozen=True)
class Side:
    """One side.

    Attributes:
        role: "base" or "changed".
        said: How it was named.
        root: The folder with its sources.
        method: That it is; None: a checkout, which runs the methods that are asked for.
        commit: Of a revision, whose sources `lay_out` brings there.
    """

    role: str
    said: str
    root: Path
    method: str | None = None
    commit: str | None = None

    def lay_out(self) -> None:
        """Bring the sources of a revision to their folder, unless they are there.

        Raises:
            ValueError: If it lacks some.
        """
        if self.commit is None or self.root.exists():
            return
        if (packed := _git("archive", "--format=tar", self.commit, *PACKAGES)) is None:
            raise ValueError(f"the revision {self.said} lacks one of {', '.join(PACKAGES)}: name a later one")
        unfinished = self.root.with_suffix(".part")
        remove(unfinished)
        with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
            archive.extractall(unfinished, filter="data")
        unfinished.rename(self.root)

    def fit(self, words: Sequence[str], out: Path, log: Path) -> float | None:
        """Let the sources of this side make the run `out` by `novags reconstruct` with these words, unless it is there.

        Returns:
            Processor seconds that the fit took, imports not counted; None where it was made in several goes.

        Raises:
            ValueError: If it fails; with the last line of its log.
        """
        before = (out / RECORD).stat().st_mtime_ns if (out / RECORD).exists() else None
        whole, kept = not (out / UNFINISHED).exists(), log.with_suffix(".json")
        path = [str(self.root), *(folder for folder in import_path() if folder != ROOT)]
        plugins = [word for file in outside.files() for word in ("--plugin", str(file.absolute()))]
        command = python(PROGRAM.format(path=path), "reconstruct", *words, "--out",
                         str(out.absolute()), *plugins)  # fmt: skip
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        write_text(log, said := done.stdout.decode("utf-8", "replace"))
        lines = said.strip().splitlines() or ["no message"]
        if done.returncode:
            raise ValueError(
                f"{self.role} ({self.said}): {brief(lines[-1].removeprefix('novags: error: '))} (log: {log})"
            )
        key = read_json(out / RECORD)["stage"]["key"]
        if (out / RECORD).stat().st_mtime_ns != before and whole:
            write_json(kept, {"key": key, "cpu_seconds": float(lines[-1])})
        known = read_json(kept, SPENT) if kept.exists() else {}
        return float(known["cpu_seconds"]) if known.get("key") == key else None


def sides_of(base: str, changed: str, variants: Sequence[Variant], code: Path) -> tuple[Side, Side]:
    """The sides by these names: folders of checkouts, methods or variants, or revisions of this checkout.

    Args:
        base: The name of one.
        changed: Of the other.
        variants: The caller's own.
        code: Where the sources of a revision go.

    Raises:
        ValueError: If a name means nothing, or they are of two kinds.
    """
    one, other = (_side(role, said, variants, code) for role, said in (("base", base), ("changed", changed)))
    if (one.method is None) != (other.method is None):
        sources, method = (one, other) if one.method is None else (other, one)
        raise ValueError(f"{sources.said} is a checkout and {method.said} a method: compare two checkouts, which run "
                         f"--methods {method.said}, or two methods")  # fmt: skip
    return one, other


def _side(role: str, said: str, variants: Sequence[Variant], code: Path) -> Side:
    if os.path.isdir(said):
        if missing := [name for name in PACKAGES if not Path(said, name, "__init__.py").is_file()]:
            raise ValueError(f"the folder {said} is no checkout of novags, because {', '.join(missing)} are not in it: "
                             f"name the one that holds {', '.join(PACKAGES)}")  # fmt: skip
        return Side(role, said, resolved(Path(said)))
    try:
        chosen(said, with_variants(tuple(variants)))
        return Side(role, said, Path(ROOT), said)
    except ValueError as error:
        if (commit := _git("rev-parse", "--verify", "--quiet", "--end-of-options", f"{said}^{{commit}}")) is None:
            raise ValueError(f"{brief(repr(said), 100)} is no folder, no revision of {ROOT}, and no method: "
                             f"{brief(error)}") from error  # fmt: skip
    name = commit.decode().strip()
    return Side(role, said, resolved(code) / name, commit=name)


def _git(*words: str) -> bytes | None:
    """The output of git on this checkout; None where it fails, or is not there."""
    try:
        done = subprocess.run(["git", "-C", ROOT, *words], stdin=subprocess.DEVNULL, capture_output=True)
    except OSError:
        return None
    return None if done.returncode else done.stdout
