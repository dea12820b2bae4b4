"""What a report states: sentences, tables and a chart, drawn from the records of an experiment or a run."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from novags.testbed.folders.run import METRICS, Run
from novags.testbed.ledger.contents import read_json
from novags.testbed.report.charts import line_chart
from novags.testbed.report.material import Material
from novags.testbed.report.rows import Row, deviations
from novags.testbed.report.tables import GEOMETRY, GIVEN, NOISE, OWN, PLAIN, Placed, ranked

SMALLEST = 1e-45  # a loss of 32 bits above 0
EXACT = 1e-4  # degrees or extents; camera files round, and smaller errors are invisible


def scene_name(material: Material) -> str:
    """Name of the scene, or of the folder of photographs."""
    return str(material.lit.views.meta.get("scene") or material.lit.views.path.name)


def title(material: Material) -> str:
    """The report's heading."""
    if (told := material.capture.record.simulated) is None:
        return f"{scene_name(material)}: photographs from the dark"
    return f"{scene_name(material)} at {told.electrons:g} electrons per pixel"


def what_was_done(material: Material) -> str:
    """One sentence: scene, camera, light, methods, time."""
    record = material.capture.record
    if (told := record.simulated) is None:
        return _what_was_imported(material)
    rendered = material.lit.views.kind == "rendered"
    lost = len(material.lit.views.unregistered)
    of = f" of {record.views + lost}" if lost else ""
    views = f"{record.views}{of} {'views' if rendered else 'photographs'} of {scene_name(material)}"
    total = sum(row["seconds"] for row in costs(material))
    return (
        f"{views} ({record.width} × {record.height} px) were {'rendered, ' if rendered else ''}"
        f"taken in the dark by a simulated {record.sensor_name} camera at {told.electrons:g} electrons per "
        f"green pixel, reconstructed by {join(list(material.runs))}, and scored on views that no method had seen; "
        f"all of it took {duration(total)}."
    )


def _what_was_imported(material: Material) -> str:
    record, scored = material.capture.record, leading(material) is not None
    size = f"{record.width} × {record.height} px"
    seen = "scored on views that no method had seen" if scored else "rendered from views that no method had seen"
    return (
        f"{record.views} dark photographs of {scene_name(material)} ({size}) were imported, reconstructed by "
        f"{join(list(material.runs))}, and {seen}; all of it took "
        f"{duration(sum(row['seconds'] for row in costs(material)))}."
    )


def photographs_text(material: Material) -> list[str]:
    """What imported photographs are, what is known of their camera, and where the truth comes from."""
    record, told = material.capture.record, material.capture.imported
    assert told is not None
    forms = [{"8bit": "8-bit", "16bit": "16-bit", "raw": "raw"}[told.depth]]
    if material.capture.holds("raw") and told.depth != "raw":
        forms.append("raw")
    name = record.sensor_name
    camera = f"The camera is {name}, as the import was told" if name else "The camera is not known"
    origins = {"camera": "known", "pictures": "estimated from the pictures"}
    noise = "not known" if (known := material.capture.noise) is None else origins[known.origin]
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


def leading(material: Material) -> tuple[str, str, str] | None:
    """The reference that isolates noise where all runs have the same, else the lit one; its score; how to describe it.

    None where no reference is known that all runs have.
    """
    means = [method["mean"] for method in material.metrics["methods"].values()]
    own = all((mean.get("enhanced") or {}).get("aligned_psnr") is not None for mean in means)
    lit = all(mean.get("lit") is not None for mean in means)
    if own and (material.one_reference or not lit):
        return "enhanced", "aligned_psnr", "aligned PSNR against the noise-free exposure"
    if lit:
        return "lit", "tone_aligned_psnr", "tone-aligned PSNR against the well-lit truth"
    return None


def placed_in(material: Material, kind: str) -> Placed:
    """Which run takes a place by which score against a reference: what does not compare takes none."""
    if kind in OWN:
        return lambda name, key: material.one_reference
    if kind == "lit":
        return lambda name, key: key not in PLAIN or name not in material.exposures
    return lambda name, key: True


def geometry_table(material: Material) -> list[dict[str, Any]]:
    """Depth scores of each run; empty where the true depth is not known."""
    found = {name: m["geometry"] for name, m in material.metrics["methods"].items() if m.get("geometry")}
    flat = {name: {**scores, "consistency": scores["consistency"]["excess"]} for name, scores in found.items()}
    competes = {name: row.competes for name, row in material.rows.items()}
    # The change of colour is in the code of a run's own enhancement, which is smaller the darker that is.
    return ranked(flat, GEOMETRY, competes, lambda name, key: key != "consistency" or material.one_reference)


def noise_table(material: Material) -> list[dict[str, Any]]:
    """What is left of the known noise in each run; empty where it is not known."""
    found = {name: m["noise"] for name, m in material.metrics["methods"].items() if m.get("noise")}
    competes = {name: row.competes for name, row in material.rows.items()}
    return ranked(found, NOISE, competes, lambda name, key: material.one_reference and key not in GIVEN)


def camera_table(material: Material) -> list[dict[str, Any]]:
    """Where each run's cameras came from and how far off they are; empty where all were exact."""
    rows = []
    for name, run in material.runs.items():
        cameras = run.record.get("cameras")
        if cameras and (
            cameras["unregistered"] or max(cameras["mean_rotation_deg"], cameras["mean_centre_error"]) > EXACT
        ):
            rows.append({"method": name, **cameras})
    return rows


def departures(material: Material) -> dict[str, list[Any]]:
    """The settings in which each run differs from its method as published."""
    return {name: found for name, run in material.runs.items() if (found := deviations(run))}


def training_table(material: Material) -> list[dict[str, Any]]:
    """2D scores of the training images of the main method, best last."""
    scores = material.metrics["methods"][material.main]["training_2d"]
    if scores is None:
        return []
    labels = {"enhanced": "enhanced, not denoised", "blur": f"Gaussian blur, sigma {scores['blur']['sigma']:.1f} px"}
    if "best_blur" in scores:  # not where nothing can be aligned
        sigma = scores["best_blur"]["sigma"]
        labels["best_blur"] = f"Gaussian blur, the best sigma for these images ({sigma:.1f} px)"
    labels["denoised"] = f"denoised by {material.main}"
    return [{"label": label, "key": key, **scores[key]} for key, label in labels.items() if key in scores]


def loss_chart(runs: Mapping[str, Run], rows: Mapping[str, Row]) -> dict[str, Any] | None:
    """Photometric loss over the iterations, one line for each run, and what stands for which; None without a log.

    The fits of a run stand one after the other, with a gap between them: each has targets of its own.
    """
    series = {}
    for name, run in runs.items():
        points = [(e["iteration"], _drawn(e["photometric"])) for e in run.events() if "photometric" in e]
        series[name] = [point for fit in fits(points) for point in ((fit[0][0], math.nan), *smoothed(fit))]
    if not any(loss > 0 for points in series.values() for _, loss in points):
        return None
    keys = {name: row.key for name, row in rows.items()}
    series = {name: points for name, points in series.items() if points}
    chart = line_chart(
        series, keys, x_label="iteration", y_label="photometric loss", title="Photometric loss over iterations"
    )
    return {"chart": chart, "key": [(name, keys[name]) for name in series]}


def _drawn(loss: float | str | None) -> float:
    """A loss as it is drawn: a gap where there is none above 0, or it was not finite, which is text in JSON."""
    return loss if isinstance(loss, int | float) and loss >= SMALLEST else math.nan


def fits(points: Sequence[tuple[float, float]]) -> list[list[tuple[float, float]]]:
    """The losses of each fit of a run, over the iterations of all of them: where the count falls back, a fit begins."""
    found: list[list[tuple[float, float]]] = []
    before = last = 0.0
    for iteration, loss in points:
        if not found or iteration <= last:
            before, found = before + last, [*found, []]
        last = iteration
        found[-1].append((before + iteration, loss))
    return found


def smoothed(points: list[tuple[float, float]], count: int = 50) -> list[tuple[float, float]]:
    """Means of consecutive groups, at most `count` of them: single views scatter, and files should stay small."""
    group = max(1, -(-len(points) // count))
    groups = [points[k : k + group] for k in range(0, len(points), group)]
    return [(g[-1][0], sum(y for _, y in g) / len(g)) for g in groups]


def costs(material: Material) -> list[dict[str, Any]]:
    """Seconds and peak memory of every stage, in order, with the parts of each reconstruction.

    `share` is of the time of all stages, `bar` of the longest one's.
    """
    stages: list[tuple[str, str, Mapping[str, Any], dict[str, float]]] = []
    if (made := material.lit.views.meta.get("stage")) is not None:
        stages.append((made.get("name", "render"), "", made, {}))
    stages.append(("import" if material.capture.imported else "capture", "", material.capture.record.stage, {}))
    for name, run in material.runs.items():
        key = material.rows[name].key
        spent = {**run.record["stage"], "peak_bytes": run.peak_bytes}
        stages.append((f"reconstruct: {name}", key, spent, run.record["seconds"]))
    scored = [read_json(run.path / METRICS)["stage"] for run in material.runs.values() if (run.path / METRICS).exists()]
    if scored:
        total = {"seconds": sum(s["seconds"] for s in scored), "peak_bytes": max(s["peak_bytes"] for s in scored)}
        stages.append(("score", "", total, {}))
    rows = [
        {"label": label, "method": method, "seconds": stage["seconds"], "peak": stage["peak_bytes"], "parts": parts}
        for label, method, stage, parts in stages
    ]
    seconds = [row["seconds"] for row in rows]
    whole, longest = sum(seconds) or 1.0, max(seconds) or 1.0
    return [{**row, "share": row["seconds"] / whole, "bar": row["seconds"] / longest} for row in rows]


def plans(material: Material) -> list[dict[str, Any]]:
    """The plan tables: light transport (rendered sets) and sensor."""
    found = []
    meta = material.lit.views.meta  # also of a capture, which can be photographed again
    if material.lit.views.kind == "rendered" and (transport := meta.get("plan")) is not None:
        table = plan_table(transport)
        table["saved"] = f"{time_saved(transport['seconds'])} {render_quality(meta)}".strip()
        found.append({"heading": "Light transport", "plan": table})
    if (told := material.capture.record.simulated) is not None and told.plan is not None:
        found.append({"heading": "Sensor", "plan": plan_table(told.plan)})
    return found


def plan_table(plan: dict[str, Any]) -> dict[str, Any]:
    """The effects that matter here, the names of those that cannot (nothing to leave out), and what was left out."""
    matters = [e for e in plan["effects"] if e["on"] or e["forced"] or e["contribution"] != 0]
    absent = [e["name"].replace("_", " ") for e in plan["effects"] if e not in matters]
    bounds = {plan["unit"]: plan["bound"], **plan.get("biases", {})}
    costs = [f"{number(b, 4)} ({unit})" for unit, b in bounds.items()]
    return {"shown": matters, "absent": absent, "costs": costs}


def time_saved(seconds: dict[str, float]) -> str:
    """What a plan saved, where that was measured: seconds "planned" and with "everything on"."""
    if not seconds:
        return "The time that the plan saves was not measured for so short a render; novags plan measures it."
    planned, everything = seconds["planned"], seconds["everything on"]
    return (
        f"A million samples took {planned:.3g} s of processor time with this plan, and {everything:.3g} s with "
        f"everything simulated: {everything / planned:.2g} times as long."
    )


def render_quality(meta: dict[str, Any]) -> str:
    """The noise that is left in the truth, and the pixels that are spoilt by rare bright paths."""
    views = meta["views"].values()
    noise, fireflies = max(view["relative_error"] for view in views), sum(view["fireflies"] for view in views)
    share = fireflies / (len(views) * meta["width"] * meta["height"])
    return (
        f"The renders' own noise is at most {noise:.1%} of a view's mean light (RMSE); {fireflies} pixels "
        f"({share:.2%}) are fireflies: their samples scatter far more than their neighbours'."
    )


def configurations(material: Material) -> dict[str, str]:
    """Every record's resolved configuration as indented JSON."""
    taken = "import" if material.capture.imported else "capture"
    records: dict[str, Any] = {taken: material.capture.record.stage["config"]}
    if (made := material.lit.views.meta.get("stage")) is not None:
        records = {made.get("name", "render"): made["config"], **records}
    for name, run in material.runs.items():
        records[f"reconstruct: {name}"] = run.record["config"]
    return {name: json.dumps(config, indent=2) for name, config in records.items()}


def join(words: list[str]) -> str:
    """'a', 'a and b', 'a, b and c'."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def number(value: float | str | None, digits: int = 2) -> str:
    """A number for a table; None becomes 'unavailable'."""
    if value is None:
        return "unavailable"
    if isinstance(value, str):
        return value
    shown = f"{value:.{digits}f}"
    return shown.removeprefix("-") if not float(shown) else shown  # no "-0.00"


def signed(value: float) -> str:
    """A number with its sign, with a true minus sign."""
    return f"{value:+.2f}".replace("-", "−")


def duration(seconds: float) -> str:
    """A duration in readable units."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def size(count: int) -> str:
    """Bytes in MB or GB."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"
