"""Decide, effect by effect, whether a scene needs it, each time with a number and a bound."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import replace

from sensor_model.plan import Effect
from simscenes.backend import backend_of, using_variant
from simscenes.loading.contents import media_in, patterned_sky
from simscenes.loading.integrator import OwnIntegrator
from simscenes.loading.load import LoadedScene, build_in_fewest_colors, set_light_weights
from simscenes.loading.reference import SceneLike, SceneRef
from simscenes.optics import Optics
from simscenes.render.fitting import usual_rig
from simscenes.render.framing import with_lens
from simscenes.render.geometry import check_cameras, geometry_channels, hides_lamps
from simscenes.rigs import Rig
from simscenes.transport import pilot, plan
from simscenes.transport.colors import color_effects
from simscenes.transport.effects import (
    UNIT,
    aperture_effect,
    depth_effects,
    media_effects,
    motion_effect,
    roulette_effect,
    screens_before_points,
)
from simscenes.transport.lights import light_weights
from simscenes.transport.pilot import DEEPEST, RR_DEPTH, Pilot
from simscenes.transport.plan import TransportPlan, settle
from simscenes.transport.plugins import not_understood
from simscenes.transport.wishes import check_wishes


def plan_transport(
    scene: SceneLike | SceneRef,
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
    """Decide which light transport a scene needs.

    Args:
        scene: As for `render_set`.
        tolerance: Share of all light that may be wrong or missing in total; each of the five effects counted in it may
            use a fifth.
        rig: The cameras; None for the scene's default rig, or one around its own sensor.
        optics: Camera properties; None for the lens of the scene's own sensor, else a pinhole, at rest and seeing
            linear sRGB.
        force: Effect name -> True or False, decided by the user.
        max_depth: Longest path, decided by the user; else the limit of the scene's own integrator, if it sets one.
        measure: Measure polarisation, where Russian roulette pays, the change by made-up spectra, and the time the plan
            saves, with pilots of their own (some seconds); else polarisation is bounded from the surfaces, where that
            suffices, roulette starts where it usually pays (`RR_USUAL`), and the rest is not known.
        variant: Mitsuba variant for the pilots.
        seed: Of the pilots' random numbers.
        allow_outside: Let an XML scene read files outside its folder.

    Returns:
        The plan; print it for the table. Contributions are shares of all light (or pixels, for blur); `plan.bound` sums
        those left out. Pilots see only what paths find: a caustic that all 50,000 to 200,000 paths miss does not count.

    Raises:
        ValueError: If the scene cannot be loaded, a camera is inside an object, `tolerance` is not in (0, 1), or a
            forced effect does not exist or cannot be simulated.
    """
    source = SceneRef.of(scene)
    loaded = build_in_fewest_colors(source, backend_of(variant), allow_outside=allow_outside)
    with using_variant(loaded.variant) as mi:
        if rig is None:
            rig = usual_rig(source, loaded, 8, 64, 64)
        check_cameras(mi, loaded, rig)
        return plan_loaded(
            source, loaded, tolerance, rig=rig, optics=with_lens(optics, loaded, mi), force=force, max_depth=max_depth,
            measure=measure, variant=variant, seed=seed, allow_outside=allow_outside,
        )  # fmt: skip


def plan_loaded(
    source: SceneRef,
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
    """`plan_transport` for a scene that is loaded already, in the fewest colours it can have."""
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance is a share of all light and must lie between 0 and 1, got {tolerance}")
    force, backend, own = dict(force or {}), backend_of(variant), loaded.integrator
    if own is not None and own.note:
        warnings.warn(own.note, stacklevel=2)
    with using_variant(loaded.variant) as mi:
        small = pilot.pilot_rig(rig)
        p = Pilot(mi, source, loaded, small, backend, tolerance / 5, seed, allow_outside, base=loaded.color,
                  spp=pilot.pilot_spp(rig, small))  # fmt: skip
        if own is not None:
            p = replace(p, hide_emitters=own.hide_emitters)
            max_depth = own.max_depth if max_depth is None else max_depth
        if max_depth is not None and backend != "scalar":  # where paths take longest
            p = replace(p, spp=max(p.spp, pilot.CUT_SPP))
        made = _decide(p, rig, optics, force, max_depth, measure)
        say_if_dark(p)
        return replace(made, seconds=_measure_seconds(p, made)) if measure else made


def say_if_dark(p: Pilot) -> None:
    """Warn if the pilots, which have been rendered, are black; the picture may be right all the same."""
    name = p.loaded.name
    if not p.loaded.scene.emitters():
        warnings.warn(f"scene {name!r} has no emitter: every picture is black; add one, such as "
                      '<emitter type="constant"/>', stacklevel=3)  # fmt: skip
    elif not any(light.any() for light in (*p.images.values(), *(found.light for found in p.by_length.values()))):
        warnings.warn(f"no light of scene {name!r} reaches its cameras in the pilots: see that lamps face the "
                      "cameras' view, and that nothing encloses them", stacklevel=3)  # fmt: skip


def _decide(
    p: Pilot, rig: Rig, optics: Optics, force: dict[str, bool], max_depth: int | None, measure: bool
) -> TransportPlan:
    """All effects, one after the other; the result for one may decide on a later one."""
    mi, loaded = p.mi, p.loaded
    has_media = bool(media_in(loaded.scene, mi) or screens_before_points(loaded.scene, mi))
    check_wishes(force, max_depth, optics, media=has_media, spectra="spectral" in p.colors)
    weights = light_weights(mi, loaded, p.rig, p.seed)
    set_light_weights(loaded, weights, mi)
    geometry = [geometry_channels(mi, loaded, p.rig, i) for i in range(len(p.rig))]
    scale = rig.width / p.rig.width
    media = media_effects(p)
    depth, transport = depth_effects(p, media[0].on, pilot.most_reflected(mi, loaded), max_depth)
    rr_depth, roulette = roulette_effect(p, media[0].on, depth, measure, max(scale, 1.0))
    if loaded.integrator is not None and loaded.integrator.rr_depth is not None:
        rr_depth, reason = loaded.integrator.rr_depth, "by the scene's own integrator; never changes the mean"
        roulette = replace(roulette, on=True, forced=True, reason=f"from path length {rr_depth}, {reason}")
    colors, made_up = color_effects(p, optics, media[0].on, geometry, transport[0].contribution, measure)
    sky = patterned_sky(loaded.scene) and not hides_lamps(loaded)
    blur, subframes = motion_effect(geometry, rig, p.rig, optics, scale, sky)
    effects = [*transport, roulette, *media, *colors, aperture_effect(p, geometry, optics, scale), blur]
    if strange := not_understood(loaded.scene, mi):
        effects = in_full(effects, p, strange)
    made = TransportPlan(
        effects=settle(effects, force), bound=0.0, unit=UNIT, max_depth=depth, rr_depth=rr_depth, subframes=subframes,
        light_weights=weights, tolerance=5 * p.allowed, rms=dict(p.rms),
        hide_emitters=p.hide_emitters,
    )  # fmt: skip
    return _bounded(made, made_up)


def in_full(effects: list[Effect], p: Pilot, strange: list[str]) -> list[Effect]:
    """All transport that the scene supports, because it holds plugins that the planner does not understand."""
    possible = {plan.INDIRECT: True, plan.DEEP: True, plan.ROULETTE: True, plan.MEDIA: True,
                plan.SPECTRAL: p.loads("spectral") or p.loads("spectral_polarized"),
                plan.POLARISATION: p.loads("spectral_polarized")}  # fmt: skip
    who = f"the planner does not know {', '.join(strange)}"
    return [
        replace(e, on=on, contribution=math.inf,
                reason=f"{who}: simulated fully" if on else f"{who}, and the scene cannot be loaded with it")
        if (on := possible.get(e.name)) is not None
        else e
        for e in effects
    ]  # fmt: skip


def everything_on(made: TransportPlan) -> TransportPlan:
    """The same scene with all transport it supports: deep paths, spectra, polarisation, media if it holds any."""
    media = made.is_on(plan.MEDIA) or made[plan.MEDIA].contribution > 0
    wanted = dict.fromkeys((plan.INDIRECT, plan.SPECTRAL, plan.POLARISATION), True) | {plan.MEDIA: media}
    return replace(made, effects=settle(made.effects, wanted), max_depth=max(made.max_depth, DEEPEST))


def _measure_seconds(p: Pilot, made: TransportPlan) -> dict[str, float]:
    """The seconds of a million samples by the plan and with everything on; {} if the scene cannot have everything."""
    seconds: dict[str, float] = {}
    if everything_on(made).color not in p.colors:
        return seconds
    for name, one in (("planned", made), ("everything on", everything_on(made))):
        with p.in_color(one.color) as (mi, loaded):
            seconds[name] = pilot.seconds_per_sample(mi, loaded, p.rig, one.integrator(), p.seed) * 1e6
    return seconds


def default_plan(optics: Optics, own: OwnIntegrator | None = None) -> TransportPlan:
    """Path tracing in RGB to a depth where nothing is left, media included; nothing is measured, nothing is bounded.

    Args:
        optics: Of the cameras; a lens and a motion are simulated.
        own: The settings of the scene's own integrator.
    """
    own = own or OwnIntegrator("path")
    blurred = {plan.APERTURE: optics.aperture_radius is not None, plan.MOTION: optics.motion is not None}
    wanted = {plan.INDIRECT: True, plan.DEEP: False, plan.ROULETTE: True, plan.MEDIA: True, plan.SPECTRAL_MIS: False,
              plan.SPECTRAL: False, plan.POLARISATION: False, **blurred}  # fmt: skip
    effects = tuple(
        Effect(name=name, on=on, forced=True, contribution=math.nan, bound=math.nan, unit=UNIT, reason="not asked")
        for name, on in wanted.items()
    )
    frames = 16 if blurred[plan.MOTION] else 1
    return TransportPlan(
        effects=effects, bound=math.nan, unit=UNIT, max_depth=own.max_depth or DEEPEST,
        rr_depth=own.rr_depth or RR_DEPTH, subframes=frames, hide_emitters=own.hide_emitters,
    )  # fmt: skip


def _bounded(made: TransportPlan, made_up: float | None) -> TransportPlan:
    """The plan with its bounds. `made_up`: the change by spectra in a scene given in RGB; None if unknown.

    Colours given as RGB are followed as RGB by definition, but a renderer that turns them into smooth spectra sees
    another picture: the difference is a bound in a unit of its own, or an error if the plan makes such spectra itself.
    """
    left_out = [e for e in made.effects if not e.on]
    bound = sum(e.contribution for e in left_out if e.unit == UNIT)
    biases = {"px": sum(e.contribution for e in left_out if e.unit == "px")}
    if made_up is not None and made.color == "rgb":
        biases[plan.MADE_UP] = made_up
    return replace(made, bound=bound + (made_up or 0.0) * (made.color != "rgb"), biases=biases)
