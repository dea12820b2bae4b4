"""Lists of all that is available, as text or as JSON."""

import json
import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sensor_model.files.reading import meant

if TYPE_CHECKING:
    from sensor_model.files.registry import Registry

WIDTH = 110


def listing(what: str = "all", as_json: bool = False) -> str:
    """One list, or all of them; as JSON by the names of lists and of their rows.

    Raises:
        ValueError: If there is no such list.
    """
    if what != "all" and what not in LISTS:
        raise ValueError(f"no list of {what!r}; {meant(what, LISTS)}available: {', '.join(LISTS)}")
    chosen = {name: make() for name, make in LISTS.items() if what in ("all", name)}
    if as_json:
        return json.dumps(chosen, indent=1, ensure_ascii=False)
    return "\n\n".join(f"{name.capitalize()}\n{table(rows | FORMS.get(name, {}))}{more(name)}"
                       for name, rows in chosen.items())  # fmt: skip


def table(rows: Mapping[str, str]) -> str:
    """Name and text in two columns, the text wrapped."""
    column = 2 + max(len(name) for name in rows)
    return "\n".join(
        textwrap.fill(text, WIDTH, initial_indent=f"  {name:<{column}}", subsequent_indent=" " * (column + 2))
        for name, text in rows.items()
    )


def more(name: str) -> str:
    """A line below a list."""
    pictures = Path(__file__).resolve().parents[3] / "docs" / "scenes.png"
    if name == "scenes" and pictures.exists():
        return f"\n  pictures of them: {pictures}"
    if name == "methods":
        return "\n  more: --variant NAME=METHOD:SETTING=VALUE,..., see novags help variants"
    return ""


def scenes() -> dict[str, str]:
    """The catalogue of scenes with the purpose of each."""
    from simscenes.scenes import SCENES

    return {name: f"{first_sentence(scene.text)}{_from(SCENES, name)}" for name, scene in SCENES.items()}


def sensors() -> dict[str, str]:
    """The cameras."""
    from sensor_model.presets import PRESETS, SOURCES

    rows = {}
    for name, sensor in PRESETS.items():
        colours = f"{sensor.cfa} mosaic" if sensor.cfa else "all colours in every pixel"
        efficiency = f"quantum efficiency {100 * sensor.eta:.0f} % ({SOURCES[name]['eta']})"
        rows[name] = f"{sensor.bits} bit, read noise {sensor.sigma_d:.3g} e-, {efficiency}, {colours}"
    return rows


def methods() -> dict[str, str]:
    """Methods, then the named variants of them."""
    from novags.methods import METHODS, VARIANTS, title_of

    rows = {name: f"[{method.family}] {title_of(name)}. After: {method.source}" for name, method in METHODS.items()}
    return rows | {name: f"[variant of {variant.method}] {variant.title}" for name, variant in VARIANTS.items()}


def levels() -> dict[str, str]:
    """The light levels with their cameras."""
    from novags.testbed.study.cells.levels import LEVELS

    return {name: f"{level.title}: {level.sensor} at {level.electrons:g} electrons, pictures of "
                  f"{level.pictures.removesuffix('bit')} bits" for name, level in LEVELS.items()}  # fmt: skip


def presets() -> dict[str, str]:
    """The presets with their sizes."""
    from novags.methods import METHODS
    from novags.testbed.study.cells.presets import EXPERIMENTS

    rows = {}
    for name, preset in EXPERIMENTS.items():
        render, capture = preset.render, preset.capture
        config = preset.reconstruct(preset.methods[0])
        iterations, published = config.config.fit.iterations, METHODS[config.variant.method].config().fit.iterations
        length = f"{iterations} iterations" if iterations == published else f"{iterations} of {published} iterations"
        rows[name] = (
            f"{render.scene}, {render.n_views} views of {render.width} x {render.height}, {capture.sensor} at "
            f"{capture.electrons:g} electrons, {length}; {', '.join(preset.methods)}"
        )
    return rows


def cameras() -> dict[str, str]:
    """Where cameras can come from."""
    from novags.cameras import SOURCES

    return {name: f"{source.description}{_from(SOURCES, name)}" for name, source in SOURCES.items()}


def enhancers() -> dict[str, str]:
    """Enhancers of dark pictures."""
    from novags.methods.enhancers import ENHANCERS

    return {name: f"{enhancer.title}{_from(ENHANCERS, name)}" for name, enhancer in ENHANCERS.items()}


def metrics() -> dict[str, str]:
    """What rendered pictures are scored by; scores of depth, noise and cameras come beside them."""
    from novags.testbed.metrics import METRICS

    better = {True: "more is better", False: "less is better"}
    after = {"none": "", "affine": ", after a gain and an offset per channel",
             "tone": ", after a monotone curve per channel"}  # fmt: skip
    return {name: f"{row.heading}{f', {row.unit}' * bool(row.unit)}{after[row.aligned]}: {better[row.more]}"
                  f"{f' (of {row.protocol} alone)' * bool(row.protocol)}{_from(METRICS, name)}"
            for name, row in METRICS.items()}  # fmt: skip


def effects() -> dict[str, str]:
    """Effects of the camera; of ours the fields of a camera that set them."""
    from sensor_model.effect_list import EFFECT_LIST, OwnEffect

    rows = {}
    for name, row in EFFECT_LIST.items():
        if isinstance(row, OwnEffect):
            rows[name] = f"[effects.{name}] {row.title}{_from(EFFECT_LIST, name)}"
        else:
            rows[name] = f"set by {', '.join(row.fields)} of a camera" if row.fields else "of every exposure"
    return rows


def _from(rows: "Registry[Any]", name: str) -> str:
    """Where a row from outside comes from."""
    origin = rows.origin_of(name)
    return "" if origin is None else f" (from {origin})"


def first_sentence(text: str | None) -> str:
    """The first sentence of a docstring, on one line."""
    return " ".join((text or "").split()).split(". ")[0].rstrip(".")


# Rows without a name of their own, which stand for many.
FORMS = {
    "scenes": {
        "NAME:SEED": "a variation of a scene, such as tabletop:3", "FILE.xml": "any Mitsuba 3 scene",
        "FILE.glb": "any glTF 2.0 scene, also .gltf",
    },
    "sensors": {"FILE.toml": "a camera of your own; novags characterise measures one"},
}  # fmt: skip
LISTS: dict[str, Callable[[], dict[str, str]]] = {
    "scenes": scenes,
    "sensors": sensors,
    "methods": methods,
    "levels": levels,
    "presets": presets,
    "cameras": cameras,
    "enhancers": enhancers,
    "metrics": metrics,
    "effects": effects,
}
