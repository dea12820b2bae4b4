"""The outcome in a sentence: which run comes first, by how much, and which scores disagree."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console
from novags.testbed.metrics.differences import Estimate, Values, difference, order
from novags.testbed.report.place import Place, places_in
from novags.testbed.report.tables import GIVEN, OWN, columns, is_plain, measured, ranked, scores_of
from novags.testbed.report.words import join, share, signed
from novags.testbed.stages.scores.comparing import gains, values_of

AGAINST = {
    "enhanced": "the noise-free exposure", "enhanced_demosaiced": "the noise-free exposure, demosaiced",
    "linear": "the noise-free exposure in linear light",
    "linear_demosaiced": "the noise-free exposure in linear light, demosaiced", "lit": "the well-lit truth",
    "geometry": "the true surfaces",
}  # fmt: skip


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

    def several(name: str, key: str) -> Values:
        return values_of(place.metrics["methods"][name], kind, key)

    competes = {name: row.competes for name, row in place.rows.items()}
    return ranked(scores_of(place.metrics, kind), columns(kind), competes, placed, several)


def _values(place: Place) -> dict[str, float | None]:
    if (found := leading(place)) is None:
        return dict.fromkeys(place.metrics["methods"])
    kind, number, _ = found
    return {name: measured(m["mean"][kind].get(number, m["mean"][kind]["aligned_psnr"]))
            for name, m in place.metrics["methods"].items()}  # fmt: skip


def _recovered(place: Place) -> dict[str, Estimate]:
    found_by = leading(place)
    key = "recovered" if found_by is not None and found_by[0] == "enhanced" else "recovered_lit"
    found: dict[str, Estimate] = place.metrics.get(key, {})
    return found


def _above(place: Place, name: str, other: str) -> Estimate | None:
    """How far a run is above another in the main score."""
    if (found := leading(place)) is None:
        return None
    one, base = (values_of(place.metrics["methods"][each], *found[:2]) for each in (name, other))
    return difference(one, base)


def first(place: Place) -> list[str]:
    """The runs that see no truth and that none is seen to be above by the main score, the largest first."""
    if (found := leading(place)) is None:
        return []
    cells = {row["method"]: row["cells"][0] for row in table_of(place, found[0])}
    return [name for name, cell in cells.items() if cell["rank"] == 1]


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
    alike = first(place)
    if sum(row.competes for row in place.rows.values()) < 2 or not alike:
        text = f"{best} reaches {reached:.2f} dB on the held-out views ({found[2]})"
    elif len(alike) > 1:
        low = min(value[name] or 0.0 for name in alike)
        text = (
            f"No difference is seen between {join(alike)}: {low:.2f} to {reached:.2f} dB on the held-out views "
            f"({found[2]}), which views and seeds may make"
        )
    else:
        text = f"{best} comes first with {reached:.2f} dB on the held-out views ({found[2]})"
    if floor is not None and floor not in (best, *alike) and (gain := _above(place, best, floor)) is not None:
        text += f", {_by(gain, floor)}"
    fraction = _recovered(place).get(best)
    if fraction is not None and fraction.value > 0:
        text += f"; that wins back {share(fraction.value, fraction.error)} of what noise costs here"
    if place.main not in (best, *alike) and (ours := value[place.main]) is not None:
        text += f"; {place.main} reaches {ours:.2f} dB"
    return text + "." + _dissent(place, found[0], found[1], best) + limits(place)


def _by(gain: Estimate, other: str) -> str:
    """A gain over another run, with its error; or that none is seen."""
    error = "" if gain.error is None else f" ± {gain.error:.2f}"
    if gain.error is not None and not gain.seen:
        return f"not seen to differ from {other} ({signed(gain.value)}{error} dB; {gain.where})"
    return f"{abs(gain.value):.2f}{error} dB {'more' if gain.value >= 0 else 'less'} than {other} ({gain.where})"


def limits(place: Place) -> str:
    """That the fit limits here and not the noise, where a method without noise wins no more than other rates would; or
    that the views cannot tell; else "".
    """
    floor, ceiling, found = place.bound("floor"), place.bound("ceiling"), leading(place)
    if floor is None or ceiling is None or found is None:
        return ""
    if (span := _above(place, ceiling, floor)) is None or (gain := gains(span)):
        return ""
    error = "" if span.error is None else f" ± {span.error:.2f}"
    told = f"{ceiling}, which sees no noise, is {signed(span.value)}{error} dB from {floor} ({span.where})"
    if gain is None:
        return f" Whether noise or the fit limits is not known: {told}. More held-out views or seeds would tell."
    return (
        f" The fit limits here, not the noise: {told}, so that no method can show its gain. Take cameras that are "
        "right, more views, points or iterations, or less light."
    )


def limits_so_far(runs: Sequence[Path]) -> str:
    """`limits` by the runs of one capture that are done."""
    return limits(*places_in(runs, Console(quiet=True))).strip()


def leader(place: Place) -> str:
    """The run with the best main score among the runs that see no truth; the main run where none has a score."""
    value = _values(place)
    scored = [name for name, row in place.rows.items() if row.competes and value[name] is not None]
    if (found := leading(place)) is None or not scored:
        return place.main
    kind, number, _ = found
    return order({name: values_of(place.metrics["methods"][name], kind, number) for name in scored}, True)[0]


def compared(place: Place) -> tuple[str, str]:
    """Keys of the pictures that a page compares at first: the floor's, or else the noisy one, and the leader's."""
    floor, best = place.bound("floor"), leader(place)
    before = "enhanced" if floor in (None, best) else f"render-{floor}"
    return before, f"render-{best}"


def _dissent(place: Place, kind: str, main_score: str, best: str) -> str:
    """Which other scores put another run first: the headline hides none that is worse for its own.

    Scores in which the best run takes no place say nothing of it.
    """
    leads: dict[tuple[str, str], list[str]] = {}
    for against in sorted(AGAINST, key=lambda other: other != kind):
        where, rows = "" if against == kind else f" against {AGAINST[against]}", table_of(place, against)
        for key, heading, *_ in columns(against):
            ranks = {row["method"]: cell["rank"] for row in rows for cell in row["cells"] if cell["key"] == key}
            marked = [name for name, rank in ranks.items() if rank == 1]
            if (where, key) != ("", main_score) and ranks.get(best) is not None and best not in marked:
                one = len(marked) == 1
                who = f"{join(marked)} come{'s' * one} first{', not seen to differ' * (not one)}"
                leads.setdefault((where, who), []).append(heading)
    if not leads:
        return ""
    said = (f"by {join(scores)}{where}: {who}" for (where, who), scores in leads.items())
    return f" Not so {'; '.join(said)}."
