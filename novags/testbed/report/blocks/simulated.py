"""Simulated and omitted effects; of photographs where they come from."""

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from novags.testbed.folders.photographs.linear import LinearPhotographs
from novags.testbed.report.material import Material, Place
from novags.testbed.report.parts import Page, Table, TableRow, heads, num
from novags.testbed.report.words import join, number

FORMS = {"8bit": "8-bit", "16bit": "16-bit", "raw": "raw"}
ORIGINS = {"camera": "known", "pictures": "estimated from the pictures"}


def simulated(material: Material, page: Page) -> dict[str, Any] | None:
    """The camera of one place, and the effects of all."""
    place, plans = material.one, effects(material)
    missing = [
        f"No camera was found for {len(names)} of {count + len(names)} photographs{f' of {name}' if name else ''}, "
        f"which are left out: {', '.join(names)}."
        for name, (names, count) in material.unregistered.items()
    ]
    found: dict[str, Any] = {
        "photographs": None,
        "missing": missing,
        "plans": plans,
        "record": None,
        "kind": None,
        "linear": False,
    }
    if place:
        found |= {"record": place.capture.record, "kind": place.lit.views.kind,
                  "linear": isinstance(place.lit.views, LinearPhotographs),
                  "photographs": photographs_text(place) if place.capture.imported else None}  # fmt: skip
    return found if place or plans or missing else None


def photographs_text(place: Place) -> list[str]:
    """The kind of imported photographs, their camera, and where the truth comes from."""
    record, told, name = place.capture.record, place.capture.imported, place.capture.record.sensor_name
    assert told is not None
    forms = [FORMS[told.depth], *(["raw"] if place.capture.holds("raw") and told.depth != "raw" else [])]
    camera = f"The camera is {name}, as the import was told" if name else "The camera is not known"
    noise = "not known" if (known := place.capture.noise) is None else ORIGINS[known.origin]
    found = [f"Nothing was simulated: these are {join(forms)} photographs. {camera}, and its noise is {noise}."]
    if record.resampled:
        found.append(f"Of their pixels {record.resampled}.")
    if (lit := told.lit) is not None:
        found.append(f"The views in good light are the pictures of {lit['folder']}, paired by their {lit['paired']}.")
    if (clean := told.clean) is not None:
        found.append(
            f"The noise-free exposures are the long exposures of {clean['folder']}, times {clean['gain']:.4g} for all "
            f"views; what noise they have is in the reference, and {clean['white_share']:.2%} of them is white."
        )
    return found


def effects(material: Material) -> list[dict[str, Any]]:
    """The plans of light transport and of the sensor: the table of their effects, and their cost."""
    found, made = [], material.made.values()
    for heading, records in (("Light transport", {each.set: each.rendered for each in made}),
                             ("Sensor", {each.capture: each.captured for each in made})):  # fmt: skip
        if plans := [plan for record in records.values() if (plan := record.get("plan"))]:
            told = _told(plans)
            if heading == "Light transport" and material.one:
                told += f" {time_saved(plans[0]['seconds'])} {render_quality(material.one.lit.views.meta)}"
            found.append({"heading": heading, "table": _effects(heading, plans), "told": told})
    return found


def _effects(heading: str, plans: Sequence[Mapping[str, Any]]) -> Table:
    """The effects that matter in some plan: how often each is simulated, and what leaving it out costs at most."""
    rows = []
    for name, found in _by_name(plans).items():
        if not any(map(_matters, found)):
            continue
        on = sum(effect["on"] for effect in found)
        said = ("yes" if on else "no") if len(found) == 1 else f"{on} of {len(found)}"
        badge = Markup('<span class="badge {}">{}</span>{}').format(
            "on" if on else "off", said, " (forced)" if any(effect["forced"] for effect in found) else "")  # fmt: skip
        left = [effect for effect in found if not effect["on"]] or found
        cost, bound = (_most([effect[key] for effect in left]) for key in ("contribution", "bound"))
        reasons = dict.fromkeys(effect["reason"] for effect in found)
        rows.append(TableRow([name.replace("_", " "), badge, num(cost, 4), num(bound, 4), found[0]["unit"],
                              next(iter(reasons)) if len(reasons) == 1 else ""]))  # fmt: skip
    at_most = " at most" if len(plans) > 1 else ""
    columns = heads(f"Effect | Simulated | #Leaving it out costs{at_most} | #Allowed | Unit | Why")
    return Table(f"effects-{heading}", f"{heading}: effects and what leaving them out costs", columns, rows, "reasons")


def _by_name(plans: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    found: dict[str, list[Mapping[str, Any]]] = {}
    for effect in (effect for plan in plans for effect in plan["effects"]):
        found.setdefault(effect["name"], []).append(effect)
    return found


def _matters(effect: Mapping[str, Any]) -> bool:
    return bool(effect["on"] or effect["forced"] or effect["contribution"] != 0)


def _most(values: Sequence[Any]) -> Any:
    """The largest number; the first value where none is a number."""
    return max((value for value in values if isinstance(value, float | int)), default=values[0])


def _told(plans: Sequence[Mapping[str, Any]]) -> str:
    """Which effects cannot matter, and the cost of all omitted ones at most."""
    absent = [name.replace("_", " ") for name, found in _by_name(plans).items() if not any(map(_matters, found))]
    bounds: dict[str, list[Any]] = {}
    for plan in plans:
        for unit, bound in {plan["unit"]: plan["bound"], **plan.get("biases", {})}.items():
            bounds.setdefault(unit, []).append(bound)
    costs = ", ".join(f"{number(_most(found), 4)} ({unit})" for unit, found in bounds.items())
    without = f"Without effect here: {', '.join(absent)}. " if absent else ""
    return f"{without}Everything that was left out costs at most {costs}."


def time_saved(seconds: Mapping[str, float]) -> str:
    """What a plan saved, where that was measured: seconds "planned" and with "everything on"."""
    if not seconds:
        return "The time that the plan saves was not measured for so short a render; novags plan measures it."
    planned, everything = seconds["planned"], seconds["everything on"]
    return (
        f"A million samples took {planned:.3g} s of processor time with this plan, and {everything:.3g} s with "
        f"everything simulated: {everything / planned:.2g} times as long."
    )


def render_quality(meta: Mapping[str, Any]) -> str:
    """The noise that is left in the truth, and the pixels that are spoilt by rare bright paths."""
    views = meta["views"].values()
    noise, fireflies = max(view["relative_error"] for view in views), sum(view["fireflies"] for view in views)
    share = fireflies / (len(views) * meta["width"] * meta["height"])
    return (
        f"The renders' own noise is at most {noise:.1%} of a view's mean light (RMSE); {fireflies} pixels "
        f"({share:.2%}) are fireflies: their samples scatter far more than their neighbours'."
    )
