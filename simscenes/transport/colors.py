"""Whether light is followed in three channels, in wavelengths, or polarised, and the light each choice leaves out."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from sensor_model.plan import Effect
from simscenes.camera import camera_color
from simscenes.loading.contents import unique_materials
from simscenes.optics import Optics
from simscenes.scenes import SCENES, split_name
from simscenes.transport import pilot, plan, spectra
from simscenes.transport.effects import DEPTHS, decided
from simscenes.transport.lengths import SPECULAR
from simscenes.transport.pilot import DEEPEST, Pilot
from simscenes.transport.plugins import filters_in

# Of light that two specular surfaces have passed on, polarisation changes a few per cent: measured 1 % on `tabletop`,
# 2 to 5 % on `glassware`. Used only where measuring was not requested, with room to spare.
POLARISED_CHANGE = 0.1


def color_effects(
    p: Pilot, optics: Optics, media: bool, geometry: list[Any], indirect: float, measure: bool
) -> tuple[list[Effect], float | None]:
    """Polarisation and spectra, and the change by spectra in a scene given in RGB (None if unknown).

    Mitsuba polarises spectra only: in a scene given in RGB, polarisation is worth following if it changes more than the
    spectra that have to be made up for it.
    """
    spectral, made_up = spectral_effect(p, optics, indirect, measure, media)
    polarisation = polarisation_effect(p, media, geometry, measure)
    weighed = p.backend != "scalar" and not filters_in(p.loaded.scene, p.mi)  # filters are there to be seen
    if polarisation.on and not spectral.on and weighed and not _has_measured_spectra(p):
        made_up = _color_cost(p, optics, indirect)[0] if made_up is None else made_up
        if made_up >= polarisation.contribution:
            reason = f"{polarisation.reason}; it takes made-up spectra, which change {made_up:.1%}"
            polarisation = replace(polarisation, on=False, reason=reason)
    return [polarisation, spectral], made_up


def polarisation_effect(p: Pilot, media: bool, geometry: list[Any], measure: bool) -> Effect:
    """Polarisation shows where two specular surfaces follow each other, and behind filters; diffuse surfaces undo it.

    The effect of filters is always measured: without polarisation each of them passes half of any light. Without
    measurements a scene given in RGB stays in RGB, with the bound from its surfaces.
    """
    if p.base == "spectral_polarized":
        return decided(plan.POLARISATION, True, math.inf, p.allowed, f"nothing less can load it: {p.loaded.demand}")
    filters = filters_in(p.loaded.scene, p.mi)
    possible = "spectral_polarized" in p.colors
    if filters and (p.backend == "scalar" or not possible):
        why = "not quantified in scalar" if possible else f"but also parts made for {p.base} alone"
        return decided(plan.POLARISATION, possible, math.inf, p.allowed, f"the scene holds {', '.join(filters)}, {why}")
    specular = [bool(s.bsdf().flags() & SPECULAR) for s in unique_materials(p.loaded.scene, p.mi)]
    if not filters and not any(specular):
        return decided(plan.POLARISATION, False, 0.0, p.allowed, "all surfaces are diffuse, light stays unpolarised")
    if not filters and (not possible or (not measure and p.base == "rgb")):
        guess, reason = _bounded_polarisation(p, geometry, specular)
        if guess <= p.allowed or not possible:
            return decided(plan.POLARISATION, False, guess, p.allowed, reason)
        if not _has_measured_spectra(p):
            reason += "; it takes made-up spectra, and what these change is not measured"
            return decided(plan.POLARISATION, False, guess, p.allowed, reason)
    change = _paired(p, ("spectral", "spectral_polarized"), media)
    p.rms[plan.POLARISATION] = change.rms
    behind = f" behind {', '.join(filters)}" if filters else ""
    return decided(plan.POLARISATION, change.upper > p.allowed, change.upper, p.allowed,
                   f"paired pilots with and without differ by {change.estimate:.2%}{behind}")  # fmt: skip


def _paired(p: Pilot, colors: tuple[str, str], media: bool) -> pilot.Share:
    """The change of the pilot views by a second colour representation, against a first one.

    `volpath` gives nan where a medium lets one of the wavelengths of a path pass unhindered; `volpathmis` does not
    polarise.
    """
    images = []
    for color in colors:
        kind = "path" if not media else "volpath" if "spectral_polarized" in colors else "volpathmis"
        settings = {"type": kind, "max_depth": DEPTHS[0], "rr_depth": 4, **p.hiding}
        with p.in_color(color) as (other, loaded):
            images.append(pilot.render_pilot(other, loaded, p.rig, settings, p.seed, p.spp))
    return pilot.changed_light(images[0], images[1])


def _bounded_polarisation(p: Pilot, geometry: list[Any], specular: list[bool]) -> tuple[float, str]:
    if p.backend == "scalar" or p.base != "rgb":
        share = float(np.array([False, *specular])[np.stack([g["material"] for g in geometry])].mean())
        return share * POLARISED_CHANGE, f"bounded: {share:.1%} of pixels show specular"
    total = float(p.cut("path", DEEPEST, DEEPEST).mean())
    share = p.lengths(DEEPEST).chained / total if total > 0 else 0.0
    return share * POLARISED_CHANGE, f"bounded: {share:.1%} of the light comes by two specular surfaces in a row"


def spectral_effect(
    p: Pilot, optics: Optics, indirect: float, measure: bool, media: bool = False
) -> tuple[Effect, float | None]:
    """Three channels or wavelengths, from light x surface x camera; `indirect` is the share of light that meets two.

    Besides the effect, the change by made-up spectra in a scene given in RGB, if that was measured.
    """
    if p.base != "rgb":
        return decided(plan.SPECTRAL, True, math.inf, p.allowed, f"RGB cannot load it: {p.loaded.demand}"), None
    if p.colors == ("rgb",):
        return decided(plan.SPECTRAL, False, 0.0, p.allowed, "the scene holds parts made for RGB alone"), None
    if _has_measured_spectra(p):
        if p.backend == "scalar":
            reason = "the scene has measured spectra (not quantified in scalar)"
            return decided(plan.SPECTRAL, True, math.inf, p.allowed, reason), None
        if where := _measured_elsewhere(p):
            change = _paired(p, ("rgb", "spectral"), media)
            p.rms[plan.SPECTRAL] = change.rms
            differ = f"paired pilots in RGB and in spectra differ by {change.estimate:.2%}"
            reason = f"measured spectra as {', '.join(where)}: {differ}"
            return decided(plan.SPECTRAL, change.upper > p.allowed, change.upper, p.allowed, reason), None
        cost, once, twice = _color_cost(p, optics, indirect)
        reason = f"RGB errs by {once:.1%} after one bounce, {twice:.1%} after two"
        return decided(plan.SPECTRAL, cost > p.allowed, cost, p.allowed, reason), None
    reason, matrix = "lights and surfaces are given as RGB: RGB transport is their definition", 0.0
    if optics.camera is not None:
        matrix = camera_color(optics.camera).matrix_error
        reason += f"; the camera's matrix errs by {matrix:.1%} on a ColorChecker in daylight"
    made_up = _color_cost(p, optics, indirect)[0] if measure and p.backend != "scalar" else None
    return decided(plan.SPECTRAL, False, matrix, p.allowed, reason), made_up


def _color_cost(p: Pilot, optics: Optics, indirect: float) -> tuple[float, float, float]:
    """The cost of RGB in this scene; after one bounce; after two."""
    with p.in_color("spectral") as (mi, loaded):
        light, surface = spectra.light_and_surface(mi, loaded, p.rig, p.seed)
    once, twice = (spectra.color_error(light, surface, optics.camera, bounces) for bounces in (1, 2))
    return once + min(indirect, 1.0) * max(twice - once, 0.0), once, twice


def _measured_elsewhere(p: Pilot) -> list[str]:
    if p.source.in_catalogue:
        return []
    with p.in_color("spectral") as (mi, loaded):
        return spectra.measured_elsewhere(mi, loaded)


def _has_measured_spectra(p: Pilot) -> bool:
    if p.source.in_catalogue:
        return SCENES[split_name(p.source.name)[0]].measured_lights
    with p.in_color("spectral") as (mi, loaded):
        return spectra.has_measured(mi, loaded)
