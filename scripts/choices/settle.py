"""Settle open choices by successive halving: many alternatives in one place first, the better half of them in more.

    python scripts/choices/settle.py docs/studies/choices-three-chip.toml docs/studies/choices-bayer.toml \
        --out out/choices --page docs/choices.md

Each file is a study whose variants CHOICE.ALTERNATIVE differ from the variant `base` in one choice; variants and
methods without a dot run in every rung.

    rung 1    the first scene, level and seed
    rung 2    all scenes and levels, the first seed
    rung 3    the whole grid of the file

Rungs share one store, so that a later one does only new runs, and the same command resumes. The page has the tables
between <!-- table: NAME --> and <!-- /table -->, NAME being the file's; after <!-- table: NAME as CSV --> links to
files in docs/tables. `--tables` only writes them, from whatever is finished.
"""

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))  # so that it is found where this file is loaded by its path

from tables import as_csv
from verdict import Finding, findings, going_on, markdown

from novags.methods.variant import dotted
from sensor_model.files.toml_file import read_toml

BASE = "base"
RUNGS = (1, 2, 3)


def part(table: Mapping[str, Any], rung: int, contenders: list[str]) -> dict[str, Any]:
    """The study of one rung: the file with a smaller grid."""
    grid = {axis: values if isinstance(values, list) else [values] for axis, values in table["grid"].items()}
    for axis in grid:
        if axis not in ("method", "seed") and rung == 1:
            grid[axis] = grid[axis][:1]
    if rung < 3:
        grid["seed"] = grid["seed"][:1]
    grid["method"] = [name for name in grid["method"] if "." not in name or name in contenders]
    used = {name: v for name, v in table["variant"].items() if name in grid["method"]}
    return {**table, "grid": grid, "variant": used}


def written(table: Mapping[str, Any]) -> str:
    """A study as TOML."""
    lines = [f"{key} = {json.dumps(value)}" for key, value in table.items() if not isinstance(value, dict)]
    for name in ("grid", "override"):
        lines += ["", f"[{name}]", *_keys(table.get(name, {}))]
    for name, settings in table["variant"].items():
        lines += ["", f"[variant.{json.dumps(name)}]", *_keys(settings)]
    return "\n".join(lines) + "\n"


def _keys(table: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Keys of a table; TOML has read an unquoted a.b as a table b in a."""
    found: list[str] = []
    for key, value in table.items():
        if isinstance(value, dict):
            found += _keys(value, f"{prefix}{key}.")
        else:
            found.append(f"{json.dumps(prefix + key)} = {json.dumps(value)}")
    return found


def run(file: Path, table: Mapping[str, Any], workers: int | None) -> None:
    """Do the missing tasks of a study; runs that fail are rows of its table."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(written(table), encoding="utf-8")
    command = [sys.executable, "-m", "novags", "study", str(file), "--out", str(file.with_suffix("")), "--overwrite"]
    subprocess.run([*command, *(["--workers", str(workers)] if workers else [])], check=False)


def found_in(folder: Path, table: Mapping[str, Any]) -> list[Finding]:
    """What a rung has found so far."""
    path = folder / "results.json"
    if not path.exists():
        return []
    results = json.loads(path.read_text(encoding="utf-8"))
    return findings(results["rows"], list(results["axes"]), table, BASE)


def runs_of(table: Mapping[str, Any]) -> int:
    """How many pairs an alternative has in the last rung."""
    count = 1
    for axis, values in table["grid"].items():
        count *= 1 if axis == "method" or not isinstance(values, list) else len(values)
    return count


def settle(files: list[Path], out: Path, page: Path | None, rungs: int, workers: int | None, tables: bool) -> None:
    """Run the rungs, and write the tables after each."""
    studies = {file.stem: read_toml(file) for file in files}
    for table in studies.values():
        table["variant"] = {name: dotted(v) for name, v in table["variant"].items()}
    contenders = {name: list(table["variant"]) for name, table in studies.items()}
    latest: dict[str, dict[str, Finding]] = {name: {} for name in studies}
    for rung in RUNGS[:rungs]:
        for name, table in studies.items():
            file = out / f"{name}-rung{rung}.toml"
            if not tables:
                run(file, part(table, rung, contenders[name]), workers)
            if not (found := found_in(file.with_suffix(""), table)):
                continue
            latest[name] |= {f.name: f for f in found if f.own or f.failed}
            ended = {f.name for f in found if f.own or f.failed}
            awaited = [v for v in contenders[name] if v in alternatives(table)]
            contenders[name] = going_on(found) if ended.issuperset(awaited) else awaited
            listed = [latest[name].get(v) or Finding(v, s, (), (), None) for v, s in alternatives(table).items()]
            if page is not None:
                write_table(page, name, markdown(listed, runs_of(table), contenders[name]))


def alternatives(table: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The settings of every alternative by its name."""
    return {name: {k: v for k, v in settings.items() if k != "method"}
            for name, settings in table["variant"].items() if "." in name}  # fmt: skip


def write_table(page: Path, name: str, table: str) -> None:
    """Put a table in its place on a page.

    Raises:
        ValueError: If the page has no such place.
    """
    text = page.read_text(encoding="utf-8")
    place = re.compile(rf"(<!-- table: {re.escape(name)}( as CSV)? -->\n).*?(<!-- /table -->)", re.DOTALL)
    if not (there := place.search(text)):
        raise ValueError(f"{page} has no <!-- table: {name} --> with <!-- /table --> after it: add them")
    if there[2]:
        table = as_csv(table, page, name)
    page.write_text(place.sub(lambda found: f"{found[1]}\n{table}\n{found[3]}", text), encoding="utf-8")


def main() -> None:
    """Run it from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--rungs", type=int, default=3, choices=RUNGS)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--tables", action="store_true")
    options = parser.parse_args()
    settle(options.files, options.out, options.page, options.rungs, options.workers, options.tables)


if __name__ == "__main__":
    main()
