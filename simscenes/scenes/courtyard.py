"""A courtyard in the sun: the outdoor scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from simscenes.scenes.parts import shapes as s
from simscenes.scenes.parts import textures as t
from simscenes.scenes.scene import Scene, orbit

_WALL = 4.2  # half width of the yard


def courtyard(seed: int = 0) -> dict[str, Any]:
    """A paved yard with a tree, a fountain, an iron fence and house fronts, under a low sun and a blue sky.

    Hard for: the contrast between sunlit walls and shadow (more than 30 to 1), structure finer than a pixel (leaves,
    railings, glazing bars), and open sky, where no surface stops the ray. World z is up, the ground is z = 0, metres.

    Args:
        seed: Varies every texture, the tree and the plants.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 3])
    ground = t.cells((512, 512), rng, count=160, colors=("5c574e", "8c8474", "b3a68f", "766d60", "c4b79d"), joint=0.16)
    return {
        "type": "scene",
        "sky": _sky(rng),
        "sun": {"type": "directional", "direction": [0.62, 0.42, -0.66],
                "irradiance": {"type": "rgb", "value": [17.0, 14.6, 11.2]}},
        "ground": s.quad((0, 0, 0), (_WALL + 2, 0, 0), (0, _WALL + 2, 0), s.diffuse(ground, tile=(3, 3))),
        **_houses(rng), **_fountain(rng), **_tree(rng), **_garden(rng),
    }  # fmt: skip


COURTYARD = Scene(
    courtyard,
    orbit(60.0, target=(0.1, 0.1, 0.95), radius=3.5, elevation_deg=14.0, swing_deg=7.0, start_deg=-195.0,
          sweep_deg=195.0),
)  # fmt: skip


def _sky(rng: t.Rng) -> dict[str, Any]:
    """Blue gradient with clouds; below the horizon the light that distant ground sends back."""
    import mitsuba as mi

    height, width = 64, 128
    elevation = np.linspace(np.pi / 2, -np.pi / 2, height)[:, None]
    clouds = np.clip(0.5 + 0.7 * t.fractal((height, width), rng, beta=1.5, stretch=(2, 1)), 0, 1)[..., None]
    haze = np.clip(1 - np.sin(np.clip(elevation, 0, None)), 0, 1)[..., None]
    blue = np.array([0.35, 0.72, 1.5]) * (1 - haze) + np.array([1.1, 1.35, 1.6]) * haze**1.5
    radiance = np.where(elevation[..., None] > 0, blue + 0.9 * clouds, np.array([0.25, 0.22, 0.18]))
    texels = mi.Bitmap(np.ascontiguousarray(np.broadcast_to(radiance, (height, width, 3)), dtype=np.float32))
    upright = mi.ScalarTransform4f().rotate([1, 0, 0], 90)  # Mitsuba's environment has y up
    return {"type": "envmap", "bitmap": texels, "to_world": upright}


def _front(rng: t.Rng, kind: int) -> tuple[t.Texels, tuple[str, ...]]:
    brick = (
        ("5c2a1e", "8f4a33", "b5694a", "d39a77"),
        ("6a5238", "9c7b52", "c6a77a", "e0cba6"),
        ("4d3b36", "7b625a", "a58d7f", "cbb9a6"),
    )
    shutters = (("1f4d3a", "2f7357", "5a9b7c"), ("243b63", "3c5d94", "6f8fbf"), ("6b2020", "9a3a30", "c0695a"))
    return t.bricks((512, 768), rng, rows=24, columns=16, colors=brick[kind % 3]), shutters[kind % 3]


def _houses(rng: t.Rng) -> dict[str, Any]:
    """Four fronts with windows, shutters, sills and a door, each built facing +x, then turned to its side."""
    parts: dict[str, Any] = {}
    heights = (3.6, 4.4, 3.2, 4.0)
    for k, side in enumerate((0, 90, 180, 270)):
        wall, shutter_colors = _front(rng, k)
        wood = s.diffuse(t.wood((64, 128), rng, planks=6, colors=shutter_colors))
        stone = s.diffuse(t.marble((64, 64), rng, colors=("cfc6b4", "a99f8c", "857c6c")))
        pane = s.plastic(
            t.mottled((64, 64), rng, ("0c1216", "26343c", "4a5a60")),
            0.05,
        )
        a = np.radians(side)
        out, along = np.array([np.cos(a), np.sin(a), 0]), np.array([-np.sin(a), np.cos(a), 0])
        height = heights[k]
        parts[f"house_{k}"] = s.quad(
            -_WALL * out + [0, 0, height / 2], -along * _WALL * -1, np.array([0, 0, height / 2]), s.diffuse(wall)
        )
        parts[f"roof_{k}"] = s.box(-(_WALL + 0.1) * out + [0, 0, height], (0.5, 2 * _WALL, 0.12), stone, yaw=side)
        for j, place in enumerate((-2.6, -0.9, 0.9, 2.6)):
            for level, z in enumerate((1.05, 2.55)):
                if z + 0.6 > height - 0.2 or (level == 0 and j == k % 4):
                    continue
                center = -_WALL * out + place * along + np.array([0, 0, z])
                parts[f"pane_{k}_{j}_{level}"] = s.box(center, (0.06, 0.62, 0.9), pane, yaw=side)
                parts[f"sill_{k}_{j}_{level}"] = s.box(
                    center - [0, 0, 0.5] + 0.08 * out, (0.22, 0.8, 0.07), stone, yaw=side
                )
                for bar, (dy, dz, wy, wz) in enumerate([(0, 0, 0.04, 0.9), (0, 0.1, 0.62, 0.04)]):
                    parts[f"bar_{k}_{j}_{level}_{bar}"] = s.box(
                        center + dy * along + [0, 0, dz] + 0.04 * out, (0.05, wy, wz), stone, yaw=side
                    )
                for hand in (-1, 1):
                    parts[f"shutter_{k}_{j}_{level}_{hand}"] = s.box(
                        center + 0.5 * hand * along + 0.03 * out, (0.05, 0.32, 0.95), wood, yaw=side
                    )
        door = -_WALL * out + (-2.6, -0.9, 0.9, 2.6)[k % 4] * along + np.array([0, 0, 0.85])
        parts[f"door_{k}"] = s.box(door, (0.1, 0.8, 1.7), wood, yaw=side)
    return parts


def _fountain(rng: t.Rng) -> dict[str, Any]:
    stone = s.diffuse(t.marble((192, 384), rng, colors=("d8cfbd", "a79c88", "6f675a")))
    basin = [
        (0, 0), (0.9, 0), (0.95, 0.05), (0.9, 0.1), (0.86, 0.32), (0.95, 0.38), (0.93, 0.42), (0.8, 0.42),
        (0.78, 0.3), (0, 0.28),
    ]  # fmt: skip
    column = [
        (0.2, 0.28), (0.16, 0.4), (0.1, 0.6), (0.12, 0.85), (0.42, 1.0), (0.45, 1.06), (0.4, 1.06), (0.1, 0.98),
        (0.06, 1.2), (0.12, 1.32), (0.1, 1.42), (0, 1.5),
    ]  # fmt: skip
    water = s.plastic(
        t.mottled((128, 128), rng, ("10302f", "2a5a55", "5f8f86")),
        0.05,
    )
    return {
        "basin": s.lathe(basin, stone, (-0.9, -0.5, 0)),
        "column": s.lathe(column, stone, (-0.9, -0.5, 0)),
        "water": s.lathe([(0.8, 0.34), (0.4, 0.34), (0, 0.34)], water, (-0.9, -0.5, 0), smooth=False),
    }


def _tree(rng: t.Rng) -> dict[str, Any]:
    """A trunk of turned segments and a crown of some thousand single leaves, all in one mesh."""
    bark = s.diffuse(t.wood((128, 64), rng, planks=5, colors=("2c2018", "54402f", "83694e")))
    foot, parts = np.array([1.5, 1.1, 0.0]), {}
    trunk = [(0.26, 0), (0.17, 0.2), (0.13, 0.7), (0.11, 1.3), (0.05, 2.3), (0, 2.6)]
    parts["trunk"] = s.lathe(trunk, bark, foot.tolist())
    for k in range(5):
        branch = [(0.055, 0), (0.04, 0.5), (0.0, 1.1)]
        parts[f"branch_{k}"] = s.lathe(
            branch, bark, (foot + [0, 0, 1.15 + 0.18 * k]).tolist(), 72.0 * k + 20, tilt=52, segments=10
        )
    count = 1500
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    lumps = 1 + 0.3 * np.sin(3 * direction @ rng.normal(size=3)) * np.cos(4 * direction @ rng.normal(size=3))
    center = (
        foot + [0, 0, 2.35] + direction * (lumps * rng.uniform(0.45, 1, count) ** 0.5)[:, None] * [1.15, 1.15, 0.85]
    )
    u = rng.normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(u, direction + 0.3 * rng.normal(size=(count, 3)))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    size = rng.uniform(0.05, 0.1, (count, 1))
    corners = np.stack([center - size * u, center - 0.45 * size * v, center + size * u, center + 0.45 * size * v], 1)
    faces = (4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    shade = rng.uniform(0, 1, (count, 1, 2)) * [0.96, 0.96] + np.array([[0, 0], [0.04, 0], [0.04, 0.04], [0, 0.04]])
    green = t.mottled((64, 64), rng, ("24401a", "4c7a2a", "86a845", "b9b95a"))
    parts["leaves"] = s.mesh(corners.reshape(-1, 3), faces, shade.reshape(-1, 2), s.twosided(s.diffuse(green)))
    return parts


def _garden(rng: t.Rng) -> dict[str, Any]:
    """An iron fence, pots with plants, and a bench."""
    iron = s.plastic(t.finish(np.full((32, 32, 3), 0.05), rng, grain=0.3), 0.2)
    clay = s.diffuse(t.mottled((64, 64), rng, ("6e3320", "a85a38", "cf8a5e"), contrast=0.25))
    plank = s.diffuse(t.wood((96, 192), rng, planks=3, colors=("5a2f1d", "8a5233", "b98357")))
    parts: dict[str, Any] = {}
    for k in range(15):
        parts[f"fence_{k}"] = s.box((-2.9 + 0.22 * k, -2.3, 0.45), (0.03, 0.03, 0.9), iron)
    for k, z in enumerate((0.2, 0.75)):
        parts[f"rail_{k}"] = s.box((-1.36, -2.3, z), (3.2, 0.025, 0.03), iron)
    pot = [(0, 0), (0.16, 0), (0.2, 0.3), (0.24, 0.31), (0.24, 0.36), (0.2, 0.36), (0.17, 0.32), (0, 0.3)]
    for k, (x, y) in enumerate([(0.6, -1.9), (1.15, -2.1), (-2.6, 1.6), (-2.1, 2.1), (2.6, -0.6)]):
        parts[f"pot_{k}"] = s.lathe(pot, clay, (x, y, 0))
        bloom = t.cells(
            (64, 128),
            rng,
            count=120,
            colors=("2f5a1f", "6f9a3a", ("c2374f", "e0a030", "b04aa0")[k % 3], "4c7a2a"),
            joint=0.5,
        )
        parts[f"plant_{k}"] = s.ball((x, y, 0.5), 0.25, s.diffuse(bloom), yaw=50.0 * k, squash=1.1)
    for k, (dy, z) in enumerate([(-0.14, 0.42), (0.0, 0.42), (0.14, 0.42), (0.24, 0.62), (0.26, 0.78)]):
        parts[f"bench_{k}"] = s.box((0.1, 2.3 + dy, z), (1.5, 0.11, 0.04), plank, tilt=80 if z > 0.5 else 0)
    for k, x in enumerate((-0.55, 0.75)):
        parts[f"bench_leg_{k}"] = s.box((x, 2.35, 0.2), (0.07, 0.4, 0.4), iron)
    return parts
