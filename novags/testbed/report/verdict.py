"""The outcome in a sentence and in numbers: which run comes first, by how much, and which scores disagree."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from novags.testbed.console.terminal import Console
from novags.testbed.report.place import Place, places_in
from novags.testbed.report.tables import GIVEN, OWN, columns, is_plain, measured, ranked, scores_of
from novags.testbed.report.words import duration, join, signed

AGAINST = {
    "enhanced": "the noise-free exposure", "enhanced_demosaiced": "the noise-free exposure, demosaiced",
    "linear": "the noise-free exposure in linear light",
    "linear_demosaiced": "the noise-free exposure in linear light, demosaiced", "lit": "the well-lit truth",
    "geometry": "the true surfaces",
}  # fmt: skip


NO_GAIN = 0.3  # dB between the floor and the ceiling: less is what seeds and views differ by


def leading(place: Place) -> tuple[str, str, str] | None:
    """The reference that isolates noise where all runs have the same, else the lit one; its score; how to describe it.

    None where no reference is known that all runs have.
    """
    means = [method["mean"] for method in place.metrics["methods"].values()]
    own = all((mean.get("enhanced") or {}).get("aligned_psnr") is not None for mean in means)
    lit = all(mean.get("lit") is not None for mean in means)
    if own and (place.one_reference or not lit):
        return "enhanced", "aligned_psnr", "aligned PSNR against the noise-free exposure"
    if lit:
        return "lit", "tone_aligned_psnr", "tone-aligned PSNR against the well-lit truth"
    return None


def table_of(place: Place, kind: str) -> list[dict[str, Any]]:
    """The runs by the scores against a reference, or by "geometry" or "noise": what does not compare takes no place.

    Neither do scores against references of their own, nor plain ones of linear light, whose exposure the well-lit
    truth decides. The change of colour is in the code of a run's own enhancement, which is smaller the darker that is.
    """

    def placed(name: str, key: str) -> bool:
        if kind == "lit":
            return not is_plain(key) or name not in place.exposures
        own = kind in OWN or key == "consistency" or kind == "noise"
        return key not in GIVEN and (place.one_reference or not own)

    competes = {name: row.competes for name, row in place.rows.items()}
    return ranked(scores_of(place.metrics, kind), columns(kind), competes, placed)


def _values(place: Place) -> dict[str, float | None]:
    if (found := leading(place)) is None:
        return dict.fromkeys(place.metrics["methods"])
    kind, number, _ = found
    return {name: measured(m["mean"][kind].get(number, m["mean"][kind]["aligned_psnr"]))
            for name, m in place.metrics["methods"].items()}  # fmt: skip


def _recovered(place: Place) -> dict[str, float]:
    found_by = leading(place)
    key = "recovered" if found_by is not None and found_by[0] == "enhanced" else "recovered_lit"
    found: dict[str, float] = place.metrics.get(key, {})
    return found


def verdict(place: Place) -> str:
    """One sentence with the outcome."""
    if (found := leading(place)) is None:
        return (
            "These photographs have no ground truth, so the renders are not scored: compare them with the dark "
            "pictures by eye. To get scores, give novags import --lit (the views in good light) or --clean (long "
            "exposures)."
        )
    value, best, floor = _values(place), leader(place), place.bound("floor")
    reached = value[best]
    if reached is None:
        return f"{best} has no score: the references show nothing but one colour, which any blank picture equals."
    rivals = sum(row.competes for row in place.rows.values())
    text = (
        f"{best} {'comes first with' if rivals > 1 else 'reaches'} {reached:.2f} dB on the held-out views ({found[2]})"
    )
    if floor is not None and best != floor and (other := value[floor]) is not None:
        gain = reached - other
        text += f", {abs(gain):.2f} dB {'more' if gain >= 0 else 'less'} than {floor}"
    fraction = _recovered(place).get(best)
    if fraction is not None and fraction > 0:
        text += f"; that wins back {fraction:.0%} of what noise costs here"
    if best != place.main and (ours := value[place.main]) is not None:
        text += f"; {place.main} reaches {ours:.2f} dB"
    return text + "." + _dissent(place, found[0], found[1], best) + limits(place)


def limits(place: Place) -> str:
    """That the fit limits here and not the noise, where a method without noise wins no more than its error; else ""."""
    floor, ceiling, found = place.bound("floor"), place.bound("ceiling"), leading(place)
    if floor is None or ceiling is None or found is None:
        return ""
    values, (kind, number, _) = _values(place), found
    low, high = values[floor], values[ceiling]
    if low is None or high is None:
        return ""
    views = [place.metrics["methods"][name].get("views", {}) for name in (floor, ceiling)]
    pairs = [[view[kind][number] for view in (views[0][name], views[1][name])] for name in views[0] if name in views[1]]
    gains = [one - other for other, one in pairs if one is not None and other is not None]
    error = 2 * float(np.std(gains, ddof=1)) / np.sqrt(len(gains)) if len(gains) > 1 else 0.0
    if high - low > max(error, NO_GAIN):
        return ""
    gained = signed(high - low) + (f" ± {error:.2f}" if error else "")
    return (
        f" The fit limits here, not the noise: {ceiling}, which sees no noise, is {gained} dB from {floor}, so that no "
        "method can show its gain. Take cameras that are right, more views, points or iterations, or less light."
    )


def limits_so_far(runs: Sequence[Path]) -> str:
    """`limits` by the runs of one capture that are done."""
    return limits(*places_in(runs, Console(quiet=True))).strip()


def leader(place: Place) -> str:
    """The run with the best main score among the runs that see no truth; the main run where none has a score."""
    value = _values(place)
    scored = [name for name, row in place.rows.items() if row.competes and value[name] is not None]
    return max(scored, key=lambda name: value[name] or 0.0, default=place.main)


def compared(place: Place) -> tuple[str, str]:
    """Keys of the pictures that a page compares at first: the floor's, or else the noisy one, and the leader's."""
    floor, best = place.bound("floor"), leader(place)
    before = "enhanced" if floor in (None, best) else f"render-{floor}"
    return before, f"render-{best}"


def _dissent(place: Place, kind: str, main_score: str, best: str) -> str:
    """Which other scores put another run first: the headline hides none that is worse for its own.

    Scores in which the best run takes no place say nothing of it.
    """
    first: dict[tuple[str, str], list[str]] = {}
    for against in sorted(AGAINST, key=lambda other: other != kind):
        where, rows = "" if against == kind else f" against {AGAINST[against]}", table_of(place, against)
        for key, heading, *_ in columns(against):
            ranks = {row["method"]: cell["rank"] for row in rows for cell in row["cells"] if cell["key"] == key}
            marked = [name for name, rank in ranks.items() if rank == 1]
            if (where, key) != ("", main_score) and ranks.get(best) is not None and best not in marked:
                first.setdefault((where, marked[0]), []).append(heading)
    if not first:
        return ""
    said = (f"by {join(scores)}{where}: {name} comes first" for (where, name), scores in first.items())
    return f" Not so {'; '.join(said)}."


def cards(place: Place, seconds: float) -> list[dict[str, str]]:
    """The verdict in numbers: value, unit, label; and the seconds that all of it took."""
    value, best = _values(place), leader(place)
    floor, ceiling = place.bound("floor"), place.bound("ceiling")
    reached, lowest, highest = (None if name is None else value[name] for name in (best, floor, ceiling))
    found = []
    if reached is not None:
        found.append({"value": f"{reached:.2f}", "unit": "dB", "label": f"{best}, held-out views"})
    if reached is not None and lowest is not None and best != floor:
        found.append({"value": signed(reached - lowest), "unit": "dB", "label": f"over {floor}"})
    if (fraction := _recovered(place).get(best)) is not None:
        share = f"{100 * fraction:.0f}".replace("-", "−")
        found.append({"value": share, "unit": "%", "label": "of the loss to noise recovered"})
    if highest is not None:
        found.append({"value": f"{highest:.2f}", "unit": "dB", "label": f"{ceiling}, the ceiling"})
    found.append({"value": duration(seconds), "unit": "", "label": "in all"})
    return found
