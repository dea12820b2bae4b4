"""Tables of what each part of a method is worth: every other method and variant of a study against `base`.

    novags study docs/studies/ablation-levels.toml --out out/ablation-levels
    python scripts/choices/ablations.py out/ablation-* --page docs/ablations.md

Numbers are differences to `base` at the same scene, seed and place, mean ± standard error over scenes and seeds. The
page has the tables between <!-- table: NAME --> and <!-- /table -->, NAME being the folder's.
"""

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))  # so that it is found where this file is loaded by its path

from settle import BASE, write_table

Row = Mapping[str, Any]
OWN, LIT = "enhanced.aligned_psnr", "lit.tone_aligned_psnr"
MORE = {  # column of the study -> its heading, factor, digits
    "enhanced.aligned_ssim": ("SSIM", 1, 3),
    "enhanced.flip": ("FLIP", 1, 3),
    "enhanced.delta_e": ("ΔE2000", 1, 1),
    "geometry.abs_rel": ("depth error, %", 100, 1),
    "geometry.floaters": ("floaters, %", 100, 2),
    "geometry.consistency.excess": ("inconsistency", 1, 3),
    "noise.targets": ("noise left in targets", 1, 2),
    "noise.renders": ("in renders", 1, 2),
    "noise.bias_floor": ("bias floor, dB", 1, 1),
    "seconds.reconstruct": ("seconds", 1, 0),
}
OWN_REFERENCE_ONLY = ("enhanced.", "noise.")  # scores against the enhancement of the run itself


def columns_of(rows: Sequence[Row], axes: Sequence[str]) -> tuple[str, list[Any]]:
    """The axis whose values stand side by side, and its values in order: the last that is neither method nor seed."""
    axis = [name for name in axes if name not in ("method", "seed")][-1]
    return axis, list(dict.fromkeys(row[axis] for row in rows))


def scored(rows: Sequence[Row], method: str, score: str, keep: Callable[[Row], bool]) -> list[Row]:
    """The finished runs of a method that have a score."""
    done = [row for row in rows if row["method"] == method and row["state"] == "done" and keep(row)]
    return [row for row in done if row[score] is not None]


def compared(
    rows: Sequence[Row], axes: Sequence[str], method: str, score: str, keep: Callable[[Row], bool]
) -> list[float]:
    """Differences of a method to `base` in a score, run by run at the same place, where both have it."""
    mine, base = (
        {tuple(row[axis] for axis in axes if axis != "method"): row[score] for row in scored(rows, name, score, keep)}
        for name in (method, BASE)
    )
    return [value - base[place] for place, value in mine.items() if place in base]


def spread(values: Sequence[float]) -> str:
    """Mean ± standard error."""
    if not values:
        return "–"
    mean = sum(values) / len(values)
    if len(values) == 1:
        return f"{mean:+.2f}"
    error = math.sqrt(sum((v - mean) ** 2 for v in values) / (len(values) - 1) / len(values))
    return f"{mean:+.2f} ± {error:.2f}"


def mean_of(rows: Sequence[Row], method: str, score: str, keep: Callable[[Row], bool]) -> float | None:
    """Mean of a score over the runs of a method."""
    values = [row[score] for row in scored(rows, method, score, keep)]
    return sum(values) / len(values) if values else None


def differences(rows: Sequence[Row], axes: Sequence[str], score: str, foreign: Sequence[str]) -> str:
    """Table of one score; `foreign` methods have another reference and no comparable number."""
    axis, values = columns_of(rows, axes)
    methods = dict.fromkeys(row["method"] for row in rows)
    head = [f"| {axis} | " + " | ".join(str(value) for value in values) + " |", "|---" * (len(values) + 1) + "|"]
    lines = []
    for method in methods:
        cells = []
        for value in values:

            def keep(row: Row, value: Any = value) -> bool:
                return bool(row[axis] == value)

            if method == BASE:
                base = mean_of(rows, BASE, score, keep)
                cells.append("–" if base is None else f"{base:.2f} dB")
            else:
                cells.append("–" if method in foreign else spread(compared(rows, axes, method, score, keep)))
        lines.append(f"| `{method}` | " + " | ".join(cells) + " |")
    return "\n".join(head + lines)


def means(rows: Sequence[Row], foreign: Sequence[str]) -> str:
    """Table of what else is scored: means over all places."""
    methods = dict.fromkeys(row["method"] for row in rows)
    head = ["| | " + " | ".join(heading for heading, _, _ in MORE.values()) + " |", "|---" * (len(MORE) + 1) + "|"]
    lines = []
    for method in methods:
        cells = []
        for score, (_, factor, digits) in MORE.items():
            found = mean_of(rows, method, score, lambda _: True)
            other = method in foreign and score.startswith(OWN_REFERENCE_ONLY)
            cells.append("–" if found is None or other else f"{factor * found:.{digits}f}")
        lines.append(f"| `{method}` | " + " | ".join(cells) + " |")
    return "\n".join(head + lines)


def page_part(rows: Sequence[Row], axes: Sequence[str], foreign: Sequence[str]) -> str:
    """All tables of a study."""
    done = sum(row["state"] == "done" for row in rows)
    return "\n\n".join(
        (
            f"{done} of {len(rows)} runs. Aligned PSNR against the own reference, dB:",
            differences(rows, axes, OWN, foreign),
            "Tone-aligned PSNR against the well-lit render, dB:",
            differences(rows, axes, LIT, ()),
            "Means over all places:",
            means(rows, foreign),
        )
    )


def main() -> None:
    """Run it from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--page", type=Path, required=True)
    parser.add_argument(
        "--foreign", nargs="*", default=["no-enhancement"], help="methods with a reference of their own"
    )
    options = parser.parse_args()
    for folder in options.folders:
        found = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        write_table(options.page, folder.name, page_part(found["rows"], found["axes"], options.foreign))


if __name__ == "__main__":
    main()
