r"""The paper's Table 1 in this bed: a page with one table for each light level, and its rows as CSV.

    novags study docs/studies/table1.toml --out out/table1
    novags study docs/studies/table1-weights.toml --out out/table1-weights  # where the authors' weights are
    novags study docs/studies/table1-simulated.toml --out out/table1-simulated  # after scripts/train_enhancer.py
    python scripts/choices/table1.py out/table1* --page docs/table1.md --rows docs/tables/table1/runs.csv

Sources are folders of studies and CSV files that an earlier call wrote, so that seeds can be measured one at a time.
The page has the tables between <!-- table: LEVEL --> and <!-- /table -->, and at `paper` the paper's numbers beside
ours, at `levels` the table of all levels, at `best` its first places.
"""

import argparse
import csv
import json
import re
import sys
from collections.abc import Mapping, Sequence
from math import inf
from pathlib import Path
from statistics import fmean
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))  # so that it is found where this file is loaded by its path

from scipy.stats import spearmanr
from settle import write_table

from novags.methods import METHODS, chosen, with_variants
from novags.methods.variant import Variant
from novags.process import settle
from novags.testbed.console.csv_text import as_csv, text_of
from novags.testbed.report.grid import Line, by_place, is_helped, lines_of
from novags.testbed.report.rows import looks_of
from sensor_model.files.toml_file import read_toml

Row = Mapping[str, Any]
FOLDER = Path(__file__).resolve().parents[2] / "docs" / "studies"
STUDIES = [FOLDER / f"table1{end}.toml" for end in ("", "-weights", "-simulated")]
PLACE = ("scene", "level", "method", "seed")
MAIN = "lit.tone_aligned_psnr"
SECONDS = "seconds.reconstruct"
KEPT = ("linear.linear_psnr", "enhanced.aligned_psnr")  # in no table: one tells linear light, the page quotes the other
# column of the study -> heading, factor, digits, whether the first three are coloured
SCORES = {
    MAIN: ("tone-aligned PSNR, dB", 1, 2, True),
    "lit.psnr": ("PSNR, dB", 1, 2, True),
    "lit.ssim": ("SSIM", 1, 3, True),
    "lit.lpips": ("LPIPS", 1, 3, True),
    "lit.flip": ("FLIP", 1, 3, True),
    "geometry.abs_rel": ("depth error, %", 100, 1, True),
    SECONDS: ("seconds", 1, 0, False),
    "peak_bytes": ("memory, MB", 1, 0, False),
}
FAMILIES = {
    "2D + GS": "Enhanced one by one, then Gaussians", "NeRF": "Radiance fields", "3DGS": "Gaussians",
    "ours": "NOVA-GS and `nova-plus`", "bound": "Bounds, which see truth",
}  # fmt: skip
PAPER = {  # method here -> PSNR that the paper reports, dB, on LOM, LLRS and LLNeRF
    "sci": (11.86, 9.37, 12.82), "mbllen": (15.08, 15.36, 18.09), "uretinex": (20.29, 15.10, 20.08),
    "zero-dce": (13.48, 10.23, 14.19), "aleth-nerf": (19.56, 12.65, 16.02), "ll-nerf": (17.60, 14.93, 18.82),
    "i2-nerf-truth": (22.40, 15.37, 21.91), "luminance-gs": (17.98, 9.78, 12.49), "lita-gs": (19.99, 14.87, 15.50),
    "nova-small": (20.97, 15.54, 23.49),
}  # fmt: skip
LEVELS = ("lom", "llrs", "llnerf")  # as the paper's columns
PLACES = re.compile(r"<!-- table: (\S+)(?: as CSV)? -->")  # of tables on the page
MEDALS = {1: " 🟩", 2: " 🟨", 3: " 🟥"}


def read_source(source: Path) -> list[dict[str, Any]]:
    """The rows of a study's folder, or of a CSV file that `write_rows` wrote."""
    if source.is_dir():
        return list(json.loads((source / "results.json").read_text(encoding="utf-8"))["rows"])
    with source.open(encoding="utf-8", newline="") as file:
        return [{key: _value(key, text) for key, text in row.items() if text} for row in csv.DictReader(file)]


def _value(key: str, text: str) -> Any:
    if key in ("scene", "level", "method", "state", "reason"):
        return text_of(text)
    return int(float(text)) if key in ("seed", "peak_bytes") else float(text)


def merged(sources: Sequence[Sequence[Row]]) -> list[Row]:
    """All rows, a later source in the place of an earlier one; what waits is left out."""
    found = {tuple(row[name] for name in PLACE): row for rows in sources for row in rows
             if row["state"] != "waiting"}  # fmt: skip
    return list(found.values())


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write what the page is made of."""
    names = [*PLACE, "state", "reason", *SCORES, *KEPT]
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(as_csv(rows, names))


def families(names: Sequence[str], study: Mapping[str, Any]) -> dict[str, str]:
    """Where each method or variant belongs."""
    own = [Variant(name=name, method=str(table["method"])) for name, table in study.get("variant", {}).items()]
    variants = with_variants(own)
    return {name: METHODS[chosen(name, variants).method].family for name in names}


def cell(line: Line, score: str) -> str:
    """A score with its spread over the seeds and its colour; of times the least, to which other work only adds."""
    if score not in line.spread:
        return "–"
    _, factor, digits, colored = SCORES[score]
    mean, sd = line.spread[score]
    if score == SECONDS:
        mean, sd = min(row[SECONDS] for row in line.runs if row.get(SECONDS) is not None), None
    text = f"{factor * mean:.{digits}f}" + ("" if sd is None else f" ± {factor * sd:.{digits}f}")
    text += " ‡" if is_helped(score) and line.in_linear_light else ""
    rank = line.places.get(score) if colored else None
    return (f"**{text}**" if rank == 1 else text) + (MEDALS.get(rank, "") if rank else "")


def level_table(lines: Sequence[Line], family: Mapping[str, str], competes: Mapping[str, bool]) -> str:
    """The table of one level, by family, in each the best first."""
    scores = [score for score in SCORES if score != "lit.lpips" or any(score in line.spread for line in lines)]
    done = sum(row["state"] == "done" for line in lines for row in line.runs)
    lpips = "" if "lit.lpips" in scores else " LPIPS: unavailable."
    text = [f"{done} of {sum(len(line.runs) for line in lines)} runs.{lpips}", ""]
    text += ["| | " + " | ".join(SCORES[score][0] for score in scores) + " |", "|---" * (len(scores) + 1) + "|"]
    for name, title in FAMILIES.items():
        members = sorted((line for line in lines if family[line.method] == name), key=_worse)
        if members:
            text.append(f"| *{title}* |" + " |" * len(scores))
        for line in members:
            mark = "" if competes[line.method] else " †"
            text.append(f"| `{line.method}`{mark} | " + " | ".join(cell(line, score) for score in scores) + " |")
    said = {"failed": "", "skipped": "a task it needs has failed: "}
    failed = [f"`{row['method']}`, seed {row['seed']}: {said[row['state']]}{row['reason']}"
              for line in lines for row in line.runs if row["state"] in said]  # fmt: skip
    return "\n".join([*text, *(["", "Failed: " + "; ".join(failed)] if failed else [])])


def _worse(line: Line) -> float:
    """Sorts the best first, and rows without a score last."""
    return -line.spread[MAIN][0] if MAIN in line.spread else inf


def all_levels(lines: Sequence[Line], family: Mapping[str, str], competes: Mapping[str, bool]) -> str:
    """Tone-aligned PSNR of every method at every level."""
    levels = list(dict.fromkeys(line.place["level"] for line in lines))
    text = ["| tone-aligned PSNR, dB | " + " | ".join(levels) + " |", "|---" * (len(levels) + 1) + "|"]
    rows = {name: {line.place["level"]: line for line in lines if line.method == name}
            for name in dict.fromkeys(line.method for line in lines)}  # fmt: skip
    mean = {name: fmean(_worse(line) for line in at.values()) for name, at in rows.items()}
    for name, at in sorted(rows.items(), key=lambda row: (list(FAMILIES).index(family[row[0]]), mean[row[0]])):
        cells = [cell(at[level], MAIN) if level in at else "–" for level in levels]
        text.append(f"| `{name}`{'' if competes[name] else ' †'} | " + " | ".join(cells) + " |")
    return "\n".join(text)


def the_best(table: str) -> str:
    """Of the table of all levels the methods that have a place, and the two that all are measured by."""
    head, rule, *rows = table.splitlines()
    return "\n".join([head, rule, *(row for row in rows if re.search(r"[🟩🟨🟥]|`naive`|`oracle`", row))])


def beside_paper(lines: Sequence[Line]) -> str:
    """PSNR that the paper reports and that is found here, and how well the orders agree (Spearman)."""
    heads = " | ".join(f"{level}: paper, PSNR, tone-aligned" for level in LEVELS)
    text = [f"| | {heads} |", "|---" * (len(LEVELS) + 1) + "|"]
    found = {(line.method, line.place["level"]): line.spread for line in lines if MAIN in line.spread}
    for name, reported in PAPER.items():
        cells = []
        for value, level in zip(reported, LEVELS, strict=True):
            spread = found.get((name, level))
            ours = [f"{spread[score][0]:.2f}" for score in ("lit.psnr", MAIN)] if spread else ["–", "–"]
            cells.append(", ".join([f"{value:.2f}", *ours]))
        text.append(f"| `{name}` | " + " | ".join(cells) + " |")
    agreement = []
    for k, level in enumerate(LEVELS):
        both = [name for name in PAPER if (name, level) in found]
        if len(both) > 2:
            order = [
                spearmanr([PAPER[name][k] for name in both], [found[name, level][score][0] for name in both]).statistic
                for score in ("lit.psnr", MAIN)
            ]
            agreement.append(f"{level} {order[0]:.2f} and {order[1]:.2f}")
    text += ["", f"Rank correlation of the paper's PSNR with PSNR and tone-aligned PSNR here: {'; '.join(agreement)}."]
    return "\n".join(text)


def tables(rows: Sequence[Row], study: Mapping[str, Any]) -> dict[str, str]:
    """All tables, by the name of their place on the page."""
    names = list(dict.fromkeys(str(row["method"]) for row in rows))
    competes = {name: look.competes for name, look in looks_of(names, study).items()}
    family = families(names, study)
    lines = lines_of(rows, dict.fromkeys(PLACE), competes)
    found = {str(members[0].place["level"]): level_table(members, family, competes)
             for members in by_place(lines).values()}  # fmt: skip
    levels = all_levels(lines, family, competes)
    return {**found, "levels": levels, "best": the_best(levels), "paper": beside_paper(lines)}


def main() -> None:
    """Run it from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="+", type=Path)
    parser.add_argument("--page", type=Path, required=True)
    parser.add_argument("--rows", type=Path, help="CSV file to write the rows of all sources into")
    options = parser.parse_args()
    rows = merged([read_source(source) for source in options.sources])
    if options.rows:
        write_rows(options.rows, rows)
    variants = {name: table for path in STUDIES for name, table in read_toml(path)["variant"].items()}
    places = PLACES.findall(options.page.read_text(encoding="utf-8"))
    found = {**dict.fromkeys(places, "No runs."), **tables(rows, {"variant": variants})}  # no table of other rows stays
    for name, table in found.items():
        write_table(options.page, name, table)


if __name__ == "__main__":
    settle()
    main()
