"""The single decisions: the contribution of each effect of light transport, and whether it is more than allowed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sensor_model.plan import Effect
from simscenes.loading.contents import class_of, media_in, unique_materials
from simscenes.optics import Optics
from simscenes.render.motion import image_motion
from simscenes.rigs import Rig
from simscenes.transport import pilot, plan
from simscenes.transport.pilot import DEEPEST, Pilot
from simscenes.transport.roulette import TOGETHER, most_efficient, path_lengths, path_noise

UNIT = plan.UNIT
DEPTHS = (8, 16, 32)  # candidates for max_depth
DEEPER = (256, 1024)  # where paths of pilots end, if `DEEPEST` is not deep enough
RR_OFFERED = (2, 3, 5)
# Where roulette starts unless another start is measured to be better: on surfaces 3 took at most 1.13 times the least
# processor time to one error on four scenes, 2 up to 1.5 and 5 up to 1.25 times (docs/what-is-simulated.md); in fog 2.
RR_USUAL = {"path": 3, "volpath": 2}


def decided(name: str, on: bool, contribution: float, bound: float, reason: str, unit: str = UNIT) -> Effect:
    """An effect that the planner, not the user, decides on."""
    return Effect(name=name, on=on, forced=False, contribution=contribution, bound=bound, unit=unit, reason=reason)


def depth_effects(p: Pilot, media: bool, most: float, forced_depth: int | None) -> tuple[int, list[Effect]]:
    """Direct or indirect, and how deep: the same paths, cut at several depths.

    The light that a cut omits lies in an interval. It begins with the light that the pilot's deepest paths still found
    beyond the cut. It ends three standard errors above, plus the light beyond these paths if every later bounce kept
    `most` of it.
    """
    kind = "volpath" if media else "path"
    full = p.cut(kind, DEEPEST, DEEPEST)
    indirect = pilot.missing_light(full, p.cut(kind, plan.DIRECT_DEPTH, DEEPEST))
    p.rms[plan.INDIRECT] = indirect.rms
    if forced_depth is not None:
        seen = min(forced_depth, DEEPER[-1])  # beyond, less is left than there
        chosen, left = forced_depth, _tail(p, kind, seen, max(DEEPEST, seen), most)
    else:
        chosen, left = _deep_enough(p, kind, most)
    p.rms[plan.DEEP] = left.rms
    reason = f"max_depth {chosen}: beyond it {left.estimate:.2g}..{left.upper:.2g}"
    return chosen, [
        decided(plan.INDIRECT, indirect.upper > p.allowed, indirect.upper, p.allowed,
                f"{indirect.estimate:.1%} of the light has bounced more than once"),
        Effect(name=plan.DEEP, on=False, forced=forced_depth is not None, contribution=left.upper,
               bound=p.allowed, unit=UNIT, reason=reason),
    ]  # fmt: skip


def _deep_enough(p: Pilot, kind: str, most: float) -> tuple[int, pilot.Share]:
    """The least depth beyond which no more light is left than allowed, else the deepest; and the light left."""
    for deepest, candidates in ((DEEPEST, (*DEPTHS, DEEPEST)), *((d, (d // 2, d)) for d in DEEPER)):
        for depth in candidates:
            left = _tail(p, kind, depth, deepest, most)
            if left.upper <= p.allowed:
                return depth, left
        if p.backend == "scalar":
            break  # deeper pilots would take minutes
    return depth, left


def _tail(p: Pilot, kind: str, depth: int, deepest: int, most: float) -> pilot.Share:
    """The light that a cut at `depth` omits, from pilots that end at `deepest`."""
    full = p.cut(kind, deepest, deepest)
    if depth < deepest:
        found, later = pilot.missing_light(full, p.cut(kind, depth, deepest)), _tail(p, kind, deepest, deepest, most)
        return pilot.beyond(found, later, deepest - depth, most)
    half = deepest // 2
    found = pilot.missing_light(full, p.cut(kind, half, deepest))
    if deepest > DEEPEST:  # light that fades more slowly than `most` is seen to do so
        later = pilot.missing_light(full, p.cut(kind, deepest - half // 2, deepest))
        earlier = found.estimate - later.estimate
        if 0 < later.estimate < earlier:
            most = max(most, (later.estimate / earlier) ** (2 / half))
    more = most**half / (1 - most**half)  # of a geometric series, what follows its first `half` terms
    return pilot.Share(0.0, more * found.upper, tuple(more * value for value in found.rms))


def roulette_effect(p: Pilot, media: bool, depth: int, measure: bool, scale: float = 1.0) -> tuple[int, Effect]:
    """Where roulette starts, if at all: the least variance times work. It never changes the mean.

    `scale`: width of a pilot's pixel in pixels of the views.
    """
    kind = "volpath" if media else "path"
    usual = RR_USUAL[kind]
    if depth > DEEPEST:
        reason = f"light persists to depth {depth}: roulette would make it rare and bright; never changes the mean"
        return usual, decided(plan.ROULETTE, False, 0.0, 0.0, reason)
    if depth <= RR_OFFERED[0] or not measure or p.backend == "scalar" or p.base != "rgb":
        reason = f"from path length {usual}, not measured: changes noise and time, never the mean"
        return usual, decided(plan.ROULETTE, True, 0.0, 0.0, reason)
    starts = (*(s for s in RR_OFFERED if s <= depth), depth + 1)
    # volpath starts a surface later than path does for the same number.
    lengths = path_lengths(p.mi, p.loaded, p.rig, depth, [s + media for s in starts], p.seed)
    integrators = [{"type": kind, "max_depth": depth, "rr_depth": s, **p.hiding} for s in starts]
    noise = path_noise(p.mi, p.loaded, p.rig, integrators, 1 / scale, p.seed)
    best = most_efficient(noise, lengths, starts.index(usual) if usual in starts else len(starts) - 1)
    on, ratio = best < len(starts) - 1, math.sqrt(noise[best].mean() / max(noise[-1].mean(), 1e-300))
    reason = (
        f"from path length {starts[best]}: {TOGETHER} paths side by side meet {lengths[best]:.2g} surfaces instead of "
        f"{lengths[-1]:.2g}, noise x {ratio:.2f}; never changes the mean" if on
        else f"would save {1 - lengths[:-1].min() / lengths[-1]:.0%} of the surfaces, and cost more in noise"
    )  # fmt: skip
    return starts[best] if on else usual, decided(plan.ROULETTE, on, 0.0, 0.0, reason)


def media_effects(p: Pilot) -> list[Effect]:
    """Fog and other media: present or not, their contribution, and whether their extinction has a colour."""
    media = media_in(p.loaded.scene, p.mi)
    screens = [] if media else screens_before_points(p.loaded.scene, p.mi)
    if not media and not screens:
        return [decided(plan.MEDIA, False, 0.0, p.allowed, "the scene holds no medium"),
                decided(plan.SPECTRAL_MIS, False, 0.0, 0.0, "no medium")]  # fmt: skip
    change = pilot.changed_light(p.render("volpath", DEPTHS[0]), p.render("path", DEPTHS[0]))
    p.rms[plan.MEDIA] = change.rms
    if screens:
        reason = f"point lights shine through {', '.join(screens)}: without, {change.estimate:.1%} of the light is lost"
        return [decided(plan.MEDIA, change.upper > p.allowed, change.upper, p.allowed, reason),
                decided(plan.SPECTRAL_MIS, False, 0.0, 0.0, "no medium")]  # fmt: skip
    chromatic = p.base != "rgb" or any(_is_chromatic(p.mi, m) for m in media)  # spectra are taken for coloured
    reason = f"{len(media)} medium boundaries; ignoring them changes {change.estimate:.1%}"
    return [
        decided(plan.MEDIA, change.upper > p.allowed, change.upper, p.allowed, reason),
        decided(plan.SPECTRAL_MIS, chromatic and change.upper > p.allowed, 0.0, 0.0,
                "extinction differs between colours: spectral MIS tames its noise" if chromatic
                else "extinction is the same for all colours; no bias either way"),
    ]  # fmt: skip


def screens_before_points(scene: Any, mi: Any) -> list[str]:
    """Materials that let light pass straight on, if a scene has lights without extent; in order.

    Such a light is found by a shadow ray alone, and only the volumetric integrators follow that through a material.
    """
    if not any(light.flags() & int(mi.EmitterFlags.Delta) for light in scene.emitters()):
        return []
    materials = [shape.bsdf() for shape in unique_materials(scene, mi)]
    return sorted({class_of(m) for m in materials if m.flags() & int(mi.BSDFFlags.Null)})


def _is_chromatic(mi: Any, medium: Any) -> bool:
    """Whether a medium's extinction differs between colours; Mitsuba's own flag is set for every RGB medium."""
    params = mi.traverse(medium)
    keys = [k for k in params.keys() if k.startswith("sigma_t") and not k.endswith(("to_world", "filename"))]
    values = [np.array(params[k]) for k in keys]
    # A colour is three numbers; a grid of them is [z,y,x,3], and one of plain densities has another last axis.
    colors = [v.reshape(-1, 3) for v in values if v.size == 3 or (v.ndim == 4 and v.shape[-1] == 3)]
    return any(np.ptp(c, axis=1).max() > 1e-6 for c in colors)


def aperture_effect(p: Pilot, geometry: list[Any], optics: Optics, scale: float) -> Effect:
    """Depth of field, from the circle of confusion over the depths seen. Pixels of the full-size image."""
    if optics.aperture_radius is None or optics.focus_distance is None:
        return decided(plan.APERTURE, False, 0.0, 0.5, "the camera is a pinhole", "px")
    z = np.concatenate([g["Z"].ravel() for g in geometry])
    focus = optics.focus_distance
    # Similar triangles: rays through the lens rim and a point at z spread by this much in the plane of focus.
    spread = 2 * optics.aperture_radius * np.abs(1 - focus / z)
    blur = float(np.quantile(spread * p.rig.Ks[0, 0, 0] * scale / focus, 0.95))
    return decided(plan.APERTURE, blur > 0.5, blur, 0.5, f"circle of confusion {blur:.2g} px (95th percentile)", "px")


def motion_effect(
    geometry: list[Any], rig: Rig, small: Rig, optics: Optics, scale: float, sky: bool
) -> tuple[Effect, int]:
    """Motion blur, from how far visible points, a sky included, move across the image during the exposure."""
    if optics.motion is None or len(rig) < 2:
        return decided(plan.MOTION, False, 0.0, 0.5, "the camera is at rest", "px"), 1
    blur = image_motion(geometry, rig, small, optics.motion, sky) * scale
    poses = plan.POSES_PER_PIXEL * blur
    frames = next((n for n in (4, 16) if n >= poses), 64)  # powers of four, as the passes they share
    return decided(plan.MOTION, blur > 0.5, blur, 0.5, f"points move {blur:.2g} px (95th percentile)", "px"), frames
