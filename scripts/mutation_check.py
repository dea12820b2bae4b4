"""Would the tests notice? Puts plausible mistakes into the sources, one at a time, and runs the tests that reach them.

    python scripts/mutation_check.py --count 240
    python scripts/mutation_check.py --careless --count 300 --seed 7

The first command draws mistakes of all kinds in the files of `GROUPS`, whose tests are named there. The second draws
the careless ones (`mutation/careless.py`) all over the product, and asks the nearest tests alone
(`mutation/nearest.py`). With `--beside LIST` none is drawn that an earlier list names.

A mistake that no test fails on survived: either a test is missing, or the mistake changes nothing that a user could
see; those are excused, with the reason, in `mutation/excused.toml`. Every group of tests runs once on the unchanged
sources, to learn how long each test takes and which functions it enters. Verdicts are kept in the folder `--out` and
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
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

from mutation.baseline import tests_reaching
from mutation.careless import CARELESS
from mutation.judge import Job, baseline, is_compiled, verdicts
from mutation.listing import difference, listed, listing
from mutation.mutants import Mutant, mutants
from mutation.nearest import nearest
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
     ("tests/novags/methods/test_*.py", "tests/novags/methods/enhanced/test_*.py",
      "tests/novags/methods/enhancers/test_r*.py", "tests/novags/methods/nova/test_trainer*.py")),
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
PRODUCT = ("novags/**/*.py", "sensor_model/**/*.py", "simscenes/**/*.py")
Placed = tuple[str, Mutant]  # file, mistake in it
Group = tuple[list[str], list[str]]  # sources, and the tests that answer for them
# Imported once, before the forks. Nothing of ours, and nothing that starts threads, which a fork would lose.
LIBRARIES = ("torch", "numba", "scipy.stats", "scipy.optimize", "scipy.ndimage", "hypothesis", "safetensors.torch",
             "cv2", "torchmetrics", "skimage.metrics", "colour")  # fmt: skip


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


def in_turn(candidates: list[Placed], rng: random.Random) -> list[Placed]:
    """An order whose every beginning is spread over kinds of mistakes and, within a kind, over functions."""
    queues: dict[str, dict[tuple[str, str], list[Placed]]] = defaultdict(lambda: defaultdict(list))
    for name, mutant in rng.sample(candidates, len(candidates)):
        queues[mutant.kind][name, mutant.function].append((name, mutant))
    kinds = [_round_robin(list(functions.values())) for functions in queues.values()]
    return _round_robin(rng.sample(kinds, len(kinds)))


def _round_robin(lists: list[list[Placed]]) -> list[Placed]:
    longest = max(map(len, lists), default=0)
    return [items[i] for i in range(longest) for items in lists if i < len(items)]


def shares(sizes: dict[str, int], count: int) -> dict[str, int]:
    """How many of `count` mutants each file gets: as the square root of its candidates, rounded up."""
    roots = {name: size**0.5 for name, size in sizes.items() if size}
    total = sum(roots.values())
    return {name: min(sizes[name], math.ceil(count * root / total)) for name, root in roots.items()}


def groups(careless: bool) -> list[Group]:
    """Sources with the tests that answer for them: those of `GROUPS`, or every source with its nearest tests."""
    if careless:
        return [([name], list(nearest(ROOT, name))) for name in matching(PRODUCT)]
    named = [(matching(sources), matching(tests)) for sources, tests in GROUPS]
    return [(sources, [test for test in tests if "/test_" in test]) for sources, tests in named]


def _left(name: str, every: Iterable[Mutant], before: Counter[tuple[str, str, str]]) -> Iterator[Mutant]:
    """The mutants of a file that no list names. Of several that read alike the first ones count as named: a list does
    not tell them apart.
    """
    for mutant in every:
        text = (name, *difference(mutant.before, mutant.after)) if before else None
        if text is not None and before[text] > 0:
            before[text] -= 1
        else:
            yield mutant


def chosen(options: Any) -> list[Placed]:
    """The mutants to judge: of all kinds, shared out among the files; of chosen kinds, as many of each kind."""
    names = [name for sources, _ in groups(bool(options.kinds)) for name in sources if re.search(options.only, name)]
    before = Counter[tuple[str, str, str]]()
    for path in options.beside:
        before += listed(path.read_text(encoding="utf-8"))
    found = {name: list(_left(name, mutants((ROOT / name).read_text(encoding="utf-8")), before)) for name in names}
    placed = {name: [(name, mutant) for mutant in every] for name, every in found.items()}
    if options.kinds:
        candidates = [one for every in placed.values() for one in every if one[1].kind in options.kinds]
        return in_turn(candidates, random.Random(f"{options.seed}"))[: options.count]
    parts = shares({name: len(every) for name, every in found.items()}, options.count)
    # A string seeds Python's generator the same way everywhere.
    orders = {name: in_turn(placed[name], random.Random(f"{options.seed} {name}")) for name in parts}
    return [one for name, part in parts.items() for one in orders[name][:part]]


def reach(watched: dict[str, list[str]], tests: list[str], options: Any) -> dict[str, Any]:
    """What every test reaches and how long it takes, from one run of each test file on the unchanged sources.

    Args:
        watched: The sources that each test file answers for.
        tests: Test files.
        options: The command's: where the findings are kept, and how long a test may take.
    """
    known: dict[str, Any] = {"seconds": {}, "lines": {}}
    for test in tests:
        texts = [(ROOT / name).read_text(encoding="utf-8") for name in watched[test]]
        name = fingerprint(*watched[test], *texts, test, test_text([test]), str(options.longest))
        path = options.out / f"baseline-{Path(test).stem}-{name}.json"
        found = baseline(ROOT, watched[test], test, path, options.longest)
        known["seconds"] |= found["seconds"]
        for source, lines in found["lines"].items():
            known["lines"].setdefault(source, {}).update(lines)
    return known


def jobs(wanted: list[Placed], known: dict[str, dict[str, Any]], options: Any) -> Iterator[Job | dict[str, Any]]:
    """Every chosen mutant: its earlier verdict if that still holds, else a job with the tests that reach it."""
    own: dict[str, list[Mutant]] = defaultdict(list)
    for name, mutant in wanted:
        own[name].append(mutant)
    every = groups(bool(options.kinds))
    watched: dict[str, list[str]] = defaultdict(list)
    for sources, tests in every:
        for test in tests:
            watched[test] += sources
    for sources, tests in every:
        about, reached = fingerprint(test_text(tests)), None
        for name in (name for name in sources if name in own):
            source = (ROOT / name).read_text(encoding="utf-8")
            named = keys(name, source, mutants(source))
            for mutant in own[name]:
                entry = known.get(named[mutant])
                if entry is not None and holds(entry, ROOT, about):
                    yield entry | {"line": mutant.line}
                    continue
                reached = reached or reach(watched, tests, options)
                seconds: dict[str, float] = reached["seconds"]
                asked = tests_reaching(reached, name, mutant, everywhere=is_compiled(source))
                asked = [test for test in asked if seconds[test] <= options.longest]
                limit = 120 + 15 * sum(seconds[test] for test in asked)
                yield Job(file=name, mutant=mutant, key=named[mutant], about=about, tests=tuple(asked), limit=limit)


def reason(entry: dict[str, Any], excuses: list[dict[str, str]]) -> str | None:
    """Why a survivor changes nothing that matters, if somebody wrote that down."""
    line = (ROOT / entry["file"]).read_text(encoding="utf-8").splitlines()[entry["line"] - 1]
    for excuse in excuses:
        fits = excuse["file"] == entry["file"] and excuse["line"] in line
        if fits and excuse.get("before", entry["before"]) == entry["before"] and excuse["after"] == entry["after"]:
            return excuse["reason"]
    return None


def summary(entries: list[dict[str, Any]], excuses: list[dict[str, str]], by: str = "file") -> str:
    """A table of counts per file or kind and a list of survivors, in Markdown."""
    rows = [f"| {by} | mutants | caught | excused | survived |", "|---|---|---|---|---|"]
    survivors, totals = [], [0, 0, 0, 0]
    for part in sorted({entry[by] for entry in entries}):
        own = [entry for entry in entries if entry[by] == part and entry["verdict"] != "broken"]
        left = [(entry, reason(entry, excuses)) for entry in own if entry["verdict"] == "survived"]
        excused = sum(why is not None for _, why in left)
        counts = [len(own), len(own) - len(left), excused, len(left) - excused]
        totals = [a + b for a, b in zip(totals, counts, strict=True)]
        rows.append(f"| `{part}` | {' | '.join(map(str, counts))} |")
        survivors += [_line(entry, why) for entry, why in left]
    share = totals[1] / max(1, totals[0])
    rows.append(f"| all | {' | '.join(map(str, totals))} |")
    return "\n".join([*rows, "", f"Caught: {share:.1%}.", "", *survivors])


def _line(entry: dict[str, Any], why: str | None) -> str:
    before, after = (" ".join(entry[name].split()) for name in ("before", "after"))
    note = why or entry["by"] or "to be caught"
    return f"- `{entry['file']}:{entry['line']}` ({entry['kind']}): `{before}` becomes `{after}`: {note}"


def arguments() -> argparse.Namespace:
    """The options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="regular expression that the file name must contain")
    parser.add_argument("--kinds", default="", help="mistakes of these kinds, all over the product: KIND,KIND,...")
    parser.add_argument("--careless", action="store_const", dest="kinds", const=",".join(CARELESS),
                        help="the same as all --kinds of mutation/careless.py")  # fmt: skip
    parser.add_argument("--count", type=int, default=240, help="mutants over all chosen files")
    parser.add_argument("--seed", type=int, default=0, help="of the choice; a larger count extends a smaller one")
    parser.add_argument("--beside", type=Path, nargs="*", default=[], help="lists of mutants that are not drawn again")
    parser.add_argument("--jobs", type=int, default=2, help="mutants at a time")
    parser.add_argument("--longest", type=float, default=10.0, help="seconds of computing; longer tests are not asked")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "mutation", help="folder of verdicts")
    options = parser.parse_args()
    options.kinds = [kind for kind in options.kinds.split(",") if kind]
    return options


def prepare() -> None:
    """Make this process the one that all mutants are forked from."""
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"  # one mutant, one core
    for library in LIBRARIES:
        with contextlib.suppress(ImportError):  # an extra may be absent; the tests that need it are skipped then
            importlib.import_module(library)


def main() -> None:
    """Choose, judge, tell."""
    options = arguments()
    options.out.mkdir(parents=True, exist_ok=True)
    prepare()
    # What a group of tests overlooks the nearest tests may see, and the reverse.
    path = options.out / ("nearest.jsonl" if options.kinds else "verdicts.jsonl")
    wanted, entries = chosen(options), list[dict[str, Any]]()

    def fresh() -> Iterator[Job]:
        for one in jobs(wanted, earlier(path), options):
            if isinstance(one, Job):
                yield one
            else:
                entries.append(one)

    with path.open("a", encoding="utf-8") as file:
        for found in verdicts(ROOT, fresh(), options.jobs):
            entry = found | {"by_code": code_of_test(ROOT, found["by"])}
            entries.append(entry)
            print(json.dumps(entry), file=file, flush=True)
            print(f"{len(entries)}/{len(wanted)} {entry['verdict']:8} {_line(entry, None)}", flush=True)
    excuses = tomllib.loads(EXCUSED.read_text(encoding="utf-8")).get("excused", [])
    text = summary(entries, excuses, "kind" if options.kinds else "file")
    (options.out / "summary.md").write_text(text + "\n", encoding="utf-8")
    notes = {entry["key"]: reason(entry, excuses) for entry in entries if entry["verdict"] == "survived"}
    (options.out / "list.csv").write_text(listing(entries, notes), encoding="utf-8")
    print(f"\n{text}")


if __name__ == "__main__":
    main()
