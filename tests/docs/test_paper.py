"""The page on the paper's claims says what the measured tables say."""

import csv
import re
from pathlib import Path
from statistics import fmean, stdev

DOCS = Path(__file__).resolve().parents[2] / "docs"


def rows(name: str) -> dict[str, list[str]]:
    with (DOCS / "tables" / name).open(encoding="utf-8") as file:
        return {row[0].removesuffix(" †"): row[1:] for row in csv.reader(file)}


def claim(start: str) -> str:
    """The cell beside a claim of the paper."""
    (line,) = [line for line in (DOCS / "paper.md").read_text("utf-8").splitlines() if line.startswith(f"| {start}")]
    return line.split(" | ")[1]


def number(cell: str) -> float:
    return float(re.match(r"[-+]?[\d.]+", cell)[0])  # type: ignore[index]


def test_the_places_in_the_papers_table_are_the_places_of_the_measured_scores() -> None:
    """Of the ten methods that the paper compares, by PSNR and by tone-aligned PSNR."""
    table = rows("table1/paper.csv")
    levels = [head.partition(":")[0] for head in table.pop("")]
    assert len(table) == 10
    for k, level in enumerate(levels):
        ours = {name: [float(value) for value in cells[k].split(", ")[1:]] for name, cells in table.items()}
        places = [1 + sum(found[j] > ours["nova-small"][j] for found in ours.values()) for j in (0, 1)]
        said = re.search(rf"(\d+)\w+ and (\d+)\w+ at `{level}`", claim("First on LLNeRF"))
        assert said is not None
        assert places == [int(said[1]), int(said[2])], level


def test_differences_to_a_plain_gamma_are_the_differences_of_the_table() -> None:
    said, alike = claim("A guided filter"), list[str]()
    for level in ("lom", "llnerf", "llrs", "mvtv"):
        table = rows(f"table1/{level}.csv")
        apart = number(table["naive"][0]) - number(table["gamma-gs"][0])
        found = re.search(rf"([-+][\d.]+)(?: dB)? at `{level}`", said)
        assert found is not None
        assert f"{apart:+.2f}" == found[1], level
        alike.append(f"{number(table['naive'][0]) - number(table['gamma-auto-gs'][0]):+.2f}")
    assert f"sought as its own is (`gamma-auto-gs`): tone-aligned {', '.join(alike)} dB" in said
    table = rows("table1/mvtv.csv")
    ours, *others = (number(table[name][0]) for name in ("nova-small", "gamma-gs", "drago-gs"))
    over = [ours - other for other in others]
    assert f"{over[0]:.1f} and {over[1]:.1f} dB" in claim("In 16 bits")


def test_figures_at_the_papers_length_and_of_ablations_are_of_their_tables() -> None:
    page = (DOCS / "paper-length.md").read_text("utf-8")
    cells = {name: re.split(r" *\| *", rest) for name, rest in re.findall(r"^\| `([\w-]+)` \| (.*) \|$", page, re.M)}
    over, perceptual = cells["nova"][2], (cells["nova"][6], cells["naive"][6])
    said = claim("Denoiser and penalty")
    assert f"{over.rstrip('*').lstrip('+')} dB above `naive`" in said
    assert "ST-LPIPS {:.3f} beside {:.3f}".format(*map(float, perceptual)).replace("0.", ".") in said
    ablation = rows("ablations/ablation-levels-3.csv")
    kinds = dict(zip(ablation.pop(""), zip(*ablation.values(), strict=True), strict=True))
    names = list(ablation)
    views = {name: float(kinds["inconsistency"][names.index(name)]) for name in ("base", "naive", "oracle")}
    assert "between views {base:.3f}, `naive` {naive:.3f}, noise-free {oracle:.3f}".format(**views).replace(
        "0.", "."
    ) in claim("Views agree")
    depth = [kinds["depth error, %"][names.index(name)] for name in ("base", "no-geo")]
    assert "of depth of {} for {} %".format(*depth) in claim("The geometric loss")


def test_how_far_the_fast_variation_is_above_the_paper_s_method_is_scene_by_scene() -> None:
    """Differences to `naive` on the same runs of it; a scene has its own."""
    table = rows("paper-length/paper-length-scenes.csv")
    heads = [k for k, head in enumerate(table[""]) if head.endswith("aligned")]
    apart = [number(table["nova-fast"][k]) - number(table["nova"][k]) for k in heads]
    assert len(apart) == 3
    said = f"{fmean(apart):.2f} ± {stdev(apart) / 3**0.5:.2f} dB"
    assert f"`nova-fast` is {said} above `nova` (L)" in (DOCS / "paper.md").read_text("utf-8")
    assert f"{said} below `nova-fast`" in (DOCS / "paper-length.md").read_text("utf-8")


def test_what_a_part_is_worth_has_the_sign_of_the_tables_without_it() -> None:
    """Their rows lack the part: a number above 0 is what it costs."""
    tables = {path.name.split("-")[1]: rows(f"ablations/{path.name}") for path in DOCS.glob("tables/ablations/*-1.csv")}
    assert len(tables) == 4
    without = {name: {which: list(map(number, table[name])) for which, table in tables.items() if name in table}
               for name in ("no-geo", "no-confidence", "plain-unet")}  # fmt: skip
    costs, worths = ([value for values in without[name].values() for value in values]
                     for name in ("no-geo", "no-confidence"))  # fmt: skip
    assert claim("The geometric loss").startswith(f"It costs {min(costs) + 0:.2f} to {max(costs):.2f} dB")
    assert claim("Confidence") == f"It is worth {-max(worths) + 0:.2f} to {-min(worths):.2f} dB"
    said, plain = claim("Attention"), without["plain-unet"]
    assert max(map(abs, plain["levels"])) < 0.1
    assert f"on four scenes {min(plain['texture']):+.2f} to {max(plain['texture']):+.2f} dB" in said


def test_seconds_are_the_least_of_the_seeds_over_the_levels() -> None:
    tables = [rows(f"table1/{level}.csv") for level in ("lom", "llnerf", "llrs", "mvtv")]

    def span(*names: str) -> str:
        found = [round(number(table[name][5])) for table in tables for name in names]
        return f"{min(found)} to {max(found)} s"

    said = claim("Trains faster")
    fields = ("nerf", "raw-nerf", "aleth-nerf", "ll-nerf", "i2-nerf", "i2-nerf-truth", "nerf-oracle")
    assert f"`nova-small` took {span('nova-small')}, fields {span(*fields)} " in said
    assert f"`lita-gs` and `luminance-gs` {span('lita-gs', 'luminance-gs')}, `naive` {span('naive')}" in said
