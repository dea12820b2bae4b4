"""The cost of three colour channels: the spectral product of light, surface and camera against the RGB product.

No rendering: the light that reaches each pilot pixel directly and the reflectance found there are taken as spectra,
multiplied by wavelength, and compared with the product of their RGB values through the matrix that RGB renders use.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes import camera
from simscenes.loading.contents import media_in, unique_materials
from simscenes.loading.load import LoadedScene
from simscenes.render.geometry import first_surfaces, pixel_rays
from simscenes.rigs import Rig

WAVELENGTHS = camera.WAVELENGTHS[::2]  # nm
LIGHT_SAMPLES = 16
MEASURED = re.compile(r"((Irr|R)egularSpectrum|BlackBodySpectrum|SunskyEmitter)\[")  # as Mitsuba prints them
NAMED = re.compile(rf"(\w+)\s*[=:]\s*{MEASURED.pattern}")  # with the parameter that they are the value of
SKY = "SunskyEmitter["
MATT = ("reflectance", "diffuse_reflectance")  # the factors of `light_and_surface`
METAL = ("eta", "k")


def has_measured(mi: Any, loaded: LoadedScene) -> bool:
    """Whether a scene, loaded in spectra, has a light, a surface or a medium that was given as a spectrum.

    A colour given as RGB has only the smooth spectrum that Mitsuba makes up. Metals do not count: their measured
    indices become RGB once, for any light.
    """
    lights = "".join(str(light) for light in loaded.scene.emitters())
    matt = any(name in MATT for name in _measured_parameters(mi, loaded))
    return bool(MEASURED.search(lights)) or matt or bool(measured_elsewhere(mi, loaded))


def measured_elsewhere(mi: Any, loaded: LoadedScene) -> list[str]:
    """Where a scene, loaded in spectra, has measured ones besides lights, matt surfaces and metals; in order.

    For these, no product of light and reflectance gives the cost of RGB.
    """
    found = {name for name in _measured_parameters(mi, loaded) if name not in (*MATT, *METAL)}
    if any(SKY in str(light) for light in loaded.scene.emitters()):
        found.add("sunlight and sky")  # in RGB, Mitsuba has other tables for them than in spectra
    if any(MEASURED.search(str(medium)) for medium in media_in(loaded.scene, mi)):
        found.add("medium")
    return sorted(found)


def _measured_parameters(mi: Any, loaded: LoadedScene) -> set[str]:
    """Names of the parameters of surfaces whose values are measured spectra."""
    surfaces = "".join(str(shape.bsdf()) for shape in unique_materials(loaded.scene, mi))
    return {match[1] for match in NAMED.finditer(surfaces)}


def light_and_surface(mi: Any, loaded: LoadedScene, rig: Rig, seed: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Spectra of the direct light and of the reflectance at the pilot pixels, each [n, wavelength].

    Needs a spectral JIT variant. The same random numbers pick the points on the lamps at every wavelength.
    """
    import drjit as dr

    lights, surfaces = [], []
    # Four wavelengths at a time, as many as a Mitsuba spectrum holds; the last group repeats the end.
    groups = np.minimum(np.arange(0, len(WAVELENGTHS), 4)[:, None] + np.arange(4), len(WAVELENGTHS) - 1)
    for i in range(len(rig)):
        origin, directions = pixel_rays(rig, i)
        pixels = len(directions)
        ray, seen = first_surfaces(mi, loaded, origin, directions)
        picks = np.random.default_rng([seed, i]).random((LIGHT_SAMPLES, 2, pixels), dtype=np.float32)
        # Every group of wavelengths, pick and pixel at once, the pixels fastest.
        lanes = [len(groups), LIGHT_SAMPLES, pixels]
        place = np.broadcast_to(np.arange(pixels, dtype=np.uint32), lanes).ravel()
        si, ray = (dr.gather(type(v), v, mi.UInt32(place)) for v in (seen, ray))
        si.wavelengths = mi.Spectrum(*(np.repeat(w, LIGHT_SAMPLES * pixels) for w in WAVELENGTHS[groups].T))
        valid = si.is_valid()
        pick = mi.Point2f(*(np.broadcast_to(picks[:, k], lanes).ravel() for k in range(2)))
        ds, weight = loaded.scene.sample_emitter_direction(si, pick, True, valid)
        facing = dr.select(dr.dot(si.n, ray.d) > 0, -si.n, si.n)
        found = np.array(weight * dr.maximum(dr.dot(ds.d, facing), 0)).reshape(4, *lanes).mean(2)
        reflected = np.array(si.bsdf(ray).eval_diffuse_reflectance(si, valid)).reshape(4, *lanes)[:, :, 0]
        light, surface = (v.swapaxes(0, 1).reshape(-1, pixels)[: len(WAVELENGTHS)] for v in (found, reflected))
        lit = np.array(seen.is_valid()) & (light.sum(0) > 0) & (surface.sum(0) > 0)
        lights.append(light[:, lit].T)
        surfaces.append(surface[:, lit].T)
    return np.concatenate(lights), np.concatenate(surfaces)


def color_error(light: NDArray[Any], surface: NDArray[Any], name: str | None, bounces: int = 1) -> float:
    """Relative L1 error of RGB transport after `bounces` reflections, seen through the camera's matrix for daylight.

    Args:
        light: Spectra of the light, [n, wavelength].
        surface: Spectra of the reflectance, [n, wavelength].
        name: Camera name, or None for linear sRGB, where no matrix has to be chosen.
        bounces: Times the surface is met.

    Returns:
        Sum of absolute errors over sum of camera signals.
    """
    if len(light) == 0:
        return 0.0
    srgb = camera.srgb_curves()[::2]
    color = None if name is None else camera.camera_color(name)
    curves = srgb if color is None else color.curves[::2] / color.curves[:, 1].sum()
    exact = (light * surface**bounces) @ curves
    # RGB of a reflectance, as Mitsuba's RGB variants have it: seen in daylight, white being (1, 1, 1).
    rgb_light = np.clip(light @ srgb, 0, None)
    white = camera.daylight()[::2]
    rgb_surface = np.clip((surface * white) @ srgb / (white @ srgb), 0, 1)
    product = rgb_light * rgb_surface**bounces
    if color is not None:
        product = np.clip(product @ color.matrix.T, 0, None)
    return float(np.abs(product - exact).sum() / np.abs(exact).sum())
