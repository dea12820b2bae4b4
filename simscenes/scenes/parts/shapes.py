"""Short names for the pieces of a Mitsuba scene dict: materials, placed shapes, meshes of revolution, rooms.

Everything here returns Mitsuba objects or dicts, so a variant must be active (`simscenes.backend.activate`). Lengths
are in scene units, angles in degrees, rotations are about +z unless said otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Dict = dict[str, Any]
Floats = NDArray[np.float64]


def bitmap(texels: ArrayLike, *, tile: tuple[float, float] = (1.0, 1.0)) -> Dict:
    """A texture of linear RGB values [h,w,3], repeated `tile` times along u and v."""
    import mitsuba as mi

    texels = np.ascontiguousarray(texels, dtype=np.float32)
    to_uv = mi.ScalarTransform3f().scale([tile[0], tile[1]])
    return {"type": "bitmap", "bitmap": mi.Bitmap(texels), "wrap_mode": "repeat", "to_uv": to_uv}


def material(description: Dict) -> Any:
    """Instantiate a material once, so that the shapes sharing it also share its memory and precomputed tables."""
    import mitsuba as mi

    return mi.load_dict(description)


def diffuse(texels: ArrayLike, **kwargs: Any) -> Any:
    """Lambertian surface with a texture [h,w,3]."""
    return material({"type": "diffuse", "reflectance": bitmap(texels, **kwargs)})


def plastic(texels: ArrayLike, roughness: float = 0.15, **kwargs: Any) -> Any:
    """Varnished or glazed surface: a texture [h,w,3] under a rough dielectric coat."""
    return material({"type": "roughplastic", "diffuse_reflectance": bitmap(texels, **kwargs), "alpha": roughness})


def metal(element: str, roughness: float) -> Any:
    """Rough conductor with the measured index of refraction of Cu, Au, Cr, ..."""
    return material({"type": "roughconductor", "material": element, "alpha": roughness, "distribution": "ggx"})


def glass() -> Any:
    """Smooth solid glass."""
    return material({"type": "dielectric", "int_ior": "bk7", "ext_ior": "air"})


def twosided(bsdf: Any) -> Any:
    """The same opaque material on both faces."""
    return material({"type": "twosided", "bsdf": bsdf})


def place(position: ArrayLike = (0, 0, 0), yaw: float = 0, size: Sequence[float] | float = 1, tilt: float = 0) -> Any:
    """Transform: scale, tilt about x, turn about z, move."""
    import mitsuba as mi

    moved = mi.ScalarTransform4f().translate(np.asarray(position, dtype=np.float64))
    return (
        moved.rotate([0, 0, 1], yaw)
        .rotate([1, 0, 0], tilt)
        .scale([size] * 3 if isinstance(size, (int, float)) else list(size))
    )


def quad(center: ArrayLike, half_u: ArrayLike, half_v: ArrayLike, bsdf: Any, emitter: Dict | None = None) -> Any:
    """Rectangle of half edges `half_u`, `half_v`; its front side, and its emission, point along half_u x half_v."""
    # Two triangles, not Mitsuba's rectangle: Embree calls back for shapes that are not triangles, and keeps a second
    # acceleration structure for them, which every ray has to visit.
    center, half_u, half_v = (np.asarray(a, dtype=np.float64) for a in (center, half_u, half_v))
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    vertices = center + corners[:, :1] * half_u + corners[:, 1:] * half_v
    return mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), (corners + 1) / 2, bsdf, emitter=emitter)


def box(center: ArrayLike, size: Sequence[float], bsdf: Any, yaw: float = 0, tilt: float = 0) -> Dict:
    """Box of full edge lengths `size`; the texture covers each face once."""
    return {"type": "cube", "to_world": place(center, yaw, [s / 2 for s in size], tilt), "bsdf": bsdf}


def ball(
    center: Sequence[float],
    radius: float,
    bsdf: Any,
    yaw: float = 0,
    squash: float = 1,
    tilt: float = 0,
    emitter: Dict | None = None,
) -> Any:
    """Spheroid as a mesh with smooth normals; `squash` is its height over its width."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 25)
    profile = radius * np.stack([np.cos(angle), squash * np.sin(angle)], -1)
    return lathe(profile, bsdf, center, yaw, tilt=tilt, smooth=False, emitter=emitter)


def mesh(
    vertices: Floats,
    faces: NDArray[Any],
    uv: Floats,
    bsdf: Any,
    normals: Floats | None = None,
    emitter: Dict | None = None,
) -> Any:
    """Triangle mesh: vertices [n,3], faces [m,3], uv [n,2], optional vertex normals [n,3] and area emitter."""
    import mitsuba as mi

    props = mi.Properties()
    props["bsdf"] = bsdf
    if emitter is not None:
        props["emitter"] = mi.load_dict(emitter)
    shape = mi.Mesh("mesh", len(vertices), len(faces), props, normals is not None, True)
    params = mi.traverse(shape)
    params["vertex_positions"] = np.ravel(vertices).astype(np.float32)
    params["faces"] = np.ravel(faces).astype(np.uint32)
    params["vertex_texcoords"] = np.ravel(uv).astype(np.float32)
    if normals is not None:
        params["vertex_normals"] = np.ravel(normals).astype(np.float32)
    params.update()
    return shape


def grid_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Triangles [m,3] of a rows x columns grid of vertices."""
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([first, first + 1, first + columns + 1], -1)
    return np.concatenate([lower, np.stack([first, first + columns + 1, first + columns], -1)])


def _smoothed(knots: Floats) -> Floats:
    """A curve [32,2] through (radius, height) points [n,2], for turned objects."""
    from scipy.interpolate import PchipInterpolator

    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    return PchipInterpolator(along, knots)(np.linspace(0, along[-1], 32))


def _revolve(half: Floats, around: Floats) -> Floats:
    """Turn (radius, height) pairs [n,2] to every direction [m,2] around the axis: [n,m,3]."""
    height = np.broadcast_to(half[:, None, 1:], (len(half), len(around), 1))
    return np.concatenate([half[:, None, :1] * around[None], height], -1)


def lathe(
    profile: ArrayLike,
    bsdf: Any,
    position: Sequence[float] = (0, 0, 0),
    yaw: float = 0,
    *,
    segments: int = 32,
    tilt: float = 0,
    smooth: bool = True,
    emitter: Dict | None = None,
) -> Any:
    """Mesh of revolution about z of a (radius, height) profile; walked upwards, the outside is the front.

    Args:
        profile: (radius, height) pairs [n,2]; radius 0 closes an end.
        bsdf: Material; u runs around, v along the profile.
        position: Where the profile's origin goes.
        yaw: Turn about z, degrees.
        segments: Facets around the axis.
        tilt: Lean about x before the turn, degrees.
        smooth: Resample the profile to a smooth curve first.
        emitter: Makes it glow.
    """
    points = np.asarray(profile, dtype=np.float64)
    points = _smoothed(points) if smooth else points
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    tangent = np.gradient(points, along, axis=0)
    slope = np.stack([tangent[:, 1], -tangent[:, 0]], -1) / np.linalg.norm(tangent, axis=1, keepdims=True)
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    around = np.stack([np.cos(angle), np.sin(angle)], -1)
    vertices, normals = _revolve(points, around), _revolve(slope, around)
    u, v = np.broadcast_arrays(angle[None] / (2 * np.pi), (along / along[-1])[:, None])
    matrix = np.array(place(position, yaw, 1, tilt).matrix, dtype=np.float64)
    vertices = vertices.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    normals = normals.reshape(-1, 3) @ matrix[:3, :3].T
    uv = np.stack([u, v], -1).reshape(-1, 2)
    return mesh(vertices, grid_faces(len(points), segments + 1), uv, bsdf, normals, emitter)


def area_light(center: ArrayLike, half_u: ArrayLike, half_v: ArrayLike, radiance: Sequence[float] | Dict) -> Any:
    """Glowing rectangle; light leaves its front side only, along half_u x half_v. `radiance`: RGB, or a spectrum."""
    return quad(center, half_u, half_v, diffuse(np.full((2, 2, 3), 0.3)), glow(radiance))


def glow(radiance: Sequence[float] | Dict) -> Dict:
    """Area emitter for any shape. `radiance`: RGB, or a spectrum dict."""
    spectrum = radiance if isinstance(radiance, dict) else {"type": "rgb", "value": list(radiance)}
    return {"type": "area", "radiance": spectrum}


def lamp_spectrum(name: str, level: float) -> Dict:
    """Measured spectrum of a lamp from CIE tables ("HP1" sodium, "LED-B3", ...), scaled to luminance-weighted `level`.

    `level` is the radiance a flat spectrum of the same luminance would have, so lamps of one level look equally bright.
    """
    import colour

    table = colour.SDS_ILLUMINANTS[name].copy().align(colour.SpectralShape(380, 780, 5))
    weight = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(table.shape).values[:, 1]
    values = level * table.values * weight.sum() / (table.values * weight).sum()
    return {"type": "spectrum", "value": list(zip(table.wavelengths.tolist(), values.tolist(), strict=True))}


def stage(floor: ArrayLike, walls: Sequence[ArrayLike], half: float = 2.0, height: float = 2.6) -> Dict:
    """Floor z = 0 and up to four walls (north, east, west, south) around the origin, from their textures [h,w,3]."""
    sides = {"north": (0, 1), "east": (1, 0), "west": (-1, 0), "south": (0, -1)}
    parts: Dict = {"floor": quad((0, 0, 0), (half, 0, 0), (0, half, 0), diffuse(floor))}
    for (name, (x, y)), texels in zip(sides.items(), walls, strict=False):
        center = (half * x, half * y, height / 2)
        parts[f"wall_{name}"] = quad(center, (half * y, -half * x, 0), (0, 0, height / 2), diffuse(texels))
    return parts


def ribbons(starts: Floats, ends: Floats, width: float, bsdf: Any) -> Any:
    """Thin flat strips from `starts` to `ends` [n,3], two crossed ones each so that they show from every side."""
    along = ends - starts
    helper = np.where(
        np.abs(along[:, 2:]) < 0.9 * np.linalg.norm(along, axis=1, keepdims=True), [0.0, 0, 1], [1.0, 0, 0]
    )
    first = np.cross(along, helper)
    first *= 0.5 * width / np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(along, first)
    second *= 0.5 * width / np.linalg.norm(second, axis=1, keepdims=True)
    corners = [np.stack([starts - side, starts + side, ends + side, ends - side], 1) for side in (first, second)]
    vertices = np.concatenate(corners).reshape(-1, 3)
    faces = (4 * np.arange(len(vertices) // 4)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    uv = np.tile([[0.0, 0], [0.1, 0], [0.1, 1], [0, 1]], (len(vertices) // 4, 1))
    uv[:, 0] += np.repeat(np.linspace(0, 0.9, len(vertices) // 4), 4)
    return mesh(vertices, faces, uv, bsdf)
