"""Close-ups: glassware with caustics, and a thicket of things thinner than a pixel."""

from __future__ import annotations

from typing import Any

import numpy as np

from simscenes.scenes.parts import shapes as s
from simscenes.scenes.parts import textures as t
from simscenes.scenes.scene import ROOM, Scene, orbit


def glassware(seed: int = 0) -> dict[str, Any]:
    """Glasses, a decanter, a glass ball and gold rings on a printed cloth, under a small bright lamp.

    Hard for: refraction (things behind glass move against the view), specular reflection, and caustics, which path
    tracing finds rarely: bright isolated pixels are reported, not hidden. World z is up, the floor is z = 0.

    Args:
        seed: Varies every texture and the places of the glasses.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 10])
    cloth = t.bordered(t.motif((384, 384), rng, repeats=(7, 7), colors=("efe6d2", "2a5a8c", "c65d3b")), "8c2f39", 0.04)
    walls = [t.painting((256, 320), rng, colors=("1d3557", "e63946", "f1e4c8", "457b9d", "ffb703")) for _ in range(3)]
    clear = s.glass()
    goblet = [
        (0, 0), (0.11, 0), (0.11, 0.012), (0.02, 0.035), (0.018, 0.2), (0.09, 0.28), (0.13, 0.4), (0.11, 0.52),
        (0.1, 0.52), (0.118, 0.4), (0.08, 0.3), (0, 0.26),
    ]  # fmt: skip
    decanter = [(0, 0), (0.16, 0), (0.18, 0.05), (0.15, 0.22), (0.05, 0.36), (0.045, 0.5), (0.07, 0.54), (0, 0.54)]
    ring = np.linspace(0, 2 * np.pi, 17)
    torus = np.stack([0.12 + 0.03 * np.cos(-ring), 0.03 + 0.03 * np.sin(-ring)], -1)[::-1]
    parts: dict[str, Any] = {
        "type": "scene",
        "lamp": s.area_light((0.7, -0.9, 2.2), (0.4, 0, 0), (0, -0.4, 0), (19.0, 17.0, 14.0)),
        "window": s.area_light((-1.95, 0.0, 1.4), (0, 0.6, 0), (0, 0, 0.6), (1.2, 1.5, 2.0)),
        **s.stage(cloth, walls, half=2.0, height=2.4),
        "decanter": s.lathe(decanter, clear, (-0.35, 0.25, 0.002)),
        "crystal": s.ball((0.02, -0.3, 0.162), 0.16, clear),
        "ring_0": s.lathe(torus, s.metal("Au", 0.15), (0.45, -0.35, 0.0), smooth=False),
        "ring_1": s.lathe(torus, s.metal("Cu", 0.2), (-0.4, -0.35, 0.0), smooth=False),
    }
    for k, (x, y) in enumerate([(0.3, 0.2), (0.6, 0.0), (0.05, 0.5)]):
        place = (x + float(rng.uniform(-0.04, 0.04)), y + float(rng.uniform(-0.04, 0.04)), 0.002)
        parts[f"goblet_{k}"] = s.lathe(goblet, clear, place)
    for k in range(4):
        skin = s.diffuse(t.cells((64, 128), rng, count=60, colors=("6d1f3c", "a83a52", "d98f6f"), joint=0.4))
        parts[f"berry_{k}"] = s.ball((-0.6 + 0.13 * k, 0.6 - 0.05 * (k % 2), 0.07), 0.07, skin)
    return parts


GLASSWARE = Scene(glassware, orbit(48.0, target=(0.05, 0.05, 0.2), radius=1.5, elevation_deg=22.0, **ROOM))


def thicket(seed: int = 0) -> dict[str, Any]:
    """Dry grass, wires and lattices, mostly thinner than a pixel, before a patterned ground.

    Hard for: fine structure: every pixel mixes foreground and background, depth has no single value in it, and points
    on thin things are seen by few views. World z is up, the floor is z = 0, metres.

    Args:
        seed: Varies every texture, blade and wire.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 11])
    ground = t.cells((384, 384), rng, count=160, colors=("4a3a26", "7a6440", "a08a5c", "5f5a3a"), joint=0.3)
    walls = [
        t.motif((256, 256), rng, repeats=(4, 4), colors=c)
        for c in (("2f4a4f", "b9c4a7", "5d7f7a"), ("6b3a32", "dcc19a", "a8705a"), ("3b4264", "c3bfc9", "6d7aa0"))
    ]
    count = 700
    away, turn = 0.85 * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    foot = np.column_stack([away * np.cos(turn), away * np.sin(turn), np.zeros(count)])
    tip = foot + np.column_stack([rng.normal(0, 0.13, (count, 2)), rng.uniform(0.3, 0.95, count)])
    straw = s.twosided(s.diffuse(t.wood((128, 128), rng, planks=12, colors=("5f6b2a", "a89a4a", "d9c98a", "8a6a3a"))))
    wire = s.twosided(s.diffuse(t.finish(np.full((32, 64, 3), 0.12), rng, grain=0.4)))
    stone = s.diffuse(t.marble((96, 192), rng, colors=("8d8478", "6b635a", "3f3a35")))
    rungs = np.linspace(-0.9, 0.9, 19)
    vertical = np.array([[(x, 0.95, 0.05), (x, 0.95, 1.25)] for x in rungs])
    level = np.array([[(-0.95, 0.95, z), (0.95, 0.95, z)] for z in np.linspace(0.1, 1.2, 12)])
    lattice = np.concatenate([vertical, level])
    hoops = np.linspace(0, 2 * np.pi, 33)
    circle = np.column_stack([0.75 * np.cos(hoops), 0.75 * np.sin(hoops), 0.6 + 0.25 * np.sin(3 * hoops)])
    return {
        "type": "scene",
        "sky": s.area_light((0.2, -0.4, 2.55), (0.9, 0, 0), (0, -0.9, 0), (3.6, 3.5, 3.2)),
        **s.stage(ground, walls),
        "grass": s.ribbons(foot, tip, 0.014, straw),
        "lattice": s.ribbons(lattice[:, 0], lattice[:, 1], 0.014, wire),
        "hoop": s.ribbons(circle[:-1], circle[1:], 0.012, wire),
        "stone": s.ball((0.5, -0.35, 0.12), 0.2, stone, squash=0.7),
        "post": s.box((-0.55, -0.3, 0.4), (0.08, 0.08, 0.8), s.diffuse(t.wood((128, 32), rng, planks=1)), yaw=30),
    }


THICKET = Scene(thicket, orbit(52.0, target=(0.0, 0.0, 0.45), radius=1.7, elevation_deg=18.0, **ROOM))
