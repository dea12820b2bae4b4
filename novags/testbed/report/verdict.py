"""The outcome in a sentence and in numbers: which run comes first, by how much, and which scores disagree."""

from collections.abc import Iterator
from typing import Any

from novags.testbed.report.facts import costs, duration, geometry_table, join, leading, placed_in, signed
from novags.testbed.report.material import Material
from novags.testbed.report.tables import COLUMNS, GEOMETRY, Columns, score_table

AGAINST = {
    "enhanced": "the noise-free exposure", "enhanced_demosaiced": "the noise-free exposure, demosaiced",
    "linear": "the noise-free exposure in linear light",
    "linear_demosaiced": "the noise-free exposure in linear light, demosaiced", "lit": "the well-lit truth",
}  # fmt: skip


def _values(material: Material) -> dict[str, float | None]:
    if (found := leading(material)) is None:
        return dict.fromkeys(material.metrics["methods"])
    kind, number, _ = found
    return {name: m["mean"][kind].get(number, m["mean"][kind]["aligned_psnr"])
            for name, m in material.metrics["methods"].items()}  # fmt: skip


def _recovered(material: Material) -> dict[str, float]:
    found_by = leading(material)
    key = "recovered" if found_by is not None and found_by[0] == "enhanced" else "recovered_lit"
    found: dict[str, float] = material.metrics.get(key, {})
    return found


def verdict(material: Material) -> str:
    """One sentence with the outcome."""
    if (found := leading(material)) is None:
        return (
            "These photographs have no ground truth, so the renders are not scored: compare them with the dark "
            "pictures by eye. To get scores, give novags import --lit (the views in good light) or --clean (long "
            "exposures)."
        )
    value, best, floor = _values(material), leader(material), material.bound("floor")
    reached = value[best]
    if reached is None:
        return f"{best} has no score: the references show nothing but one colour, which any blank picture equals."
    rivals = sum(row.competes for row in material.rows.values())
    text = (
        f"{best} {'comes first with' if rivals > 1 else 'reaches'} {reached:.2f} dB on the held-out views ({found[2]})"
    )
    if floor is not None and best != floor and (other := value[floor]) is not None:
        gain = reached - other
        text += f", {abs(gain):.2f} dB {'more' if gain >= 0 else 'less'} than {floor}"
    fraction = _recovered(material).get(best)
    if fraction is not None and fraction > 0:
        text += f"; that wins back {fraction:.0%} of what noise costs here"
    if best != material.main and (ours := value[material.main]) is not None:
        text += f"; {material.main} reaches {ours:.2f} dB"
    return text + "." + _dissent(material, found[0], found[1], best)


def leader(material: Material) -> str:
    """The run with the best main score among those that see no truth; the main run where none has a score."""
    value = _values(material)
    scored = [name for name, row in material.rows.items() if row.competes and value[name] is not None]
    return max(scored, key=lambda name: value[name] or 0.0, default=material.main)


def compared(material: Material) -> tuple[str, str]:
    """Keys of what a page compares at first: the floor's picture, or else the noisy one, and that of the leader."""
    floor, best = material.bound("floor"), leader(material)
    before = "enhanced" if floor in (None, best) else f"render-{floor}"
    return before, f"render-{best}"


def _dissent(material: Material, kind: str, main_score: str, best: str) -> str:
    """Which other scores put another run first: the headline hides none that is worse for its own.

    Those in which the best run takes no place say nothing of it.
    """
    first: dict[tuple[str, str], list[str]] = {}
    for where, columns, rows in _tables(material, kind):
        for key, heading, *_ in columns:
            ranks = {row["method"]: cell["rank"] for row in rows for cell in row["cells"] if cell["key"] == key}
            marked = [name for name, rank in ranks.items() if rank == 1]
            if (where, key) != ("", main_score) and ranks.get(best) is not None and best not in marked:
                first.setdefault((where, marked[0]), []).append(heading)
    if not first:
        return ""
    said = (f"by {join(scores)}{where}: {name} comes first" for (where, name), scores in first.items())
    return f" Not so {'; '.join(said)}."


def _tables(material: Material, main: str) -> Iterator[tuple[str, Columns, list[dict[str, Any]]]]:
    """The tables of pictures and depth, that of the main reference first: against what, columns, rows."""
    competes = {name: row.competes for name, row in material.rows.items()}
    for kind in sorted(COLUMNS, key=lambda kind: kind != main):
        rows = score_table(material.metrics, kind, competes, placed_in(material, kind))
        yield "" if kind == main else f" against {AGAINST[kind]}", COLUMNS[kind], rows
    yield " against the true surfaces", GEOMETRY, geometry_table(material)


def cards(material: Material) -> list[dict[str, str]]:
    """The verdict in numbers: value, unit, label."""
    value, best = _values(material), leader(material)
    floor, ceiling = material.bound("floor"), material.bound("ceiling")
    reached, lowest, highest = (None if name is None else value[name] for name in (best, floor, ceiling))
    found = []
    if reached is not None:
        found.append({"value": f"{reached:.2f}", "unit": "dB", "label": f"{best}, held-out views"})
    if reached is not None and lowest is not None and best != floor:
        found.append({"value": signed(reached - lowest), "unit": "dB", "label": f"over {floor}"})
    if (fraction := _recovered(material).get(best)) is not None:
        share = f"{100 * fraction:.0f}".replace("-", "−")
        found.append({"value": share, "unit": "%", "label": "of the loss to noise recovered"})
    if highest is not None:
        found.append({"value": f"{highest:.2f}", "unit": "dB", "label": f"{ceiling}, the ceiling"})
    found.append({"value": duration(sum(row["seconds"] for row in costs(material))), "unit": "", "label": "in all"})
    return found
