"""The integrator that a scene brings along: the settings that our renders keep, and the others."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

PATHS = ("path", "volpath", "volpathmis", "direct")  # the plan chooses among these itself
AROUND = ("aov", "moment", "stokes")  # each holds another integrator and adds channels to its picture
OTHERS = ("depth", "ptracer", "prb", "prb_basic", "prbvolpath", "prb_projective", "direct_projective",
          "volprim_rf_basic")  # fmt: skip
COUNTS = ("emitter_samples", "bsdf_samples", "shading_samples")  # of `direct`
ENDLESS = 1000  # a limit on paths beyond this counts as none
KEPT = ("max_depth", "rr_depth", "hide_emitters")


@dataclass(frozen=True)
class OwnIntegrator:
    """The settings of a scene's own integrator.

    Attributes:
        kind: Its type.
        max_depth: Longest path, as Mitsuba counts; None where it sets no end.
        rr_depth: Path length from which Russian roulette may end a path; None where it does not say.
        hide_emitters: Whether cameras look through lamps, and skies are black.
        lost: Settings that are not kept, as words.
    """

    kind: str
    max_depth: int | None = None
    rr_depth: int | None = None
    hide_emitters: bool = False
    lost: tuple[str, ...] = ()

    @property
    def note(self) -> str:
        """One line on the settings that are not kept; "" if all are."""
        if not self.lost:
            return ""
        return f"of the scene's own integrator these are not kept: {', '.join(self.lost)}; the plan chooses instead"


def own_integrator(found: Iterable[tuple[str, Mapping[str, Any]]]) -> OwnIntegrator | None:
    """The settings of the first integrator among some plugins, from (type, parameters) in the order of the scene."""
    kinds = (*PATHS, *AROUND, *OTHERS)
    plugins = [(kind, parameters) for kind, parameters in found if kind in kinds]
    lost = [f"type {kind!r}" for kind, _ in plugins if kind not in PATHS]
    kind, chosen = next(((k, p) for k, p in plugins if k in PATHS), plugins[0] if plugins else ("", {}))
    if not plugins:
        return None
    depth, start = _whole(chosen.get("max_depth")), _whole(chosen.get("rr_depth"))
    if kind == "direct":
        depth = 2  # lamps, and surfaces they light
    if depth is not None and 0 <= depth < 2:
        lost.append(f"max_depth {depth} (2, lamps and surfaces they light, is the least)")
        depth = 2
    lost += [f"{name} {chosen[name]}" for name in COUNTS if name in chosen]
    end = None if depth is None or not 0 <= depth <= ENDLESS else depth
    return OwnIntegrator(kind, end, start, bool(chosen.get("hide_emitters", False)), tuple(lost))


def in_dict(description: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Types and parameters of the plugins of a scene dict, outer ones first."""
    for value in description.values():
        if isinstance(value, dict) and isinstance(value.get("type"), str):
            yield value["type"], value
            yield from in_dict(value)


def in_file(nodes: Iterable[Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The same of a file, from the nodes that Mitsuba's parser made of it."""
    for node in nodes:
        properties = node.props
        known = {str(key) for key in properties.keys()}  # no iteration over Properties
        yield properties.plugin_name(), {name: properties[name] for name in known if name in (*KEPT, *COUNTS)}


def _whole(value: Any) -> int | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return int(value)
