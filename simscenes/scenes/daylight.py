"""Rooms by day: a matt still life, a white gallery of indirect light, a hall with a bare wall."""

from __future__ import annotations

from typing import Any

import numpy as np

from simscenes.scenes import shapes as s
from simscenes.scenes import textures as t

_PAINTS = ("1d3557", "c0392b", "f1e4c8", "457b9d", "e2a73b", "3f7d58")


def stage(rng: t.Rng, floor: t.Texels, walls: list[t.Texels], half: float = 2.0, height: float = 2.6) -> dict[str, Any]:
    """Floor z = 0 and up to four walls (north, east, west, south) around the origin."""
    sides = {"north": (0, 1), "east": (1, 0), "west": (-1, 0), "south": (0, -1)}
    parts: dict[str, Any] = {"floor": s.quad((0, 0, 0), (half, 0, 0), (0, half, 0), s.diffuse(floor))}
    for (name, (x, y)), texels in zip(sides.items(), walls, strict=False):
        center = (half * x, half * y, height / 2)
        parts[f"wall_{name}"] = s.quad(center, (half * y, -half * x, 0), (0, 0, height / 2), s.diffuse(texels))
    return parts


def studio(seed: int = 0) -> dict[str, Any]:
    """Matt things on a patterned carpet between printed screens, under two large softboxes.

    Hard for: nothing in particular, every surface is diffuse: the scene on which a method must work before its failures
    elsewhere mean anything. World z is up, the floor is z = 0, metres.

    Args:
        seed: Varies every texture and the turn of the things.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 4])
    carpet = t.motif((384, 384), rng, repeats=(5, 5), colors=("4a2230", "a8483e", "d9a95f", "2b3f55"))
    screens = [t.painting((256, 320), rng, colors=_PAINTS, strokes=30) for _ in range(3)]
    urn = [(0, 0), (0.12, 0), (0.14, 0.04), (0.1, 0.1), (0.22, 0.3), (0.25, 0.42), (0.16, 0.56), (0.2, 0.62), (0, 0.6)]
    cone = [(0.2, 0), (0.2, 0.02), (0.02, 0.6), (0, 0.62)]
    parts = {
        "key": s.area_light((-1.2, -1.2, 2.6), (0.6, 0.6, 0), (0.5, -0.5, -0.2), (6.5, 6.0, 5.4)),
        "fill": s.area_light((1.4, -0.6, 2.6), (0.4, -0.6, 0), (-0.5, -0.3, 0.1), (2.4, 2.9, 3.6)),
        **stage(rng, carpet, screens),
        "plinth": s.box((-0.45, 0.25, 0.2), (0.55, 0.55, 0.4), s.diffuse(t.marble((192, 192), rng)), yaw=20),
        "urn": s.lathe(
            urn,
            s.diffuse(t.motif((192, 384), rng, repeats=(3, 6), colors=("c7895b", "8a3f22", "2b1a12"))),
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
    return parts_of(parts)  # fmt: skip


def parts_of(parts: dict[str, Any]) -> dict[str, Any]:
    """A scene dict of these parts."""
    return {"type": "scene", **parts}


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
        (0, 0),
        (0.2, 0),
        (0.2, 0.3),
        (0.1, 0.34),
        (0.16, 0.6),
        (0.08, 0.85),
        (0.12, 1.0),
        (0.06, 1.14),
        (0, 1.16),
    ]
    parts: dict[str, Any] = {
        "cove_north": s.area_light((0, 1.78, 1.7), (1.9, 0, 0), (0, 0.18, 0), (11.0, 10.4, 9.1)),
        "lip_north": s.box((0, 1.57, 1.75), (4.0, 0.03, 0.2), s.diffuse(pale[4])),
        "cove_south": s.area_light((0, -1.78, 1.7), (1.9, 0, 0), (0, 0.18, 0), (7.0, 7.8, 9.1)),
        "lip_south": s.box((0, -1.57, 1.75), (4.0, 0.03, 0.2), s.diffuse(pale[4])),
        **stage(rng, floor, pale[:4]),
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
    return parts_of(parts)  # fmt: skip


def hall(seed: int = 0) -> dict[str, Any]:
    """A room whose main wall is bare plaster of one shade, with a few boxes and one poster.

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
        "lamp": s.area_light((0.6, -0.8, 2.55), (0.5, 0, 0), (0, -0.5, 0), (9.5, 8.6, 7.2)),
        **stage(rng, floor, [bare, bare, t.bricks((320, 320), rng)]),
        "poster": s.box((-1.0, 1.98, 1.3), (0.7, 0.02, 0.9), s.diffuse(t.painting((224, 160), rng, colors=_PAINTS))),
        "skirting": s.box((0, 1.98, 0.06), (4.0, 0.03, 0.12), s.diffuse(t.wood((32, 256), rng, planks=1))),
    }
    for k, (x, y, size) in enumerate([(-0.4, 0.5, 0.5), (0.35, 0.75, 0.4), (0.75, 0.1, 0.3), (-0.1, -0.2, 0.25)]):
        card = t.lettering((96, 128), rng, f"BOX {k}", ink="4a2f1b", paper="c9a06b")
        parts[f"box_{k}"] = s.box((x, y, size / 2), (size, size, size), s.diffuse(card), yaw=float(rng.uniform(0, 90)))
    return parts_of(parts)
