"""Does the ledger make exactly the changed results again? Edits one number of the sources, and makes a small study
again.

    nice -n 10 python scripts/edits/check_edits.py --edits 200 --seed 0 --out build/edits

Each edit is made in a copy of the sources. Where a result reaches its file, the study is made in a copy of the store
that the unedited sources have filled. A result that a stage begins to make was *made again*. A result whose bytes
differ from before, costs, dates and versions aside, has *changed*. Where a stage fails, its result and all that is made
from it are lost: they count as changed, and as made again, since nothing old is given for them. Where the file is out
of reach, nothing is made again, without a look.

A kept result has its old bytes by that alone. So a random share of all edits (--fresh), out of reach or not, also makes
the study in an empty store: a result that was kept and comes out with other bytes there is *missed*, and must not
occur. What fails there alone gives no other bytes; it is told.

One line of JSON an edit goes to OUT/edits.jsonl at once; the same command goes on after it was stopped, with the
sources that it began with (OUT/whole). --report shows the results so far.
"""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))  # so that it is found where this file is loaded by its path

from constants import PACKAGES, Edit, drawn
from results import Made, read_made

ROOT = Path(__file__).resolve().parents[2]
STUDY = """
[grid]
scene = ["cornell"]
method = ["naive", "nova-fast", "denoise-little", "nerf"]

[override]
views = 9
width = 24
height = 24
spp = 4
points = 300
iterations = 20
denoiser_steps = 5
device = "cpu"

[variant.denoise-little]
method = "denoise-gs"
denoise.adapt.steps = 10
"""
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR")


@dataclass(frozen=True)
class Place:
    """The folder of a check.

    Attributes:
        out: Of it.
        limit: Seconds that one making may take.
    """

    out: Path
    limit: float

    @property
    def whole(self) -> Path:
        """A copy of the unedited sources."""
        return self.out / "whole"

    @property
    def sources(self) -> Path:
        """The copy that is edited."""
        return self.out / "sources"

    @property
    def base(self) -> Path:
        """The store that the unedited sources have filled."""
        return self.out / "base"

    def made(self, store: Path | None) -> Made:
        """Make the missing results of the study in a copy of a store, or in an empty one."""
        work = self.out / "work"
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        if store is not None:
            shutil.copytree(store, work / "store")
        (work / "study.toml").write_text(STUDY)
        program = [sys.executable, str(Path(__file__).with_name("making.py")), str(self.sources), "study.toml", "store",
                   "said"]  # fmt: skip
        cache = self.out / "cache"  # of compiled kernels too: an edit elsewhere must not compile them again
        environment = {**os.environ, **{f"{name}_NUM_THREADS": "1" for name in THREADS},
                       "XDG_CACHE_HOME": str(cache), "NUMBA_CACHE_DIR": str(cache / "numba")}  # fmt: skip
        environment.pop("PYTHONPATH", None)
        with (work / "log").open("wb") as log:
            process = subprocess.Popen(program, cwd=work, env=environment, stdout=log, stderr=log,
                                       start_new_session=True)  # fmt: skip
            try:
                code: int | None = process.wait(self.limit)
            except subprocess.TimeoutExpired:
                code = None
            finally:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)  # with the processes that it started
                    process.wait()
        return read_made(work / "said", work, code)


def prepare(place: Place) -> dict[str, Any]:
    """Copy the sources and make the study with them, once; returns the bytes and the files of every result."""
    known = place.out / "base.json"
    if not known.exists():
        shutil.rmtree(place.whole, ignore_errors=True)
        for package in PACKAGES:
            shutil.copytree(ROOT / package, place.whole / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.rmtree(place.sources, ignore_errors=True)  # who was killed has left its edit there
    shutil.copytree(place.whole, place.sources)
    if not known.exists():
        first, again = place.made(None), place.made(None)
        if first.failed or first.bytes != again.bytes:
            raise SystemExit(f"the study fails, or differs from one time to the next: {first.failed or again.failed}")
        shutil.rmtree(place.base, ignore_errors=True)
        shutil.copytree(place.out / "work" / "store", place.base)
        known.write_text(json.dumps({"bytes": again.bytes, "files": again.files}))
    found: dict[str, Any] = json.loads(known.read_text())
    return found


def checked(edit: Edit, place: Place, base: dict[str, Any], fresh: bool) -> dict[str, Any]:
    """What an edit does."""
    start = time.perf_counter()
    reach = any(edit.file in files for files in base["files"].values())
    file, found = place.sources / edit.file, {"reach": reach, "made": [], "changed": [], "failed": ""}
    content, times = file.read_bytes(), file.stat()
    before: dict[str, str] = base["bytes"]
    try:
        file.write_bytes(edit.applied(content))
        if reach or fresh:
            made = place.made(place.base)
            lost = before.keys() - made.bytes.keys()
            differ = {name for name, known in made.bytes.items() if known != before[name]}
            found |= {"made": sorted(made.begun | lost), "changed": sorted(differ | lost), "failed": made.failed}
        if fresh:
            anew = place.made(None)
            differ = {name for name, known in anew.bytes.items() if known != before[name]}
            found |= {"fresh": {"changed": sorted(differ), "failed": anew.failed}}
    finally:
        file.write_bytes(content)
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))  # numba believes its cache by it
    return {**asdict(edit), **found, "seconds": round(time.perf_counter() - start, 1)}


def summary(lines: Sequence[dict[str, Any]], results: Sequence[str]) -> str:
    """What all edits did, in words and tables."""
    whole = [line for line in lines if not line["failed"]]
    fresh = [line for line in lines if "fresh" in line]
    missed = {_place(line): found for line in lines if (found := _missed(line))}
    broken = [line for line in fresh if line["fresh"]["failed"] and not line["failed"]]
    said = [
        f"{len(lines)} edits, {sum(line['reach'] for line in lines)} in reach of a result, "
        f"{sum(bool(line['changed']) for line in lines)} change bytes, {len(lines) - len(whole)} make the program fail",
        f"all edits: {_ratio(lines)}",
        f"without failing ones: {_ratio(whole)}",
        f"made in an empty store as well: {len(fresh)} edits, {sum(not line['reach'] for line in fresh)} of them out "
        f"of reach; missed: {sum(map(len, missed.values()))} results of {len(missed)} edits; failed there alone: "
        f"{len(broken)}",
        *(f"  MISSED {place}: {', '.join(found)}" for place, found in missed.items()),
        *(f"  failed there alone {_place(line)}: {line['fresh']['failed'][:120]}" for line in broken),
        "",
        "| result | made again | changed |",
        "| --- | --- | --- |",
        *(f"| {name} | {_count(lines, 'made', name)} | {_count(lines, 'changed', name)} |" for name in results),
        "",
        "| module | edits | made again | changed | made again and unchanged |",
        "| --- | --- | --- | --- | --- |",
        *_modules(lines),
    ]
    return "\n".join(said)


def _ratio(lines: Sequence[dict[str, Any]]) -> str:
    made, changed = (sum(len(line[what]) for line in lines) for what in ("made", "changed"))
    return f"{made} results made again, {changed} changed, ratio {made / max(1, changed):.2f}"


def _missed(line: dict[str, Any]) -> list[str]:
    """The results that an edit changes, in the store that was there or in an empty one, and that were kept."""
    changed = {*line["changed"], *line.get("fresh", {}).get("changed", ())}
    return sorted(changed - set(line["made"]))


def _place(line: dict[str, Any]) -> str:
    return f"{line['file']}:{line['line']} {line['before']} -> {line['after']}"


def _count(lines: Sequence[dict[str, Any]], what: str, name: str) -> int:
    return sum(name in line[what] for line in lines)


def _modules(lines: Sequence[dict[str, Any]], most: int = 10) -> list[str]:
    """The modules whose edits made most again that did not change."""
    edits, made, changed = Counter[str](), Counter[str](), Counter[str]()
    for line in lines:
        edits[line["file"]] += 1
        made[line["file"]] += len(line["made"])
        changed[line["file"]] += len(line["changed"])
    first = (made - changed).most_common(most)
    return [f"| `{file}` | {edits[file]} | {made[file]} | {changed[file]} | {left} |" for file, left in first]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--edits", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the choice; more edits begin with the same ones")
    parser.add_argument("--fresh", type=float, default=0.1, help="share of edits that also make the study anew")
    parser.add_argument("--limit", type=float, default=1800, help="seconds that one making may take")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "edits")
    parser.add_argument("--report", action="store_true", help="only show the results so far")
    options = parser.parse_args()
    place = Place(options.out.absolute(), options.limit)
    place.out.mkdir(parents=True, exist_ok=True)
    path = place.out / "edits.jsonl"
    base = prepare(place)
    known = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    known = [line for line in known if line["seed"] == options.seed]
    for number, edit in enumerate(drawn(place.sources, options.edits, options.seed)):
        if options.report or any(line["edit"] == number for line in known):
            continue
        fresh = random.Random(f"fresh {options.seed} {number}").random() < options.fresh
        line = {"edit": number, "seed": options.seed, **checked(edit, place, base, fresh)}
        known.append(line)
        with path.open("a") as file:
            file.write(json.dumps(line) + "\n")
        told = f"{len(line['made'])} made again, {len(line['changed'])} changed ({line['seconds']} s)"
        print(f"{number + 1}/{options.edits} {_place(line)}: {told} {line['failed'][:100]}".rstrip(), flush=True)
    print(summary(known, list(base["bytes"])))


if __name__ == "__main__":
    main()
