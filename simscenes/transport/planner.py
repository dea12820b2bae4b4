"""Decide, effect by effect, what a scene needs, each time with a number and a bound."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sensor_model.plan import Effect
from simscenes.backend import activate, choose_variant
from simscenes.optics import Optics
from simscenes.render.fit import fit_rig
from simscenes.render.geometry import geometry_channels
from simscenes.render.source import LoadedScene, build_scene, has_measured_lights, set_light_weights
from simscenes.rigs import Rig
from simscenes.scenes import default_rig
from simscenes.transport import pilot, plan, spectra
from simscenes.transport.lights import light_weights
from simscenes.transport.plan import TransportPlan

UNIT = "of all light"
DEPTHS = (8, 16, 32)  # offered as max_depth
DEEPEST = 64  # pilot paths end here
RR_DEPTH = 2  # best 1/(MSE x seconds) on the catalogue; see scripts/bench_render.py
SPECULAR = 0x8 | 0x10 | 0x20 | 0x40 | 0x80 | 0x100  # BSDFFlags: glossy and delta lobes, which polarise
# Where two specular surfaces follow each other, polarisation changes a few per cent of what is seen in them: measured
# 1.9 % (95th percentile) on `glassware`, 0.02 % on `tabletop`. Used only where nobody asked to measure.
POLARISED_CHANGE = 0.05


@dataclass(frozen=True)
class Pilot:
    """What all decisions start from."""

    mi: Any
    source: Any
    loaded: LoadedScene
    rig: Rig
    allowed: float
    seed: int


def plan_transport(
    scene: str | dict[str, Any] | Path,
    tolerance: float = 0.02,
    *,
    rig: Rig | None = None,
    optics: Optics | None = None,
    force: Mapping[str, bool] | None = None,
    max_depth: int | None = None,
    measure: bool = True,
    variant: str = "auto",
    seed: int = 0,
    allow_outside: bool = False,
) -> TransportPlan:
    """Decide which light transport a scene calls for.

    Args:
        scene: As for `render_set`.
        tolerance: Share of all light that may be wrong or missing in total; each effect may use a quarter of it.
        rig: The cameras; None for the scene's default rig, or one around its own sensor.
        optics: Camera properties; None for a pinhole at rest that sees linear sRGB.
        force: Effect name -> True or False, decided by the user.
        max_depth: Longest path, decided by the user.
        measure: Measure polarisation with a pilot of its own (some seconds); else bound it from the surfaces.
        variant: Mitsuba variant for the pilots.
        seed: Of the pilots' random numbers.
        allow_outside: Let an XML scene read files outside its folder.

    Returns:
        The plan; print it for the table. Contributions are shares of all light (or pixels, for blur); `plan.bound` sums
        those left out. Pilots see what paths find: a caustic that none of some 10^5 paths meets is in no number.

    Raises:
        ValueError: If the scene cannot be loaded, `tolerance` is not in (0, 1), or a forced effect does not exist.
    """
    mi = activate(variant)
    loaded = build_scene(scene, mi, allow_outside=allow_outside)
    if rig is None:
        by_name = isinstance(scene, str) and not scene.endswith(".xml")
        rig = default_rig(str(scene), 8, 64, 64) if by_name else fit_rig(loaded, 8)
    return plan_loaded(
        scene, loaded, tolerance, rig=rig, optics=optics or Optics(), force=force, max_depth=max_depth,
        measure=measure, variant=variant, seed=seed,
    )  # fmt: skip


def plan_loaded(
    scene: str | dict[str, Any] | Path,
    loaded: LoadedScene,
    tolerance: float = 0.02,
    *,
    rig: Rig,
    optics: Optics,
    force: Mapping[str, bool] | None = None,
    max_depth: int | None = None,
    measure: bool = True,
    variant: str = "auto",
    seed: int = 0,
) -> TransportPlan:
    """`plan_transport` for a scene that is loaded already, in the RGB variant."""
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance is a share of all light and must lie between 0 and 1, got {tolerance}")
    mi = activate(variant)
    p = Pilot(mi, scene, loaded, pilot.pilot_rig(rig), tolerance / 4, seed)
    weights = light_weights(mi, loaded, p.rig, seed)
    set_light_weights(loaded, weights, mi)
    geometry = [geometry_channels(mi, loaded, p.rig, i) for i in range(len(p.rig))]
    scale = rig.width / p.rig.width
    media = media_effects(p)
    depth, transport = depth_effects(p, media[0].on, max_depth)
    effects = [
        *transport, *media,
        polarisation_effect(p, geometry, measure),
        spectral_effect(p, optics, variant),
        aperture_effect(p, geometry, optics, scale),
    ]  # fmt: skip
    blur, subframes = motion_effect(geometry, rig, p.rig, optics, scale)
    made = _decide([*effects, blur], dict(force or {}), depth, subframes)
    return replace(made, light_weights=weights)


def default_plan(optics: Optics) -> TransportPlan:
    """Path tracing in RGB to a depth where nothing is left, media included; nothing is measured, nothing is bounded."""
    blurred = {plan.APERTURE: optics.aperture_radius is not None, plan.MOTION: optics.motion is not None}
    wanted = {plan.INDIRECT: True, plan.MEDIA: True, plan.SPECTRAL_MIS: False, plan.SPECTRAL: False,
              plan.POLARISATION: False, **blurred}  # fmt: skip
    effects = tuple(
        Effect(name=name, on=on, forced=True, contribution=math.nan, bound=math.nan, unit=UNIT, reason="not asked")
        for name, on in wanted.items()
    )
    frames = 16 if blurred[plan.MOTION] else 1
    return TransportPlan(
        effects=effects, bound=math.nan, unit=UNIT, max_depth=DEEPEST, rr_depth=RR_DEPTH, subframes=frames
    )


def _decide(effects: list[Effect], force: dict[str, bool], max_depth: int, subframes: int) -> TransportPlan:
    made = TransportPlan(effects=tuple(effects), bound=0.0, unit=UNIT, max_depth=max_depth, rr_depth=RR_DEPTH)
    forced = made.force(on=[n for n, on in force.items() if on], off=[n for n, on in force.items() if not on])
    left_out = [e for e in forced.effects if not e.on]
    bound = sum(e.contribution for e in left_out if e.unit == UNIT)
    blur = sum(e.contribution for e in left_out if e.unit == "px")
    return TransportPlan(
        effects=forced.effects, bound=bound, unit=UNIT, biases={"px": blur},
        max_depth=max_depth, rr_depth=RR_DEPTH, subframes=subframes if forced.is_on(plan.MOTION) else 1,
    )  # fmt: skip


def _effect(name: str, on: bool, contribution: float, bound: float, reason: str, unit: str = UNIT) -> Effect:
    return Effect(name=name, on=on, forced=False, contribution=contribution, bound=bound, unit=unit, reason=reason)


def depth_effects(p: Pilot, media: bool, forced_depth: int | None) -> tuple[int, list[Effect]]:
    """Direct or indirect, and how deep: the same paths, cut at several depths."""
    kind = "volpath" if media else "path"
    images = {}

    def render(depth: int) -> Any:
        if depth not in images:
            integrator = {"type": kind, "max_depth": depth, "rr_depth": RR_DEPTH}
            images[depth] = pilot.render_pilot(p.mi, p.loaded, p.rig, integrator, p.seed)
        return images[depth]

    full = render(DEEPEST)
    indirect = pilot.missing_light(full, render(plan.DIRECT_DEPTH))
    chosen = forced_depth or DEEPEST
    for depth in () if forced_depth else DEPTHS:
        if pilot.missing_light(full, render(depth)).upper <= p.allowed:
            chosen = depth
            break
    # What lies beyond the deepest pilot falls at least as fast as between its last two cuts.
    tail = pilot.missing_light(full, render(chosen)) if chosen < DEEPEST else pilot.Share(0.0, 0.0)
    rest = pilot.missing_light(full, render(DEEPEST // 2)).upper ** 2 if chosen >= DEEPEST else 0.0
    reason = f"max_depth {chosen}: tail {tail.estimate:.2g}..{tail.upper + rest:.2g} (same paths, cut)"
    return chosen, [
        _effect(plan.INDIRECT, indirect.upper > p.allowed, indirect.upper, p.allowed,
                f"{indirect.estimate:.1%} of the light has bounced more than once"),
        Effect(name=plan.DEEP, on=False, forced=forced_depth is not None, contribution=tail.upper + rest,
               bound=p.allowed, unit=UNIT, reason=reason),
    ]  # fmt: skip


def media_effects(p: Pilot) -> list[Effect]:
    """Fog and other media: there or not, what they change, and whether their extinction has a colour."""
    media = [m for s in p.loaded.scene.shapes() for m in (s.interior_medium(), s.exterior_medium()) if m is not None]
    if not media:
        return [_effect(plan.MEDIA, False, 0.0, p.allowed, "the scene holds no medium"),
                _effect(plan.SPECTRAL_MIS, False, 0.0, 0.0, "no medium")]  # fmt: skip
    settings = {"max_depth": DEPTHS[0], "rr_depth": RR_DEPTH}
    seen = pilot.render_pilot(p.mi, p.loaded, p.rig, {"type": "volpath", **settings}, p.seed)
    past = pilot.render_pilot(p.mi, p.loaded, p.rig, {"type": "path", **settings}, p.seed)
    change = pilot.changed_light(seen, past)
    chromatic = any(_is_chromatic(p.mi, m) for m in media)
    reason = f"{len(media)} medium boundaries; ignoring them changes {change.estimate:.1%}"
    return [
        _effect(plan.MEDIA, change.upper > p.allowed, change.upper, p.allowed, reason),
        _effect(plan.SPECTRAL_MIS, chromatic and change.upper > p.allowed, 0.0, 0.0,
                "extinction differs between colours: spectral MIS tames its noise" if chromatic
                else "extinction is the same for all colours; no bias either way"),
    ]  # fmt: skip


def _is_chromatic(mi: Any, medium: Any) -> bool:
    """Whether a medium's extinction differs between colours; Mitsuba's own flag is up for every RGB medium."""
    params = mi.traverse(medium)
    keys = [k for k in params.keys() if k.startswith("sigma_t") and not k.endswith(("to_world", "filename"))]  # noqa: SIM118
    channels = [np.array(params[k]).ravel() for k in keys]
    return any(c.size % 3 == 0 and np.ptp(c.reshape(-1, 3), axis=1).max() > 1e-6 for c in channels if c.size)


def polarisation_effect(p: Pilot, geometry: list[Any], measure: bool) -> Effect:
    """Polarisation shows where two specular surfaces follow each other; diffuse surfaces undo it."""
    mi, specular = p.mi, [bool(s.bsdf().flags() & SPECULAR) for s in p.loaded.scene.shapes()]
    if not any(specular):
        return _effect(plan.POLARISATION, False, 0.0, p.allowed, "all surfaces are diffuse, light comes unpolarised")
    seen = np.array([False, *specular])[np.stack([g["id"] for g in geometry])]
    guess = float(seen.mean()) * POLARISED_CHANGE
    if not measure and guess <= p.allowed:
        return _effect(
            plan.POLARISATION, False, guess, p.allowed, f"bounded: {seen.mean():.1%} of pixels show specular"
        )
    images, variant = [], mi.variant()
    for color in ("spectral", "spectral_polarized"):
        other = activate(variant.removesuffix("_rgb"), color)
        loaded = build_scene(p.source, other, allow_outside=True)
        settings = {"type": "path", "max_depth": DEPTHS[0], "rr_depth": 4}
        images.append(pilot.render_pilot(other, loaded, p.rig, settings, p.seed))
    activate(variant)
    change = pilot.changed_light(images[0], images[1])
    return _effect(plan.POLARISATION, change.upper > p.allowed, change.upper, p.allowed,
                   f"paired pilots with and without differ by {change.estimate:.2%}")  # fmt: skip


def spectral_effect(p: Pilot, optics: Optics, variant: str) -> Effect:
    """Three channels or wavelengths, from light x surface x camera."""
    if not has_measured_lights(p.source):
        return _effect(
            plan.SPECTRAL, False, 0.0, p.allowed, "all lights are given as RGB: RGB transport is their definition"
        )
    backend = choose_variant(variant).removesuffix("_rgb")
    if backend == "scalar":
        return _effect(
            plan.SPECTRAL, True, math.inf, p.allowed, "a light has a measured spectrum (not quantified in scalar)"
        )
    mi = activate(backend, "spectral")
    loaded = build_scene(p.source, mi, allow_outside=True)
    light, surface = spectra.light_and_surface(mi, loaded, p.rig, p.seed)
    activate(variant)
    once, twice = (spectra.color_error(light, surface, optics.camera, bounces) for bounces in (1, 2))
    return _effect(plan.SPECTRAL, once > p.allowed, once, p.allowed,
                   f"RGB errs by {once:.1%} after one bounce, {twice:.1%} after two")  # fmt: skip


def aperture_effect(p: Pilot, geometry: list[Any], optics: Optics, scale: float) -> Effect:
    """Depth of field, from the circle of confusion over the depths seen. Pixels of the full-size image."""
    if optics.aperture_radius is None or optics.focus_distance is None:
        return _effect(plan.APERTURE, False, 0.0, 0.5, "the camera is a pinhole", "px")
    z = np.concatenate([g["Z"].ravel() for g in geometry])
    focus = optics.focus_distance
    # Similar triangles: rays through the lens rim and a point at z spread by this much in the plane of focus.
    spread = 2 * optics.aperture_radius * np.abs(1 - focus / z)
    blur = float(np.quantile(spread * p.rig.Ks[0, 0, 0] * scale / focus, 0.95))
    return _effect(plan.APERTURE, blur > 0.5, blur, 0.5, f"circle of confusion {blur:.2g} px (95th percentile)", "px")


def motion_effect(geometry: list[Any], rig: Rig, small: Rig, optics: Optics, scale: float) -> tuple[Effect, int]:
    """Motion blur, from how far the points seen move across the image during the exposure."""
    from simscenes.render.motion import image_motion

    if optics.motion is None or len(rig) < 2:
        return _effect(plan.MOTION, False, 0.0, 0.5, "the camera is at rest", "px"), 1
    blur = image_motion(geometry, rig, small, optics.motion) * scale
    frames = next((n for n in (4, 16) if n >= 2 * blur), 64)  # powers of four, as the passes they share
    return _effect(plan.MOTION, blur > 0.5, blur, 0.5, f"points move {blur:.2g} px (95th percentile)", "px"), frames
