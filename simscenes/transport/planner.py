"""Decide, effect by effect, what a scene needs, each time with a number and a bound."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from sensor_model.plan import Effect
from simscenes.backend import activate, backend_of
from simscenes.optics import Optics
from simscenes.render.fit import fit_rig, own_optics
from simscenes.render.geometry import check_cameras, geometry_channels
from simscenes.render.source import LoadedScene, build_scene, set_light_weights
from simscenes.rigs import Rig
from simscenes.scenes import default_rig
from simscenes.transport import pilot, plan
from simscenes.transport.effects import (
    DEEPEST,
    RR_DEPTH,
    UNIT,
    Pilot,
    aperture_effect,
    depth_effects,
    media_effects,
    motion_effect,
    polarisation_effect,
    roulette_effect,
    spectral_effect,
)
from simscenes.transport.lights import light_weights
from simscenes.transport.plan import TransportPlan


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
        tolerance: Share of all light that may be wrong or missing in total; each of the five effects counted in it may
            use a fifth.
        rig: The cameras; None for the scene's default rig, or one around its own sensor.
        optics: Camera properties; None for the lens of the scene's own sensor, else a pinhole, at rest and seeing
            linear sRGB.
        force: Effect name -> True or False, decided by the user.
        max_depth: Longest path, decided by the user.
        measure: Measure polarisation, where Russian roulette pays, what made-up spectra would change, and the time the
            plan saves, with pilots of their own (some seconds); else polarisation is bounded from the surfaces, where
            that suffices, roulette starts at path length 2, and the rest is not known.
        variant: Mitsuba variant for the pilots.
        seed: Of the pilots' random numbers.
        allow_outside: Let an XML scene read files outside its folder.

    Returns:
        The plan; print it for the table. Contributions are shares of all light (or pixels, for blur); `plan.bound` sums
        those left out. Pilots see what paths find: a caustic that none of some 10^5 paths meets is in no number.

    Raises:
        ValueError: If the scene cannot be loaded, a camera is inside an object, `tolerance` is not in (0, 1), or a
            forced effect does not exist or cannot be simulated.
    """
    mi = activate(backend_of(variant))
    loaded = build_scene(scene, mi, allow_outside=allow_outside)
    if rig is None:
        by_name = isinstance(scene, str) and not scene.endswith(".xml")
        rig = default_rig(str(scene), 8, 64, 64) if by_name else fit_rig(loaded, 8)
    check_cameras(mi, loaded, rig)
    return plan_loaded(
        scene, loaded, tolerance, rig=rig, optics=optics or own_optics(loaded, mi), force=force, max_depth=max_depth,
        measure=measure, variant=variant, seed=seed, allow_outside=allow_outside,
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
    allow_outside: bool = False,
) -> TransportPlan:
    """`plan_transport` for a scene that is loaded already, in the RGB variant."""
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance is a share of all light and must lie between 0 and 1, got {tolerance}")
    _check_wishes(dict(force or {}), max_depth, optics)  # before the pilots, which take seconds
    mi = activate(backend_of(variant))
    p = Pilot(mi, scene, loaded, pilot.pilot_rig(rig), backend_of(variant), tolerance / 5, seed, allow_outside)
    weights = light_weights(mi, loaded, p.rig, seed)
    set_light_weights(loaded, weights, mi)
    geometry = [geometry_channels(mi, loaded, p.rig, i) for i in range(len(p.rig))]
    scale = rig.width / p.rig.width
    media = media_effects(p)
    depth, transport = depth_effects(p, media[0].on, pilot.most_reflected(mi, loaded), max_depth)
    rr_depth, roulette = roulette_effect(p, media[0].on, depth, measure)
    spectral, made_up = spectral_effect(p, optics, transport[0].contribution, measure)
    effects = [
        *transport, roulette, *media,
        polarisation_effect(p, media[0].on, geometry, measure),
        spectral,
        aperture_effect(p, geometry, optics, scale),
    ]  # fmt: skip
    blur, subframes = motion_effect(geometry, rig, p.rig, optics, scale)
    made = _decide([*effects, blur], dict(force or {}), depth, rr_depth, subframes)
    made = replace(made, light_weights=weights, biases={**made.biases, **made_up})
    return replace(made, seconds=_measure_seconds(p, made)) if measure else made


def _check_wishes(force: dict[str, bool], max_depth: int | None, optics: Optics) -> None:
    """Refuse what cannot be simulated."""
    if unknown := set(force) - set(plan.EFFECTS):
        raise ValueError(f"force: an effect must be one of {', '.join(plan.EFFECTS)}, got {', '.join(sorted(unknown))}")
    if max_depth is not None and max_depth < plan.DIRECT_DEPTH:
        raise ValueError(f"max_depth must be at least {plan.DIRECT_DEPTH} (lamps and what they light), got {max_depth}")
    on = {name for name, wanted in force.items() if wanted}
    if plan.APERTURE in on and optics.aperture_radius is None:
        raise ValueError(f"{plan.APERTURE!r} is forced on, but the camera is a pinhole: give Optics an aperture_radius")
    if plan.MOTION in on and optics.motion is None:
        raise ValueError(f"{plan.MOTION!r} is forced on, but the camera is at rest: give Optics a motion")
    if plan.DEEP in on and force.get(plan.ROULETTE) is False:
        raise ValueError(f"{plan.DEEP!r} on and {plan.ROULETTE!r} off: nothing would ever end a path; change one")
    if {plan.POLARISATION, plan.MEDIA} <= on:
        raise ValueError(f"{plan.POLARISATION!r} and {plan.MEDIA!r} are both forced on, but Mitsuba's integrators for "
                         "media treat light as unpolarised; change one")  # fmt: skip


def everything_on(made: TransportPlan) -> TransportPlan:
    """The same scene with all transport it could have: deep paths, spectra, polarisation, media if it holds any."""
    media = made.is_on(plan.MEDIA) or made[plan.MEDIA].contribution > 0
    # Mitsuba's integrators for media treat light as unpolarised.
    wanted = [plan.INDIRECT, plan.SPECTRAL, plan.MEDIA if media else plan.POLARISATION]
    return replace(made, effects=made.force(on=wanted).effects, max_depth=DEEPEST)


def _measure_seconds(p: Pilot, made: TransportPlan) -> dict[str, float]:
    """What a million samples take by the plan and with everything on; {} if the scene cannot have everything."""
    seconds: dict[str, float] = {}
    if everything_on(made).color not in p.colors:
        return seconds
    for name, one in (("planned", made), ("everything on", everything_on(made))):
        mi, loaded = p.scene_in(one.color)
        seconds[name] = pilot.seconds_per_sample(mi, loaded, p.rig, one.integrator(), p.seed) * 1e6
    p.scene_in("rgb")
    return seconds


def default_plan(optics: Optics) -> TransportPlan:
    """Path tracing in RGB to a depth where nothing is left, media included; nothing is measured, nothing is bounded."""
    blurred = {plan.APERTURE: optics.aperture_radius is not None, plan.MOTION: optics.motion is not None}
    wanted = {plan.INDIRECT: True, plan.DEEP: False, plan.ROULETTE: True, plan.MEDIA: True, plan.SPECTRAL_MIS: False,
              plan.SPECTRAL: False, plan.POLARISATION: False, **blurred}  # fmt: skip
    effects = tuple(
        Effect(name=name, on=on, forced=True, contribution=math.nan, bound=math.nan, unit=UNIT, reason="not asked")
        for name, on in wanted.items()
    )
    frames = 16 if blurred[plan.MOTION] else 1
    return TransportPlan(
        effects=effects, bound=math.nan, unit=UNIT, max_depth=DEEPEST, rr_depth=RR_DEPTH, subframes=frames
    )


def _decide(
    effects: list[Effect], force: dict[str, bool], max_depth: int, rr_depth: int, subframes: int
) -> TransportPlan:
    made = TransportPlan(effects=tuple(effects), bound=0.0, unit=UNIT, max_depth=max_depth, rr_depth=rr_depth)
    if force.get(plan.DEEP):
        force = {plan.ROULETTE: True, **force}  # nothing else ends a path
    if force.get(plan.POLARISATION) and made.is_on(plan.MEDIA):
        force = {plan.MEDIA: False, **force}  # cannot be had together
    forced = made.force(on=[n for n, on in force.items() if on], off=[n for n, on in force.items() if not on])
    left_out = [e for e in forced.effects if not e.on]
    bound = sum(e.contribution for e in left_out if e.unit == UNIT)
    blur = sum(e.contribution for e in left_out if e.unit == "px")
    return TransportPlan(
        effects=forced.effects, bound=bound, unit=UNIT, biases={"px": blur},
        max_depth=max_depth, rr_depth=rr_depth, subframes=subframes if forced.is_on(plan.MOTION) else 1,
    )  # fmt: skip
