"""What the ray through each pixel centre hits: depth, normals, albedo, ids.

Mitsuba's AOVs are not used: their depth starts at the near plane, they average over the pixel, and their ids are
process-wide numbers blended at edges.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.camera import WAVELENGTHS, daylight, srgb_curves
from simscenes.loading.contents import unique_materials
from simscenes.loading.load import LoadedScene
from simscenes.render.wavefront import from_numpy
from simscenes.rigs import Rig, invert_rigid

MAX_INTERFACES = 16  # boundaries of fog and the like, which do not bend rays and are passed through

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
        camera, albedo.R/G/B (what the surface reflects diffusely), id and material (uint32). Pixels without a surface
        have an infinite Z and distance, and 0 in all other channels.
    """
    origin, directions = pixel_rays(rig, i)
    find = _intersect_scalar if mi.variant().startswith("scalar") else _intersect_wide
    hit, position, shading, geometric, albedo, shape, material = find(mi, loaded.scene, origin, directions)
    facing = np.where(np.einsum("pj,pj->p", geometric, directions) > 0, -1.0, 1.0)[:, None]
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
        ("N", facing * shading, "XYZ"),
        ("Ng", facing * geometric, "XYZ"),
        ("albedo", albedo, "RGB"),
    ):
        for k, axis in enumerate(axes):
            channels[f"{name}.{axis}"] = np.where(hit, field[:, k], 0).reshape(image).astype(np.float32)
    return channels


def check_cameras(mi: Any, loaded: LoadedScene, rig: Rig) -> None:
    """Refuse cameras inside an opaque object, whose picture would be black without explanation.

    Raises:
        ValueError: If most of what a view sees are the unlit backs of one-sided surfaces.
    """
    sides = [s.bsdf().flags() & int(mi.BSDFFlags.BackSide) for s in unique_materials(loaded.scene, mi)]
    one_sided = np.array([False, *(not back for back in sides)])
    for i in range(len(rig)):
        small = shrunk(rig, i)
        origin, directions = pixel_rays(small, 0)
        find = _intersect_scalar if mi.variant().startswith("scalar") else _intersect_wide
        hit, _, _, geometric, _, shape, material = find(mi, loaded.scene, origin, directions)
        back = hit & one_sided[material] & (np.einsum("pj,pj->p", geometric, directions) > 0)
        if back.mean() > 0.5:
            names = ["", *loaded.shapes]
            inside = names[int(np.bincount(shape[back]).argmax())]
            raise ValueError(f"view {i} at {origin.round(3).tolist()} sees the inside of {inside!r}, which is "
                             "one-sided: move the camera out of it, or make the material twosided")  # fmt: skip


def shrunk(rig: Rig, i: int, size: int = 8) -> Rig:
    """View `i` alone, with a field of view as before and only a few pixels."""
    stretch = np.diag([size / rig.width, size / rig.height, 1.0])
    return Rig(viewmats=rig.viewmats[i : i + 1], Ks=stretch @ rig.Ks[i : i + 1], width=size, height=size)


def first_surfaces(mi: Any, scene: Any, origin: NDArray[Any], directions: NDArray[Any]) -> tuple[Any, Any]:
    """Rays from one point and what each hits first, passing through boundaries of fog; in a JIT variant.

    Both are evaluated, in one kernel that serves every number of rays: compiling takes longer than running it.
    """
    import drjit as dr

    # Axis by axis, and the origin opaque: else the number of rays, and the origin, would be compiled into the kernel.
    direction = mi.Vector3f(*(from_numpy(mi.Float, axis) for axis in directions.T.astype(np.float32)))
    ray = mi.Ray3f(mi.Point3f(*(dr.opaque(mi.Float, float(v)) for v in origin)), direction)
    si = scene.ray_intersect(ray)
    for _ in range(MAX_INTERFACES):
        dr.eval(ray, si)  # together: gathering from what is not would compile a kernel for each of its fields
        through = si.is_valid() & ((si.bsdf(ray).flags() & int(mi.BSDFFlags.All)) == int(mi.BSDFFlags.Null))
        if not dr.any(through):
            break
        si = dr.select(through, scene.ray_intersect(si.spawn_ray(ray.d), through), si)
    return ray, si


def _intersect_wide(mi: Any, scene: Any, origin: NDArray[Any], directions: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """All rays at once, in a JIT variant."""
    import drjit as dr

    ray, si = first_surfaces(mi, scene, origin, directions)
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
    found = mi.unpolarized_spectrum(spectrum) if mi.is_polarized else spectrum
    values = np.array(found, dtype=np.float64).reshape(4, len(groups), pixels)
    return np.clip(np.einsum("kgp,gkc->pc", values, weights), 0, 1)


def _daylight_groups() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Wavelengths in groups of four, [g,4], and what the reflectance at each adds to linear sRGB, [g,4,3]."""
    chosen = slice(0, 80, 2)
    seen = daylight()[chosen, None] * srgb_curves()[chosen]
    return WAVELENGTHS[chosen].reshape(-1, 4), (seen / seen.sum(0)).reshape(-1, 4, 3)


def _numbers(dr: Any, uint32: Any, known: list[Any], pointers: Any) -> NDArray[np.uint32]:
    """Replace process-wide registry numbers by 1 + the index in `known`."""
    registry = [int(dr.reinterpret_array(uint32, pointer)[0]) for pointer in known]
    table = np.zeros(max(registry, default=0) + 1, dtype=np.uint32)
    table[registry] = np.arange(1, len(registry) + 1)
    return table[np.array(dr.reinterpret_array(uint32, pointers))]


def _intersect_scalar(mi: Any, scene: Any, origin: NDArray[Any], directions: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Ray by ray, in a scalar variant."""
    count = len(directions)
    hit, vectors = np.zeros(count, dtype=bool), np.zeros((4, count, 3))
    numbers = np.zeros((2, count), dtype=np.uint32)
    shapes = {s: k + 1 for k, s in enumerate(scene.shapes())}
    materials = {s.bsdf(): k + 1 for k, s in enumerate(unique_materials(scene, mi))}
    for p, direction in enumerate(directions.tolist()):
        ray = mi.Ray3f(origin.tolist(), direction)
        si = scene.ray_intersect(ray)
        for _ in range(MAX_INTERFACES):
            if not si.is_valid() or si.bsdf(ray).flags() & int(mi.BSDFFlags.All) != int(mi.BSDFFlags.Null):
                break
            si = scene.ray_intersect(si.spawn_ray(ray.d))
        if not si.is_valid():
            continue
        hit[p], bsdf = True, si.bsdf(ray)
        vectors[:, p] = si.p, si.sh_frame.n, si.n, _albedo_scalar(mi, bsdf, si)
        numbers[:, p] = shapes.get(si.instance or si.shape, 0), materials.get(bsdf, 0)
    return hit, *vectors, *numbers


def _albedo_scalar(mi: Any, bsdf: Any, si: Any) -> NDArray[np.float64]:
    """As `_albedo` of one surface, in a scalar variant."""
    if mi.is_rgb:
        return np.array(bsdf.eval_diffuse_reflectance(si), dtype=np.float64)
    total = np.zeros(3)
    for wavelengths, weights in zip(*_daylight_groups(), strict=True):
        si.wavelengths = wavelengths.tolist()
        spectrum = bsdf.eval_diffuse_reflectance(si)
        found = mi.unpolarized_spectrum(spectrum) if mi.is_polarized else spectrum
        total += np.array(found, dtype=np.float64).ravel()[:4] @ weights
    return np.clip(total, 0, 1)
