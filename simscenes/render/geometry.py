"""The surface that the ray through each pixel centre hits: depth, normals, albedo, ids.

Mitsuba's AOVs are not used: their depth starts at the near plane, they average over the pixel, and their ids are
process-wide numbers blended at edges.

A ray goes through surfaces that no picture shows: boundaries of media, surfaces where their opacity is below one half,
and lamps where the scene's integrator hides them. Sheets of glass are surfaces.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.camera import WAVELENGTHS, daylight, srgb_curves
from simscenes.loading.contents import class_of, unique_materials
from simscenes.loading.load import LoadedScene
from simscenes.render.wavefront import from_numpy
from simscenes.rigs import Rig, invert_rigid

MAX_PASSED = 64  # surfaces that a ray goes through: leaves beside their cut-out, hidden lamps, boundaries of fog
CLEAR = 0.5  # share of the light that goes straight through, from which on a pixel sees the surface behind

Channels = dict[str, NDArray[Any]]


def pixel_rays(rig: Rig, i: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Camera centre [3] and unit directions [h*w,3], row by row, through the pixel centres of view `i`."""
    c2w, K = invert_rigid(rig.viewmats[i]), rig.Ks[i]
    y, x = np.mgrid[: rig.height, : rig.width] + 0.5
    local = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1).reshape(-1, 3)
    directions = local @ c2w[:3, :3].T
    return c2w[:3, 3], directions / np.linalg.norm(directions, axis=1, keepdims=True)


def geometry_channels(mi: Any, loaded: LoadedScene, rig: Rig, i: int) -> Channels:
    """Geometry buffers of view `i` as EXR channels, each [h,w].

    Returns:
        Z and distance (float32), N.X/Y/Z (shading) and Ng.X/Y/Z (geometric) unit normals in the world, facing the
        camera, albedo.R/G/B (diffuse reflectance), id and material (uint32). Pixels without a surface have an infinite
        Z and distance, and 0 in all other channels.
    """
    origin, directions = pixel_rays(rig, i)
    find = _intersect_scalar if mi.variant().startswith("scalar") else _intersect_wide
    hit, position, shading, geometric, albedo, shape, material = find(mi, loaded, origin, directions)
    facing = np.where(np.einsum("pj,pj->p", geometric, directions) > 0, -1.0, 1.0)[:, None]
    along = np.where(np.einsum("pj,pj->p", geometric, shading) < 0, -1.0, 1.0)[:, None]  # -1 on mirrored shapes
    offset = position - origin
    z = offset @ rig.viewmats[i][2, :3]
    image = (rig.height, rig.width)
    channels: Channels = {
        "Z": np.where(hit, z, np.inf).reshape(image).astype(np.float32),
        "distance": np.where(hit, np.linalg.norm(offset, axis=1), np.inf).reshape(image).astype(np.float32),
        "id": np.where(hit, shape, 0).reshape(image).astype(np.uint32),
        "material": np.where(hit, material, 0).reshape(image).astype(np.uint32),
    }
    # A conductor or dielectric has no diffuse reflectance; some plugins then answer nan or a lobe's density.
    albedo = np.where(np.isfinite(albedo), np.clip(albedo, 0, 1), 0)
    for name, field, axes in (
        ("N", facing * along * shading, "XYZ"),
        ("Ng", facing * geometric, "XYZ"),
        ("albedo", albedo, "RGB"),
    ):
        for k, axis in enumerate(axes):
            channels[f"{name}.{axis}"] = np.where(hit, field[:, k], 0).reshape(image).astype(np.float32)
    return channels


def check_cameras(mi: Any, loaded: LoadedScene, rig: Rig) -> None:
    """Refuse cameras inside an opaque object, whose picture would be black without explanation.

    Raises:
        ValueError: If a view sees mostly the unlit backs of one-sided surfaces.
    """
    sides = [s.bsdf().flags() & int(mi.BSDFFlags.BackSide) for s in unique_materials(loaded.scene, mi)]
    one_sided = np.array([False, *(not back for back in sides)])
    for i in range(len(rig)):
        small = shrunk(rig, i)
        origin, directions = pixel_rays(small, 0)
        find = _intersect_scalar if mi.variant().startswith("scalar") else _intersect_wide
        hit, _, shading, _, _, shape, material = find(mi, loaded, origin, directions)
        # Mitsuba's materials and lamps ask the shading normal, which a mirrored shape does not turn with the geometry.
        back = hit & one_sided[material] & (np.einsum("pj,pj->p", shading, directions) > 0)
        if back.mean() > 0.5:
            names = ["", *loaded.shapes]
            inside = names[int(np.bincount(shape[back]).argmax())]
            raise ValueError(f"view {i} at {origin.round(3).tolist()} sees the inside of {inside!r}, which is "
                             "one-sided: move the camera out of it, or make the material twosided")  # fmt: skip


def shrunk(rig: Rig, i: int, size: int = 8) -> Rig:
    """View `i` alone, with a field of view as before and only a few pixels."""
    stretch = np.diag([size / rig.width, size / rig.height, 1.0])
    return Rig(viewmats=rig.viewmats[i : i + 1], Ks=stretch @ rig.Ks[i : i + 1], width=size, height=size)


def first_surfaces(mi: Any, loaded: LoadedScene, origin: NDArray[Any], directions: NDArray[Any]) -> tuple[Any, Any]:
    """Rays from one point and the first surface that each shows (see the module); in a JIT variant.

    Both are evaluated, in one kernel that serves every number of rays: compiling takes longer than running it.
    """
    import drjit as dr

    # Axis by axis, and the origin opaque: else the number of rays, and the origin, would be compiled into the kernel.
    direction = mi.Vector3f(*(from_numpy(mi.Float, axis) for axis in directions.T.astype(np.float32)))
    ray = mi.Ray3f(mi.Point3f(*(dr.opaque(mi.Float, float(v)) for v in origin)), direction)
    scene, hidden, holes = loaded.scene, hides_lamps(loaded), _materials_with_holes(mi, loaded)
    si = scene.ray_intersect(ray)
    for _ in range(MAX_PASSED):
        dr.eval(ray, si)  # together: gathering from unevaluated arrays would compile a kernel for each field
        bsdf = si.bsdf(ray)
        through = (bsdf.flags() & int(mi.BSDFFlags.All)) == int(mi.BSDFFlags.Null)
        if holes.any():
            clear = dr.mean(_unpolarized(mi, bsdf.eval_null_transmission(si, si.is_valid())))
            holed = dr.gather(mi.Bool, mi.Bool(holes), mi.UInt32(dr.reinterpret_array(mi.UInt32, bsdf)))
            through |= holed & (clear > CLEAR)
        if hidden:
            through |= si.shape.is_emitter()
        through &= si.is_valid()
        if not dr.any(through):
            break
        si = dr.select(through, scene.ray_intersect(si.spawn_ray(ray.d), through), si)
    return ray, si


def hides_lamps(loaded: LoadedScene) -> bool:
    """Whether camera rays go through lamps, as the scene's own integrator wants it."""
    return loaded.integrator is not None and loaded.integrator.hide_emitters


def _has_holes(mi: Any, bsdf: Any) -> bool:
    """Whether a material may show surfaces behind it, such as a leaf on a card; sheets of glass are surfaces."""
    lobes, null = bsdf.flags() & int(mi.BSDFFlags.All), int(mi.BSDFFlags.Null)
    return bool(lobes & null) and lobes != null and class_of(bsdf) != "ThinDielectric"


def _materials_with_holes(mi: Any, loaded: LoadedScene) -> NDArray[np.bool_]:
    """`_has_holes` of each material by its process-wide registry number, [0] if none has; in a JIT variant."""
    import drjit as dr

    materials = [shape.bsdf() for shape in unique_materials(loaded.scene, mi)]
    holed = [_has_holes(mi, bsdf) for bsdf in materials]
    if not any(holed):
        return np.zeros(0, dtype=bool)
    registry = [int(mi.UInt32(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf)))[0]) for bsdf in materials]
    table = np.zeros(max(registry, default=0) + 1, dtype=bool)
    table[registry] = holed
    return table


def _intersect_wide(
    mi: Any, loaded: LoadedScene, origin: NDArray[Any], directions: NDArray[Any]
) -> tuple[NDArray[Any], ...]:
    """All rays at once, in a JIT variant."""
    import drjit as dr

    scene = loaded.scene
    ray, si = first_surfaces(mi, loaded, origin, directions)
    columns = [np.array(v, dtype=np.float64).T for v in (si.p, si.sh_frame.n, si.n)]
    columns.append(_albedo(mi, ray, si))
    seen = dr.select(si.instance != mi.ShapePtr(None), si.instance, si.shape)
    shapes = _numbers(dr, mi.UInt32, [mi.ShapePtr(s) for s in scene.shapes()], seen)
    materials = _numbers(dr, mi.UInt32, [mi.BSDFPtr(s.bsdf()) for s in unique_materials(scene, mi)], si.bsdf(ray))
    return np.array(si.is_valid()), *columns, shapes, materials


def _albedo(mi: Any, ray: Any, si: Any) -> NDArray[np.float64]:
    """Diffuse reflectance of surfaces in linear sRGB, [n,3]; in a JIT variant.

    Spectra are seen in daylight, as Mitsuba's RGB variants take them: many wavelengths at once, four to a lane.
    """
    import drjit as dr

    if mi.is_rgb:
        found = si.bsdf(ray).eval_diffuse_reflectance(si, si.is_valid())
        return np.array(mi.Color3f(found), dtype=np.float64).reshape(3, -1).T
    groups, weights = _daylight_groups()
    pixels = dr.width(si.t)
    place = np.tile(np.arange(pixels, dtype=np.uint32), len(groups))
    many, rays = (dr.gather(type(v), v, mi.UInt32(place)) for v in (si, ray))
    many.wavelengths = type(many.wavelengths)(*(mi.Float(np.repeat(w, pixels)) for w in groups.T.astype(np.float32)))
    spectrum = many.bsdf(rays).eval_diffuse_reflectance(many, many.is_valid())
    values = np.array(_unpolarized(mi, spectrum), dtype=np.float64).reshape(4, len(groups), pixels)
    return np.clip(np.einsum("kgp,gkc->pc", values, weights), 0, 1)


def _unpolarized(mi: Any, spectrum: Any) -> Any:
    """The factor of a Mueller matrix for unpolarised light; a spectrum unchanged."""
    return mi.unpolarized_spectrum(spectrum) if mi.is_polarized else spectrum


def _daylight_groups() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Wavelengths in groups of four, [g,4], and the share of the reflectance at each in linear sRGB, [g,4,3]."""
    chosen = slice(0, 80, 2)
    seen = daylight()[chosen, None] * srgb_curves()[chosen]
    return WAVELENGTHS[chosen].reshape(-1, 4), (seen / seen.sum(0)).reshape(-1, 4, 3)


def _numbers(dr: Any, uint32: Any, known: list[Any], pointers: Any) -> NDArray[np.uint32]:
    """Replace process-wide registry numbers by 1 + the index in `known`."""
    registry = [int(dr.reinterpret_array(uint32, pointer)[0]) for pointer in known]
    table = np.zeros(max(registry, default=0) + 1, dtype=np.uint32)
    table[registry] = np.arange(1, len(registry) + 1)
    return table[np.array(dr.reinterpret_array(uint32, pointers))]


def _intersect_scalar(
    mi: Any, loaded: LoadedScene, origin: NDArray[Any], directions: NDArray[Any]
) -> tuple[NDArray[Any], ...]:
    """Ray by ray, in a scalar variant."""
    scene, hidden = loaded.scene, hides_lamps(loaded)
    count = len(directions)
    hit, vectors = np.zeros(count, dtype=bool), np.zeros((4, count, 3))
    numbers = np.zeros((2, count), dtype=np.uint32)
    shapes = {s: k + 1 for k, s in enumerate(scene.shapes())}
    materials = {s.bsdf(): k + 1 for k, s in enumerate(unique_materials(scene, mi))}
    for p, direction in enumerate(directions.tolist()):
        ray = mi.Ray3f(origin.tolist(), direction)
        si = scene.ray_intersect(ray)
        for _ in range(MAX_PASSED):
            if not si.is_valid() or not (_clear(mi, si, si.bsdf(ray)) or (hidden and si.shape.is_emitter())):
                break
            si = scene.ray_intersect(si.spawn_ray(ray.d))
        if not si.is_valid():
            continue
        hit[p], bsdf = True, si.bsdf(ray)
        vectors[:, p] = si.p, si.sh_frame.n, si.n, _albedo_scalar(mi, bsdf, si)
        numbers[:, p] = shapes.get(si.instance or si.shape, 0), materials.get(bsdf, 0)
    return hit, *vectors, *numbers


def _clear(mi: Any, si: Any, bsdf: Any) -> bool:
    """Whether a ray goes through a surface as if it were not there, in a scalar variant."""
    if bsdf.flags() & int(mi.BSDFFlags.All) == int(mi.BSDFFlags.Null):
        return True
    if not _has_holes(mi, bsdf):
        return False
    return bool(np.mean(_unpolarized(mi, bsdf.eval_null_transmission(si))) > CLEAR)


def _albedo_scalar(mi: Any, bsdf: Any, si: Any) -> NDArray[np.float64]:
    """As `_albedo` of one surface, in a scalar variant."""
    if mi.is_rgb:
        return np.array(bsdf.eval_diffuse_reflectance(si), dtype=np.float64)
    total = np.zeros(3)
    for wavelengths, weights in zip(*_daylight_groups(), strict=True):
        si.wavelengths = wavelengths.tolist()
        spectrum = bsdf.eval_diffuse_reflectance(si)
        total += np.array(_unpolarized(mi, spectrum), dtype=np.float64).ravel()[:4] @ weights
    return np.clip(total, 0, 1)
