"""Lists of all that is available, as text."""

import textwrap
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sensor_model.files.registry import Registry

WIDTH = 110


def listing(what: str = "all") -> str:
    """One list, or all of them.

    Raises:
        ValueError: If there is no such list.
    """
    if what != "all" and what not in LISTS:
        raise ValueError(f"no list of {what!r}; available: {', '.join(LISTS)}")
    chosen = LISTS if what == "all" else {what: LISTS[what]}
    return "\n\n".join(f"{name.capitalize()}\n{make()}" for name, make in chosen.items())


def table(rows: Iterable[tuple[str, str]]) -> str:
    """Name and text in two columns, the text wrapped."""
    listed = list(rows)
    column = 2 + max(len(name) for name, _ in listed)
    return "\n".join(
        textwrap.fill(text, WIDTH, initial_indent=f"  {name:<{column}}", subsequent_indent=" " * (column + 2))
        for name, text in listed
    )


def scenes() -> str:
    """The catalogue of scenes with the purpose of each."""
    from simscenes.scenes import SCENES

    rows = [(name, f"{first_sentence(scene.text)}{_from(SCENES, name)}") for name, scene in SCENES.items()]
    rows.append(("NAME:SEED", "a variation of a scene, such as tabletop:3"))
    rows.append(("FILE.xml", "any Mitsuba 3 scene"))
    rows.append(("FILE.glb", "any glTF 2.0 scene, also .gltf"))
    pictures = Path(__file__).resolve().parents[3] / "docs" / "scenes.png"
    return table(rows) + (f"\n  pictures of them: {pictures}" if pictures.exists() else "")


def sensors() -> str:
    """The cameras."""
    from sensor_model.presets import PRESETS, SOURCES

    rows = []
    for name, sensor in PRESETS.items():
        colours = f"{sensor.cfa} mosaic" if sensor.cfa else "all colours in every pixel"
        efficiency = f"quantum efficiency {100 * sensor.eta:.0f} % ({SOURCES[name]['eta']})"
        rows.append((name, f"{sensor.bits} bit, read noise {sensor.sigma_d:.3g} e-, {efficiency}, {colours}"))
    return table([*rows, ("FILE.toml", "a camera of your own; novags characterise measures one")])


def methods() -> str:
    """Methods, then the named variants of them."""
    from novags.methods import METHODS, VARIANTS, title_of

    rows = [(name, f"[{method.family}] {title_of(name)}. After: {method.source}") for name, method in METHODS.items()]
    rows += [(name, f"[variant of {variant.method}] {variant.title}") for name, variant in VARIANTS.items()]
    return f"{table(rows)}\n  more: --variant NAME=METHOD:SETTING=VALUE,..., see novags help variants"


def levels() -> str:
    """The light levels with their cameras."""
    from novags.testbed.study.cells.levels import LEVELS

    rows = [(name, f"{level.title}: {level.sensor} at {level.electrons:g} electrons, pictures of "
             f"{level.pictures.removesuffix('bit')} bits") for name, level in LEVELS.items()]  # fmt: skip
    return table(rows)


def presets() -> str:
    """The presets with their sizes."""
    from novags.methods import METHODS
    from novags.testbed.study.cells.presets import EXPERIMENTS

    rows = []
    for name, preset in EXPERIMENTS.items():
        render, capture = preset.render, preset.capture
        config = preset.reconstruct(preset.methods[0])
        iterations, published = config.config.fit.iterations, METHODS[config.variant.method].config().fit.iterations
        length = f"{iterations} iterations" if iterations == published else f"{iterations} of {published} iterations"
        rows.append((
            name,
            f"{render.scene}, {render.n_views} views of {render.width} x {render.height}, {capture.sensor} at "
            f"{capture.electrons:g} electrons, {length}; {', '.join(preset.methods)}",
        ))  # fmt: skip
    return table(rows)


def cameras() -> str:
    """Where cameras can come from."""
    from novags.cameras import SOURCES

    return table([(name, f"{source.description}{_from(SOURCES, name)}") for name, source in SOURCES.items()])


def enhancers() -> str:
    """Enhancers of dark pictures."""
    from novags.methods.enhancers import ENHANCERS

    return table([(name, f"{enhancer.title}{_from(ENHANCERS, name)}") for name, enhancer in ENHANCERS.items()])


def metrics() -> str:
    """What rendered pictures are scored by; scores of depth, noise and cameras come beside them."""
    from novags.testbed.metrics import METRICS

    better = {True: "more is better", False: "less is better"}
    after = {"none": "", "affine": ", after a gain and an offset per channel",
             "tone": ", after a monotone curve per channel"}  # fmt: skip
    return table([(name, f"{row.heading}{f', {row.unit}' * bool(row.unit)}{after[row.aligned]}: {better[row.more]}"
                   f"{_from(METRICS, name)}") for name, row in METRICS.items()])  # fmt: skip


def effects() -> str:
    """Effects of the camera; of ours the fields of a camera that set them."""
    from sensor_model.effect_list import EFFECT_LIST, OwnEffect

    rows = []
    for name, row in EFFECT_LIST.items():
        if isinstance(row, OwnEffect):
            rows.append((name, f"[effects.{name}] {row.title}{_from(EFFECT_LIST, name)}"))
        else:
            rows.append((name, f"set by {', '.join(row.fields)} of a camera" if row.fields else "of every exposure"))
    return table(rows)


def _from(rows: "Registry[Any]", name: str) -> str:
    """Where a row from outside comes from."""
    origin = rows.origin_of(name)
    return "" if origin is None else f" (from {origin})"


def first_sentence(text: str | None) -> str:
    """The first sentence of a docstring, on one line."""
    return " ".join((text or "").split()).split(". ")[0].rstrip(".")


LISTS: dict[str, Callable[[], str]] = {
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
