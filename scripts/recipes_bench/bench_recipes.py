"""Does a small network that learns from a recipe of `novags dataset` beat the classical method, on scenes held out?

    novags dataset scripts/recipes_bench/data.toml --out out/recipes
    python scripts/recipes_bench/bench_recipes.py out/recipes --out out/bench-recipes [--recipes NAME …] [--steps N]

A recipe is a module of recipes_bench: its network, its rival, its score. Settings were fixed before the test scenes
were looked at. Differences are paired by scene, light and view, and their standard errors are over scenes. Trained
networks and scores are kept in --out: the same command goes on.
"""

import argparse
import csv
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from novags.process import settle
from novags.testbed.metrics.differences import Values, difference, estimate
from recipes_bench import depth, poses, raw

RECIPES: dict[str, ModuleType] = {module.NAME: module for module in (raw, poses, depth)}
FIELDS = ("recipe", "scene", "electrons", "view", "who", "score")
BRIGHT = 100.0  # electrons: pictures above are not dark
Scores = list[dict[str, str]]


def main() -> None:
    """Train what is not there, measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="the folder of a data set with these recipes")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--recipes", nargs="+", choices=list(RECIPES), default=list(RECIPES))
    parser.add_argument("--steps", type=int, default=None, help="of each training, instead of the recipe's own")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    settle()
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    found: Scores = []
    for name in options.recipes:
        found += measured(RECIPES[name], options.data, options.out, options.steps, options.seed)
    (options.out / "table.csv").write_text(table(found), encoding="utf-8")
    print(f"\n{table(found)}", flush=True)


def measured(recipe: ModuleType, data: Path, out: Path, steps: int | None, seed: int) -> Scores:
    """The scores of the network and of its rival, of each test view, or scene, and light."""
    steps = recipe.STEPS if steps is None else steps
    kept = out / f"{recipe.NAME}-{steps}-{seed}.csv"
    if not kept.exists():
        with (data / "training" / recipe.NAME / "index.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        torch.manual_seed(seed)
        own = {split: [row for row in rows if row["split"] == split] for split in ("train", "test")}
        network = recipe.train(own["train"], data, steps, seed, kept.with_suffix(".safetensors"))
        scores = []
        for row, view, who, score in recipe.scores(network, own["test"], data):
            light = f"{float(row['electrons']):g}"
            values = recipe.NAME, row["scene"], light, view, who, f"{score:.5g}"
            scores.append(dict(zip(FIELDS, values, strict=True)))
            print(*scores[-1].values(), flush=True)
        with kept.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(scores)
    with kept.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def table(scores: Scores) -> str:
    """A row for each recipe and light, and one for all its lights: both means, and their difference with its error."""
    lines = ["recipe,score,electrons,network,rival,network - rival,scenes,errors"]
    for name in dict.fromkeys(row["recipe"] for row in scores):
        own = [row for row in scores if row["recipe"] == name and float(row["electrons"]) < BRIGHT]
        lights = sorted({row["electrons"] for row in own}, key=float)
        for light in [*([light] for light in lights), lights]:
            lines.append(",".join(_row(RECIPES[name], [row for row in own if row["electrons"] in light], light)))
    return "\n".join(lines) + "\n"


def _row(recipe: ModuleType, scores: Scores, lights: Iterable[str]) -> list[str]:
    ours, rival = (_values(scores, who) for who in ("network", recipe.RIVAL))
    gap, means = difference(ours, rival), [estimate(values) for values in (ours, rival)]
    assert gap is not None
    shown = [f"{mean.value:.3g}" for mean in means if mean is not None]
    ratio = "" if not gap.error else f"{abs(gap.value) / gap.error:.1f}"
    error = "" if gap.error is None else f" ± {gap.error:.2g}"
    return [recipe.NAME, recipe.UNIT.replace(",", ";"), " ".join(lights), *shown, f"{gap.value:+.3g}{error}",
            str(gap.scenes), ratio]  # fmt: skip


def _values(scores: Scores, who: str) -> Values:
    """By scene and view; light levels count as views, since the same noise-free view is behind them."""
    return {(row["scene"], "0", f"{row['view']} {row['electrons']}"): float(row["score"])
            for row in scores if row["who"] == who}  # fmt: skip


if __name__ == "__main__":
    main()
