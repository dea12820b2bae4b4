"""Rooms by day: a matt still life, a white gallery of indirect light, a hall with a bare wall."""

from __future__ import annotations

from typing import Any

import numpy as np

from simscenes.scenes.parts import shapes as s
from simscenes.scenes.parts import textures as t
from simscenes.scenes.scene import ROOM, Scene, orbit

_CANVAS = (("b9bfb8", "a9b1ab", "949e99"), ("c9bda9", "bbae98", "a89a84"))
_PAINTS = ("1d3557", "c0392b", "f1e4c8", "457b9d", "e2a73b", "3f7d58")


def studio(seed: int = 0) -> dict[str, Any]:
    """Matt things on a carpet before plain screens and one painted one, under two large softboxes.

    Hard for: nothing in particular, every surface is diffuse: the scene on which a method must work before its failures
    elsewhere mean anything. World z is up, the floor is z = 0, metres.

    Args:
        seed: Varies every texture and the turn of the things.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 4])
    carpet = t.bordered(
        t.motif((384, 384), rng, repeats=(5, 5), colors=("8a7a68", "978672", "a4937d"), edge=1.0), "5c4433"
    )
    canvas = [t.marble((256, 320), rng, colors=(c, d, e)) for c, d, e in _CANVAS]
    screens = [t.bordered(t.painting((256, 320), rng, colors=_PAINTS, strokes=12), "d8d0c0", 0.12), *canvas]
    urn = [(0, 0), (0.12, 0), (0.14, 0.04), (0.1, 0.1), (0.22, 0.3), (0.25, 0.42), (0.16, 0.56), (0.2, 0.62), (0, 0.6)]
    cone = [(0.2, 0), (0.2, 0.02), (0.02, 0.6), (0, 0.62)]
    parts: dict[str, Any] = {
        "type": "scene",
        "key": s.area_light((-1.2, -1.2, 2.6), (0.6, 0.6, 0), (0.5, -0.5, -0.2), (6.5, 6.0, 5.4)),
        "fill": s.area_light((1.4, -0.6, 2.6), (0.4, -0.6, 0), (-0.5, -0.3, 0.1), (2.4, 2.9, 3.6)),
        **s.stage(carpet, screens),
        "plinth": s.box((-0.45, 0.25, 0.2), (0.55, 0.55, 0.4), s.diffuse(t.marble((192, 192), rng)), yaw=20),
        "urn": s.lathe(
            urn,
            s.diffuse(t.motif((192, 384), rng, repeats=(2, 5), colors=("c7895b", "8a3f22", "2b1a12"))),
            (-0.45, 0.25, 0.4),
        ),
        "cone": s.lathe(cone, s.diffuse(t.wood((128, 128), rng, planks=6)), (0.55, 0.45, 0), smooth=False),
        "ball": s.ball(
            (0.5, -0.25, 0.24),
            0.24,
            s.diffuse(t.cells((192, 384), rng, count=40, colors=("e2a73b", "3f7d58", "f1e4c8", "c0392b"))),
        ),
        "small_ball": s.ball((0.02, -0.55, 0.13), 0.13, s.diffuse(t.bricks((128, 256), rng, rows=8, columns=8))),
    }
    for k, word in enumerate(("MATT", "TEST", "BED")):
        face = s.diffuse(t.lettering((128, 128), rng, word, ink=_PAINTS[k], paper="e8dcc0"))
        center = (-0.35 + 0.12 * k, -0.25 - 0.06 * k, 0.11 + 0.22 * k)
        parts[f"cube_{k}"] = s.box(
            center, (0.3 - 0.04 * k, 0.3 - 0.04 * k, 0.22), face, yaw=float(rng.uniform(-40, 40))
        )
    return parts


STUDIO = Scene(studio, orbit(52.0, target=(0.05, 0.1, 0.35), radius=1.8, elevation_deg=24.0, **ROOM))


def gallery(seed: int = 0) -> dict[str, Any]:
    """A white room with pictures and pale stone figures; coves along two walls throw all its light at the ceiling.

    Hard for: deep interreflection. Nothing the cameras see gets light from a lamp directly, the walls reflect 80 %, and
    much of the light has bounced four times and more. World z is up, the floor is z = 0, metres.

    Args:
        seed: Varies every texture and the pictures.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 5])
    pale = [t.marble((256, 320), rng, colors=("efece6", "e8e4da", "c4bdb0")) for _ in range(5)]
    floor = t.cells((320, 320), rng, count=120, colors=("d9d2c4", "a89c88", "eee8da"), joint=0.12)
    figure = [
        (0, 0), (0.2, 0), (0.2, 0.3), (0.1, 0.34), (0.16, 0.6), (0.08, 0.85), (0.12, 1.0), (0.06, 1.14), (0, 1.16),
    ]  # fmt: skip
    parts: dict[str, Any] = {
        "type": "scene",
        "cove_north": s.area_light((0, 1.78, 1.7), (1.9, 0, 0), (0, 0.18, 0), (11.0, 10.4, 9.1)),
        "lip_north": s.box((0, 1.57, 1.75), (4.0, 0.03, 0.2), s.diffuse(pale[4])),
        "cove_south": s.area_light((0, -1.78, 1.7), (1.9, 0, 0), (0, 0.18, 0), (7.0, 7.8, 9.1)),
        "lip_south": s.box((0, -1.57, 1.75), (4.0, 0.03, 0.2), s.diffuse(pale[4])),
        **s.stage(floor, pale[:4]),
        "ceiling": s.quad((0, 0, 2.6), (2, 0, 0), (0, -2, 0), s.diffuse(pale[4])),
        "figure": s.lathe(
            figure, s.diffuse(t.marble((192, 192), rng, colors=("f2eee4", "cfc4ae", "8d8068"))), (-0.5, 0.3, 0)
        ),
        "vase": s.lathe(
            [(0, 0), (0.15, 0), (0.26, 0.3), (0.1, 0.6), (0.14, 0.7), (0, 0.66)],
            s.diffuse(t.motif((128, 256), rng, repeats=(2, 5), colors=("f0eadb", "3f6f8f", "c65d3b"))),
            (0.55, -0.05, 0),
        ),
        "bench": s.box((0.1, -0.75, 0.2), (1.1, 0.35, 0.4), s.diffuse(t.wood((128, 256), rng, planks=4))),
    }
    for k, (center, size) in enumerate(
        [
            ((-0.9, 1.97, 0.95), (1.1, 0.04, 0.8)),
            ((0.75, 1.97, 1.0), (0.9, 0.04, 1.0)),
            ((1.97, 0.2, 1.15), (0.04, 1.2, 0.9)),
            ((-1.97, 0.1, 1.15), (0.04, 1.3, 0.9)),
        ]
    ):
        picture = t.bordered(t.painting((160, 224), rng, colors=_PAINTS), "7a5a2c", 0.06)
        parts[f"picture_{k}"] = s.box(center, size, s.diffuse(picture))
    return parts


GALLERY = Scene(gallery, orbit(66.0, target=(0.0, 0.2, 0.8), radius=1.7, elevation_deg=10.0, **ROOM))


def hall(seed: int = 0) -> dict[str, Any]:
    """A removal day: a bare wall of one shade, boxes, a rolled rug, a chair, a lamp on its stand and a tall plant.

    Hard for: matching and depth on a large wall without texture; only shading tells it apart, so low light leaves
    nothing but noise there. World z is up, the floor is z = 0, metres.

    Args:
        seed: Varies the other textures and the boxes.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 6])
    bare = np.full((2, 2, 3), 0.55, dtype=np.float32)
    floor = t.wood((320, 320), rng, planks=9)
    parts: dict[str, Any] = {
        "type": "scene",
        "lamp": s.area_light((0.6, -0.8, 2.55), (0.5, 0, 0), (0, -0.5, 0), (9.5, 8.6, 7.2)),
        **s.stage(floor, [bare, bare, t.bricks((320, 320), rng)]),
        "poster": s.box((-1.45, 1.98, 1.5), (0.5, 0.02, 0.65), s.diffuse(t.painting((224, 160), rng, colors=_PAINTS))),
        "skirting": s.box((0, 1.98, 0.06), (4.0, 0.03, 0.12), s.diffuse(t.wood((32, 256), rng, planks=1))),
        **_left_behind(rng),
    }
    for k, (x, y, size) in enumerate([(-0.4, 0.5, 0.5), (0.35, 0.75, 0.4), (0.75, 0.1, 0.3), (-0.1, -0.2, 0.25)]):
        card = t.lettering((96, 128), rng, f"BOX {k}", ink="4a2f1b", paper="c9a06b")
        parts[f"box_{k}"] = s.box((x, y, size / 2), (size, size, size), s.diffuse(card), yaw=float(rng.uniform(0, 90)))
    return parts


HALL = Scene(hall, orbit(60.0, target=(0.0, 0.5, 0.5), radius=1.9, elevation_deg=16.0, **ROOM))


def _left_behind(rng: t.Rng) -> dict[str, Any]:
    """Things still to be carried out of the hall."""
    wood = s.diffuse(t.wood((96, 96), rng, planks=2, colors=("3a2413", "6b4526", "94663c")))
    rug = s.diffuse(t.motif((256, 256), rng, repeats=(2, 6), colors=("6d1f2c", "a3473f", "e0c79a")))
    leaves = s.twosided(s.diffuse(t.plain((64, 64), rng, "3f6b35", grain=0.4)))
    brass = s.diffuse(t.plain((32, 32), rng, "8a6a2c", grain=0.3))
    shade = s.diffuse(t.plain((96, 192), rng, "e6d8b8", grain=0.2))
    clay = s.diffuse(t.cells((96, 192), rng, count=50, colors=("7a3b26", "9a5236", "b56a48"), joint=0.3))
    roll = [(0, -0.65), (0.11, -0.65), (0.11, 0.65), (0, 0.65)]
    parts: dict[str, Any] = {
        "rug": s.lathe(roll, rug, (-1.25, 0.7, 0.11), yaw=80, tilt=90, smooth=False),
        "stand": s.lathe(
            [(0.16, 0), (0.16, 0.02), (0.015, 0.04), (0.015, 1.35), (0, 1.36)], brass, (1.7, 1.65, 0), smooth=False
        ),
        "shade": s.lathe([(0.24, 1.25), (0.15, 1.6), (0, 1.6)], shade, (1.7, 1.65, 0), smooth=False),
        "pot": s.lathe([(0, 0), (0.14, 0), (0.19, 0.3), (0.17, 0.32), (0.15, 0.28), (0, 0.28)], clay, (-1.7, 1.6, 0)),
        "seat": s.box((1.15, 0.75, 0.44), (0.42, 0.42, 0.04), wood, yaw=-30),
    }
    a = np.radians(-30)
    right, back = np.array([np.cos(a), np.sin(a), 0]), np.array([-np.sin(a), np.cos(a), 0])
    for k, (u, v, top) in enumerate([(-1, -1, 0.44), (1, -1, 0.44), (-1, 1, 0.95), (1, 1, 0.95)]):
        foot = np.array([1.15, 0.75, top / 2]) + 0.18 * u * right + 0.18 * v * back
        parts[f"leg_{k}"] = s.box(foot, (0.04, 0.04, top), wood, yaw=-30)
    for k, z in enumerate((0.66, 0.88)):
        parts[f"rail_{k}"] = s.box(np.array([1.15, 0.75, z]) + 0.18 * back, (0.38, 0.025, 0.09), wood, yaw=-30)
    count = 46
    turn, rise = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.25, 0.95, count)
    foot_of = np.column_stack([np.full(count, -1.7), np.full(count, 1.6), rng.uniform(0.28, 0.7, count)])
    tips = foot_of + np.column_stack([0.28 * np.cos(turn), 0.28 * np.sin(turn), 0.6 * rise])
    parts["plant"] = s.ribbons(foot_of, tips, 0.035, leaves)
    return parts
