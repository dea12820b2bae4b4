"""Tables of a study whose fits are scored along their length: how far each method is from one of them, and after what.

    novags study docs/studies/paper-length.toml --out out/paper-length
    python scripts/choices/lengths.py out/paper-length --stops out/paper-length-stops --page docs/paper-length.md

Differences are paired by scene, seed and view, and carry the standard error over scenes (`novags.testbed.metrics.
differences`); a star marks those whose 95 % interval leaves 0 out. Runs that are not finished are counted and left out.
`--stops` is the same study with `hold_out`: its fits say after which length a method would stop itself, and the score
there is of the fit with all views. `--kept` is a CSV of single scores: fits of the folder are added to it, and the
tables are of all its fits, so that a study of many hours can be made in parts. Where there is no such folder, the
tables are of the CSV alone, but for the one of stops. Of a study with further axes `--only`
takes one value of each: `--only electrons=20 sensor=a7s2-iso6400`. The page has the tables between <!-- table: NAME -->
and <!-- /table -->, NAME being the folder's (of `--only` with the values: out-20-a7s2-iso6400), and NAME-along,
NAME-scenes, NAME-stops; of a study whose fits are scored at their ends alone the first.
"""

import argparse
import csv
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median

sys.path.insert(0, str(Path(__file__).parent))  # so that it is found where this file is loaded by its path

from settle import write_table

from novags.testbed.ledger.contents import digest
from novags.testbed.metrics.differences import Estimate, Values, difference, estimate
from novags.testbed.stages.scores.comparing import SHARES, enhancement_of, values_of
from novags.testbed.study.results import read_scores

HEADS = {"aligned_psnr": "aligned PSNR against the own noise-free reference, dB",
         "tone_aligned_psnr": "tone-aligned PSNR against the well-lit render, dB"}  # fmt: skip
MORE = (
    ("enhanced", "aligned_ssim", "SSIM aligned", 3),
    ("enhanced", "st_lpips", "ST-LPIPS", 3),
    ("enhanced", "flip", "FLIP", 3),
)


KEPT = (*SHARES.values(), *((kind, score) for kind, score, *_ in MORE))  # what is read of a run's scores
COLUMNS = ("method", "scene", "seed", "enhancement", "stop", "iterations", "view", *(".".join(one) for one in KEPT))


@dataclass(frozen=True)
class Fit:
    """A finished run of a study: its scores by length, and where it would stop itself if it held views out."""

    method: str
    scene: str
    seed: str
    enhancement: str  # digest of what its noise-free reference is enhanced by
    stop: int | None
    scores: Mapping[int | None, Mapping[tuple[str, str], Values]]  # by iterations (None: after all of them) and score

    def values(self, kind: str, score: str, at: int | None) -> Values:
        """A score at one length, by scene, seed and view; {} where it was not scored."""
        return self.scores.get(at, {}).get((kind, score), {})


def fits_of(folder: Path, only: Mapping[str, str]) -> tuple[list[Fit], int]:
    """The finished runs of a study with these values of its axes, and how many it has of them in all.

    Raises:
        SystemExit: If the study has no such axis or value, or has another axis with several values.
    """
    table = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    rows = table["rows"]
    for axis in table["axes"]:
        if (
            axis not in ("method", "scene", "seed", *only)
            and len(values := {str(row[axis]) for row in rows if axis in row}) > 1
        ):
            raise SystemExit(f"lengths.py: {folder} has several values of {axis}: name one by --only "
                             f"{axis}={sorted(values)[0]}")  # fmt: skip
    for axis, value in only.items():
        there = [str(row[axis]) for row in rows if axis in row]
        if value not in there:
            raise SystemExit(f"lengths.py: no run of {folder} has {axis}={value}: "
                             f"{', '.join(dict.fromkeys(there)) or f'{axis} is no axis of the study'}")  # fmt: skip
        rows = [row for row in rows if str(row.get(axis)) == value]
    found = []
    for row in rows:
        if row["state"] == "done":
            run = folder / row["folder"]
            whole, record = read_scores(run), json.loads((run / "run.json").read_text(encoding="utf-8"))
            by_length = {None: whole} | {each["iterations"]: each for each in whole.get("along") or ()}
            stop = (whole.get("held_out") or {}).get("stop")
            method, scene, seed = row["method"], str(row["scene"]), str(row["seed"])
            scores = {at: {one: values_of(each, *one, scene, seed) for one in KEPT} for at, each in by_length.items()}
            found.append(Fit(method, scene, seed, digest(enhancement_of(record))[:8], stop, scores))
    return found, len(rows)


def read_kept(path: Path) -> list[Fit]:
    """The fits of a CSV that `keep` wrote; none where there is no such file."""
    if not path.exists():
        return []
    fits = dict[tuple[str, ...], dict[int | None, dict[tuple[str, str], dict[tuple[str, str, str], float]]]]()
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            fit = fits.setdefault(tuple(row[name] for name in COLUMNS[:5]), {})
            at = fit.setdefault(int(row["iterations"]) if row["iterations"] else None, {one: {} for one in KEPT})
            for one in KEPT:
                if text := row[".".join(one)]:
                    at[one][row["scene"], row["seed"], row["view"]] = float(text)
    return [
        Fit(method, scene, seed, enhancement, int(stop) if stop else None, scores)
        for (method, scene, seed, enhancement, stop), scores in fits.items()
    ]


def keep(path: Path, fits: list[Fit]) -> None:
    """Write the scores of fits by length and view."""
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for fit in fits:
            for at, scores in fit.scores.items():
                for key in dict.fromkeys(key for values in scores.values() for key in values):
                    values = [scores[one].get(key) for one in KEPT]
                    cells = ("" if value is None else f"{value:.6g}" for value in values)
                    rows.writerow([fit.method, fit.scene, fit.seed, fit.enhancement, fit.stop, at, key[2], *cells])


def together(fits: list[Fit], method: str, kind: str, score: str, at: int | None = None, scene: str = "") -> Values:
    """The values of a method at one length over its runs, of one scene alone if named."""
    found: dict[tuple[str, str, str], float] = {}
    for fit in fits:
        if fit.method == method and scene in ("", fit.scene):
            found |= fit.values(kind, score, at)
    return found


def apart(fits: list[Fit], one: str, other: str, kind: str, score: str, at: int | None = None, scene: str = "") -> str:
    """A difference of two methods ± its error, starred if it is seen; of two enhancements there are two references."""
    if kind == "enhanced" and len({fit.enhancement for fit in fits if fit.method in (one, other)}) > 1:
        return "–"
    found = difference(*(together(fits, name, kind, score, at, scene) for name in (one, other)))
    return "–" if found is None else said(found)


def said(apart: Estimate) -> str:
    """A difference ± its error, starred if it is seen."""
    error = "" if apart.error is None else f" ± {apart.error:.2f}"
    return f"{apart.value:+.2f}{error}{'*' if apart.half is not None and apart.seen else ''}"


def table(heads: list[str], rows: Mapping[str, list[str]]) -> str:
    """Markdown; a row for each method."""
    lines = ["| | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    return "\n".join([*lines, *(f"| `{name}` | " + " | ".join(cells) + " |" for name, cells in rows.items())])


def mean(values: Values, digits: int = 2) -> str:
    """The mean over scenes of a score."""
    found = estimate(values)
    return "–" if found is None else f"{found.value:.{digits}f}"


def methods_of(fits: list[Fit]) -> list[str]:
    """The methods with finished runs, in the order of the study."""
    return list(dict.fromkeys(fit.method for fit in fits))


def at_the_end(fits: list[Fit], than: str) -> str:
    """Scores after all iterations, and differences."""
    rows, heads = dict[str, list[str]](), list[str]()
    for name in methods_of(fits):
        cells, heads = [], ["runs"]
        cells.append(str(sum(fit.method == name for fit in fits)))
        for kind, score in SHARES.values():
            heads += [HEADS[score], f"over `{than}`"]
            cells += [
                mean(together(fits, name, kind, score)),
                "" if name == than else apart(fits, name, than, kind, score),
            ]
        for kind, score, head, digits in MORE:
            heads.append(head)
            cells.append(mean(together(fits, name, kind, score), digits))
        rows[name] = cells
    return table(heads, rows)


def along(fits: list[Fit], than: str) -> str:
    """Differences at the same length, by length; of the other method itself its score."""
    lengths = [*sorted({at for fit in fits for at in fit.scores if at is not None}), None]
    parts = []
    for kind, score in SHARES.values():
        rows = {}
        for name in methods_of(fits):
            rows[name] = [mean(together(fits, name, kind, score, at)) if name == than
                          else apart(fits, name, than, kind, score, at) for at in lengths]  # fmt: skip
        parts += [HEADS[score][0].upper() + HEADS[score][1:] + ":", table([str(at or "end") for at in lengths], rows)]
    return "\n\n".join(parts)


def by_scene(fits: list[Fit], than: str) -> str:
    """Differences at the end in each scene by itself, whose error is over its seeds and views."""
    scenes = list(dict.fromkeys(fit.scene for fit in fits))
    rows, heads = dict[str, list[str]](), [f"{scene}, {score}" for score in ("aligned", "lit") for scene in scenes]
    for name in methods_of(fits):
        rows[name] = []
        for kind, score in SHARES.values():
            for scene in scenes:
                own = mean(together(fits, name, kind, score, scene=scene)) if name == than else ""
                rows[name].append(own or apart(fits, name, than, kind, score, scene=scene))
    return table(heads, rows)


def three_lengths(fits: list[Fit], holding: list[Fit]) -> str:
    """Mean score at the end, at the own stop and at the best length of each fit; the stops, and what they lose.

    The fits of a method some of which have no stop are those that have one; where none has, all of them.
    """
    stops = {(fit.method, fit.scene, fit.seed): fit.stop for fit in holding}
    rows, heads = dict[str, list[str]](), list[str]()
    for name in methods_of(fits):
        every = [(fit, stops.get((name, fit.scene, fit.seed))) for fit in fits if fit.method == name]
        places = [(fit, stop) for fit, stop in every if stop is not None]
        cells, heads = [], []
        for kind, score in SHARES.values():
            heads += [f"end, {score.removesuffix('_psnr')}", "own stop", "best", "loss: median (largest)"]
            curves = [({at: fmean(v.values()) for at in fit.scores if (v := fit.values(kind, score, at))}, stop)
                      for fit, stop in places or every]  # fmt: skip
            end, best = (fmean(one) for one in zip(*((c[None], max(c.values())) for c, _ in curves), strict=True))
            own, lost = "–", "–"
            if places:
                at_stop = [curve.get(stop, curve[None]) for curve, stop in curves]
                losses = [max(curve.values()) - one for (curve, _), one in zip(curves, at_stop, strict=True)]
                own, lost = f"{fmean(at_stop):.2f}", f"{median(losses):.2f} ({max(losses):.2f})"
            cells += [f"{end:.2f}", own, f"{best:.2f}", lost]
        rows[name] = [*cells, ", ".join(str(stop) for _, stop in places) or "–"]
    return table([*heads, "stops after"], rows)


def main() -> None:
    """Run it from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--stops", type=Path, help="the same study with hold_out")
    parser.add_argument("--kept", type=Path, help="CSV of single scores, to which the folder's are added")
    parser.add_argument("--only", nargs="*", default=[], metavar="AXIS=VALUE", help="runs with these values")
    parser.add_argument("--than", default="naive", help="the method that the others are compared with")
    parser.add_argument("--page", type=Path, required=True)
    options = parser.parse_args()
    only = dict(one.split("=", 1) for one in options.only)
    alone = options.kept is not None and options.kept.exists() and not options.folder.exists()
    fits, runs = ([], 0) if alone else fits_of(options.folder, only)
    if options.kept:
        places = {(fit.method, fit.scene, fit.seed): fit for fit in [*read_kept(options.kept), *fits]}
        fits = list(places.values())
    if options.kept and not alone:
        keep(options.kept, fits)
    holding = fits_of(options.stops, only)[0] if options.stops else []
    name, than = "-".join([options.folder.name, *only.values()]), options.than
    made = f"{len(fits)} runs" if options.kept else f"{len(fits)} of {runs} runs"
    write_table(options.page, name, f"{made}.\n\n" + at_the_end(fits, than))
    if not any(at for fit in fits for at in fit.scores):  # scored at their ends alone
        return
    write_table(options.page, f"{name}-along", along(fits, than))
    write_table(options.page, f"{name}-scenes", by_scene(fits, than))
    if not alone:
        write_table(options.page, f"{name}-stops", three_lengths(fits, holding))


if __name__ == "__main__":
    main()
