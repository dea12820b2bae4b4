"""Would the tests notice? Puts plausible mistakes into the sources, one at a time, and runs the tests that reach them.

    python scripts/mutation_check.py --count 240

A mistake that no test fails on survived: either a test is missing, or the mistake changes nothing that a user could
see; those are excused, with the reason, in `mutation/excused.toml`. Every group of tests runs once on the unchanged
sources, to learn how long each test takes and which lines it reaches. Verdicts are kept in the folder `--out` and
reused as long as they hold: see `mutation/record.py`.
"""

import argparse
import contextlib
import importlib
import json
import math
import os
import random
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

from mutation.baseline import tests_reaching
from mutation.judge import Job, baseline, verdicts
from mutation.mutants import Mutant, mutants
from mutation.record import code_of_test, earlier, fingerprint, holds, keys

ROOT = Path(__file__).resolve().parents[1]
EXCUSED = Path(__file__).parent / "mutation" / "excused.toml"
# Sources, and the tests that answer for them.
GROUPS = (
    (("novags/methods/enhancers/[!_]*.py", "novags/methods/enhancers/networks/[!_]*.py"),
     ("tests/novags/methods/enhancers/test_[!r]*.py", "tests/novags/methods/enhancers/networks/test_*.py")),
    (("novags/methods/nova/[!t]*.py",), ("tests/novags/methods/nova/test_[!t]*.py",)),
    (("novags/methods/nova/trainer.py", "novags/methods/enhancers/__init__.py", "novags/methods/enhanced/*.py",
      "novags/methods/*.py"),
     ("tests/novags/methods/test_*.py", "tests/novags/methods/enhancers/test_r*.py",
      "tests/novags/methods/nova/test_trainer*.py")),
    (tuple(f"novags/splats/training/{what}.py"
           for what in ("losses", "updates/mcmc", "fit", "iteration", "config", "direct")),
     tuple(f"tests/novags/splats/training/test_{what}.py" for what in ("losses", "mcmc", "fit*", "direct"))),
    (("sensor_model/effects.py", "sensor_model/moments.py", "sensor_model/radiometry.py", "sensor_model/isp.py"),
     tuple(f"tests/sensor_model/test_{what}*.py"
           for what in ("effects", "moments", "radiometry", "isp", "capture", "planner"))
     + ("tests/sensor_model/frame/test_streams.py", "tests/sensor_model/fast/test_stated_errors.py")),
    (("simscenes/rigs.py",), ("tests/simscenes/test_rigs*.py",)),
    (("simscenes/job/*.py", "simscenes/transport/*.py"),
     tuple(f"tests/simscenes/{what}.py"
           for what in ("job/test_*", "transport/test_*", "render/test_geometry", "render/test_passes",
                        "render/test_lens*", "scenes/test_hardness", "loading/test_scene_digest"))),
)  # fmt: skip
# Imported once, before the forks. Nothing of ours, and nothing that starts threads, which a fork would lose.
LIBRARIES = ("torch", "numba", "scipy.stats", "scipy.optimize", "scipy.ndimage", "hypothesis", "safetensors.torch",
             "cv2", "torchmetrics", "skimage.metrics", "colour_demosaicing")  # fmt: skip


def matching(patterns: tuple[str, ...]) -> list[str]:
    """Files under the root that match, relative to it."""
    found = [path for pattern in patterns for path in sorted(ROOT.glob(pattern))]
    return list(dict.fromkeys(str(path.relative_to(ROOT)) for path in found))


def test_text(tests: list[str]) -> str:
    """Tests and their fixtures."""
    files = {ROOT / test for test in tests}
    above = {folder for file in files for folder in file.parents if folder.is_relative_to(ROOT)}
    files |= {folder / "conftest.py" for folder in above if (folder / "conftest.py").is_file()}
    return "\0".join(path.read_text(encoding="utf-8") for path in sorted(files))


def in_turn(candidates: list[Mutant], rng: random.Random) -> list[Mutant]:
    """An order whose every beginning is spread over kinds of mistakes and, within a kind, over functions."""
    queues: dict[str, dict[str, list[Mutant]]] = defaultdict(lambda: defaultdict(list))
    for mutant in rng.sample(candidates, len(candidates)):
        queues[mutant.kind][mutant.function].append(mutant)
    kinds = [_round_robin(list(functions.values())) for functions in queues.values()]
    return _round_robin(rng.sample(kinds, len(kinds)))


def _round_robin(lists: list[list[Mutant]]) -> list[Mutant]:
    longest = max(map(len, lists), default=0)
    return [items[i] for i in range(longest) for items in lists if i < len(items)]


def shares(sizes: dict[str, int], count: int) -> dict[str, int]:
    """How many of `count` mutants each file gets: as the square root of its candidates, rounded up."""
    roots = {name: size**0.5 for name, size in sizes.items() if size}
    total = sum(roots.values())
    return {name: min(sizes[name], math.ceil(count * root / total)) for name, root in roots.items()}


def chosen(only: str, count: int, seed: int) -> dict[str, list[Mutant]]:
    """The mutants to judge, by file."""
    names = [name for patterns, _ in GROUPS for name in matching(patterns) if re.search(only, name)]
    found = {name: mutants((ROOT / name).read_text(encoding="utf-8")) for name in names}
    parts = shares({name: len(all_of) for name, all_of in found.items()}, count)
    # A string seeds Python's generator the same way everywhere.
    return {name: in_turn(found[name], random.Random(f"{seed} {name}"))[:part] for name, part in parts.items()}


def reach(sources: list[str], tests: list[str], out: Path) -> dict[str, Any]:
    """What every test reaches and how long it takes, from one run of each test file on the unchanged sources."""
    texts = [(ROOT / name).read_text(encoding="utf-8") for name in sources]
    known: dict[str, Any] = {"seconds": {}, "lines": {}}
    for test in tests:
        name = fingerprint(*sources, *texts, test, test_text([test]))
        found = baseline(ROOT, sources, test, out / f"baseline-{Path(test).stem}-{name}.json")
        known["seconds"] |= found["seconds"]
        for source, lines in found["lines"].items():
            known["lines"].setdefault(source, {}).update(lines)
    return known


def jobs(wanted: dict[str, list[Mutant]], known: dict[str, dict[str, Any]], options: Any) -> Iterator[Job | dict]:
    """Every chosen mutant: its earlier verdict if that still holds, else a job with the tests that reach it."""
    for patterns, test_patterns in GROUPS:
        sources, tests = matching(patterns), [name for name in matching(test_patterns) if "/test_" in name]
        about, reached = fingerprint(test_text(tests)), None
        for name in (name for name in sources if name in wanted):
            source = (ROOT / name).read_text(encoding="utf-8")
            named = keys(name, source, mutants(source))
            for mutant in wanted[name]:
                entry = known.get(named[mutant])
                if entry is not None and holds(entry, ROOT, about):
                    yield entry | {"line": mutant.line}
                    continue
                reached = reached or reach(sources, tests, options.out)
                seconds: dict[str, float] = reached["seconds"]
                asked = [test for test in tests_reaching(reached, name, mutant) if seconds[test] <= options.longest]
                limit = 60 + 5 * sum(seconds[test] for test in asked)
                yield Job(file=name, mutant=mutant, key=named[mutant], about=about, tests=tuple(asked), limit=limit)


def reason(entry: dict[str, Any], excuses: list[dict[str, str]]) -> str | None:
    """Why a survivor changes nothing that matters, if somebody wrote that down."""
    line = (ROOT / entry["file"]).read_text(encoding="utf-8").splitlines()[entry["line"] - 1]
    for excuse in excuses:
        fits = excuse["file"] == entry["file"] and excuse["line"] in line
        if fits and excuse.get("before", entry["before"]) == entry["before"] and excuse["after"] == entry["after"]:
            return excuse["reason"]
    return None


def summary(entries: list[dict[str, Any]], excuses: list[dict[str, str]]) -> str:
    """A table of counts per file and a list of survivors, in Markdown."""
    rows = ["| file | mutants | caught | excused | survived |", "|---|---|---|---|---|"]
    survivors, totals = [], [0, 0, 0, 0]
    for file in sorted({entry["file"] for entry in entries}):
        own = [entry for entry in entries if entry["file"] == file and entry["verdict"] != "broken"]
        left = [(entry, reason(entry, excuses)) for entry in own if entry["verdict"] == "survived"]
        excused = sum(why is not None for _, why in left)
        counts = [len(own), len(own) - len(left), excused, len(left) - excused]
        totals = [a + b for a, b in zip(totals, counts, strict=True)]
        rows.append(f"| `{file}` | {' | '.join(map(str, counts))} |")
        survivors += [_line(entry, why) for entry, why in left]
    share = totals[1] / max(1, totals[0])
    rows.append(f"| all | {' | '.join(map(str, totals))} |")
    return "\n".join([*rows, "", f"Caught: {share:.1%}.", "", *survivors])


def _line(entry: dict[str, Any], why: str | None) -> str:
    before, after = (" ".join(entry[name].split()) for name in ("before", "after"))
    note = why or entry["by"] or "to be caught"
    return f"- `{entry['file']}:{entry['line']}` ({entry['kind']}): `{before}` becomes `{after}`: {note}"


def main() -> None:
    """Choose, judge, tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="regular expression that the file name must contain")
    parser.add_argument("--count", type=int, default=240, help="mutants over all chosen files")
    parser.add_argument("--seed", type=int, default=0, help="of the choice; a larger count extends a smaller one")
    parser.add_argument("--jobs", type=int, default=2, help="mutants at a time")
    parser.add_argument("--longest", type=float, default=10.0, help="seconds of a test; longer ones are not asked")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "mutation", help="folder of verdicts")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"  # one mutant, one core
    for library in LIBRARIES:
        with contextlib.suppress(ImportError):  # an extra may be absent; the tests that need it are skipped then
            importlib.import_module(library)
    path = options.out / "verdicts.jsonl"
    wanted = list(jobs(chosen(options.only, options.count, options.seed), earlier(path), options))
    entries = [one for one in wanted if isinstance(one, dict)]
    with path.open("a", encoding="utf-8") as file:
        for found in verdicts(ROOT, [one for one in wanted if isinstance(one, Job)], options.jobs):
            entry = found | {"by_code": code_of_test(ROOT, found["by"])}
            entries.append(entry)
            print(json.dumps(entry), file=file, flush=True)
            print(f"{len(entries)}/{len(wanted)} {entry['verdict']:8} {_line(entry, None)}", flush=True)
    excuses = tomllib.loads(EXCUSED.read_text(encoding="utf-8")).get("excused", [])
    text = summary(entries, excuses)
    (options.out / "summary.md").write_text(text + "\n", encoding="utf-8")
    print(f"\n{text}")


if __name__ == "__main__":
    main()
