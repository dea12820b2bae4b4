"""The tabletop: a still life on a table in a furnished room, the catalogue's main scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from simscenes.scenes.parts import shapes as s
from simscenes.scenes.parts import textures as t
from simscenes.scenes.scene import Scene, orbit

_BRIGHT = ("1d3557", "c0392b", "f1e4c8", "457b9d", "e2a73b", "3f7d58")
_FLOOR, _CEILING, _WALL = -0.75, 1.95, 2.3


def tabletop(seed: int = 0) -> dict[str, Any]:
    """A still life in a room: glazed, wooden, paper, brass, copper and glass things under a ceiling light.

    The room has no ceiling: nobody looks up, and paths that leave end early.

    Hard for: view-dependent highlights on metal and glaze, refraction and caustics in the glass ball, thin gaps and
    contact shadows between small objects, and a dim, coloured window as second light. World z is up, the table top is
    z = 0, the unit is about a metre.

    Args:
        seed: Varies every texture and the turn of the loose objects.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 1])
    return {"type": "scene", **_lights(rng), **_room(rng), **_table(rng), **_vessels(rng), **_toys(rng), **_fruit(rng)}


TABLETOP = Scene(
    tabletop,
    orbit(52.0, target=(0.02, 0.02, 0.12), radius=1.45, elevation_deg=27.0, swing_deg=9.0, start_deg=-150.0,
          sweep_deg=140.0),
)  # fmt: skip


def _lights(rng: t.Rng) -> dict[str, Any]:
    frame = s.diffuse(t.wood((64, 64), rng, colors=("8a7a66", "c9bca6", "e6dccb")))
    y = _WALL - 0.02
    parts: dict[str, Any] = {
        "ceiling_light": s.area_light((0.35, -0.25, _CEILING - 0.02), (0.6, 0, 0), (0, -0.6, 0), (7.4, 6.2, 4.7)),
        "window": s.area_light((-0.95, y, 0.75), (0.5, 0, 0), (0, 0, 0.6), (0.9, 1.25, 1.8)),
    }
    for k, (dx, dz, w, h) in enumerate([(-0.52, 0, 0.07, 1.3), (0.52, 0, 0.07, 1.3), (0, 0.62, 1.1, 0.07),
                                        (0, -0.63, 1.2, 0.09), (0, 0, 0.03, 1.2), (0, 0.12, 1.0, 0.03)]):  # fmt: skip
        parts[f"window_frame_{k}"] = s.box((-0.95 + dx, y - 0.02, 0.75 + dz), (w, 0.06, h), frame)
    return parts


def _room(rng: t.Rng) -> dict[str, Any]:
    w, mid, half = _WALL, (_FLOOR + _CEILING) / 2, (_CEILING - _FLOOR) / 2
    papers = [
        ("2f4a4f", "5d7f7a", "b9c4a7"),
        ("6b3a32", "a8705a", "dcc19a"),
        ("3b4264", "6d7aa0", "c3bfc9"),
        ("5a5230", "93874f", "d8cc9b"),
    ]
    walls = [s.diffuse(t.motif((384, 512), rng, repeats=(2, 3), colors=p, edge=1.0)) for p in papers]
    shelf = s.diffuse(t.stacked([t.spines((192, 384), rng, colors=_BRIGHT, count=14) for _ in range(2)], 2))
    art = [
        s.diffuse(t.bordered(t.painting((192, 256), rng, colors=_BRIGHT, strokes=9), c))
        for c in ("5a3a1c", "1f1a17", "8c6b2f", "3a2a1a")
    ]
    floor = t.wood((512, 512), rng, planks=8, colors=("33200f", "66421f", "94683a", "b78b58"))
    rug = t.bordered(
        t.motif((256, 256), rng, repeats=(2, 2), colors=("57141d", "a8322d", "d9a441", "1f2f4a"), edge=1.0),
        "d8c49a",
        0.06,
    )
    return {
        "floor": s.quad((0, 0, _FLOOR), (w, 0, 0), (0, w, 0), s.diffuse(floor)),
        "rug": s.quad((0, 0, _FLOOR + 0.01), (1.5, 0, 0), (0, 1.2, 0), s.diffuse(rug)),
        "wall_north": s.quad((0, w, mid), (w, 0, 0), (0, 0, half), walls[0]),
        "wall_south": s.quad((0, -w, mid), (-w, 0, 0), (0, 0, half), walls[1]),
        "wall_east": s.quad((w, 0, mid), (0, -w, 0), (0, 0, half), walls[2]),
        "wall_west": s.quad((-w, 0, mid), (0, w, 0), (0, 0, half), walls[3]),
        "picture_north": s.box((0.75, w - 0.02, 0.7), (1.2, 0.05, 0.9), art[0]),
        "picture_east": s.box((w - 0.02, 0.8, 0.65), (0.05, 1.3, 0.95), art[1]),
        "picture_west": s.box((-w + 0.02, -0.7, 0.65), (0.05, 1.2, 0.9), art[2]),
        "picture_south": s.box((-0.9, -w + 0.02, 0.7), (1.1, 0.05, 0.9), art[3]),
        "bookshelf_east": s.box((w - 0.18, -1.0, 0.15), (0.36, 1.3, 1.75), shelf),
        "bookshelf_west": s.box((-w + 0.18, 1.1, 0.1), (0.36, 1.2, 1.7), shelf),
    }


def _table(rng: t.Rng) -> dict[str, Any]:
    top = s.plastic(t.wood((384, 512), rng, planks=5, colors=("4b2d17", "7d5330", "a97a4a", "cfa673")), 0.25)
    legs = s.diffuse(t.wood((64, 64), rng, planks=2))
    cloth = t.bordered(
        t.motif((256, 256), rng, repeats=(1, 2), colors=("f0e6d0", "2d4a6d", "c65d3b", "e9c46a"), edge=1.0),
        "efe3c8",
        0.05,
    )
    parts = {
        "table_top": s.box((0, 0, -0.025), (1.75, 1.3, 0.05), top),
        "cloth": s.box((0.02, -0.02, 0.002), (1.05, 0.8, 0.004), s.diffuse(cloth), yaw=float(rng.uniform(4, 12))),
    }
    for k, (x, y) in enumerate([(0.78, 0.56), (-0.78, 0.56), (0.78, -0.56), (-0.78, -0.56)]):
        parts[f"table_leg_{k}"] = s.box((x, y, (_FLOOR - 0.05) / 2), (0.07, 0.07, 0.7), legs)
    return parts


def _vessels(rng: t.Rng) -> dict[str, Any]:
    glaze = s.plastic(t.motif((192, 384), rng, repeats=(1, 3), colors=("f2eee2", "e9e4d4", "27508c", "16315c")), 0.08)
    vase = [
        (0, 0), (0.075, 0), (0.085, 0.02), (0.15, 0.14), (0.165, 0.2), (0.13, 0.3), (0.06, 0.37), (0.055, 0.4),
        (0.085, 0.43),
    ]  # fmt: skip
    inside = [(0.075, 0.425), (0.045, 0.39), (0.045, 0.36), (0.0, 0.33)]
    jug = [
        (0, 0), (0.1, 0), (0.13, 0.05), (0.135, 0.1), (0.09, 0.19), (0.07, 0.23), (0.08, 0.26), (0.07, 0.255),
        (0.06, 0.22), (0.0, 0.2),
    ]  # fmt: skip
    cup = [
        (0, 0), (0.05, 0), (0.045, 0.01), (0.012, 0.03), (0.012, 0.09), (0.04, 0.12), (0.06, 0.16), (0.065, 0.2),
        (0.058, 0.2), (0.05, 0.15), (0, 0.125),
    ]  # fmt: skip
    return {
        "vase": s.lathe(vase + inside, glaze, (-0.38, 0.25, 0.004), float(rng.uniform(0, 360))),
        "copper_jug": s.lathe(jug, s.metal("Cu", 0.22), (0.06, 0.36, 0.004)),
        "brass_goblet": s.lathe(cup, s.metal("Au", 0.3), (0.56, 0.1, 0.0)),
        "glass_ball": s.ball((0.2, -0.26, 0.105), 0.1, s.glass()),
        "steel_ball": s.ball((-0.12, -0.42, 0.055), 0.05, s.metal("Cr", 0.2)),
    }


def _toys(rng: t.Rng) -> dict[str, Any]:
    parts: dict[str, Any] = {}
    titles = [
        ("LIGHT", "f1e4c8", "7a1f2b"),
        ("NOISE", "e9c46a", "1d3557"),
        ("VIEWS", "33251a", "c9a66b"),
        ("PHOTON", "f4f1de", "3f6b4f"),
    ]
    covers = [t.lettering((128, 192), rng, title, ink=ink, paper=paper) for title, ink, paper in titles]
    height = 0.0
    for k, (cover, thickness) in enumerate(zip(covers, (0.05, 0.04, 0.06, 0.035), strict=True)):
        center = (0.42 + 0.01 * k, 0.36, height + thickness / 2)
        parts[f"book_{k}"] = s.box(
            center, (0.36 - 0.03 * k, 0.25 - 0.02 * k, thickness), s.diffuse(cover), yaw=float(rng.uniform(-25, 25))
        )
        height += thickness
    globe = t.cells((192, 384), rng, count=26, colors=("1d4e89", "2a6f97", "6a994e", "e9c46a", "bc4749"), joint=0.15)
    parts["globe"] = s.ball((0.43, 0.36, height + 0.09), 0.09, s.plastic(globe, 0.2), yaw=float(rng.uniform(0, 360)))
    blocks = [
        ("N", -0.5, -0.14, 0),
        ("O", -0.37, -0.22, 0),
        ("V", -0.46, -0.19, 1),
        ("A", -0.62, -0.27, 0),
        ("3", 0.5, -0.3, 0),
        ("D", 0.62, -0.18, 0),
    ]
    for k, (letter, x, y, level) in enumerate(blocks):
        ink = _BRIGHT[k % 2] if k % 3 else "3f7d58"
        face = t.lettering((96, 96), rng, letter, ink=ink, paper="e8d3a8")
        parts[f"block_{k}"] = s.box(
            (x, y, 0.055 + 0.11 * level + 0.004), (0.11, 0.11, 0.11), s.diffuse(face), yaw=float(rng.uniform(-35, 35))
        )
    pawn = [
        (0, 0), (0.036, 0), (0.036, 0.012), (0.022, 0.025), (0.012, 0.06), (0.02, 0.075), (0.024, 0.095),
        (0.014, 0.112), (0, 0.118),
    ]  # fmt: skip
    for k, x in enumerate((0.3, 0.39, 0.47)):
        shade = ("2b1a10", "4a2f1b", "7a5230") if k % 2 else ("a97a4a", "d9b483", "efdcb5")
        parts[f"pawn_{k}"] = s.lathe(
            pawn, s.diffuse(t.wood((64, 64), rng, planks=1, colors=shade)), (x, -0.5 + 0.06 * (k % 2), 0.0)
        )
    return parts


def _fruit(rng: t.Rng) -> dict[str, Any]:
    bowl = [
        (0, 0), (0.07, 0), (0.075, 0.015), (0.14, 0.045), (0.19, 0.095), (0.2, 0.12), (0.185, 0.118), (0.13, 0.06),
        (0.06, 0.03), (0, 0.025),
    ]  # fmt: skip
    parts: dict[str, Any] = {
        "bowl": s.lathe(
            bowl, s.diffuse(t.bordered(t.wood((128, 256), rng, planks=3), "6d2f1e", 0.1)), (-0.08, 0.02, 0.004)
        )
    }
    skins = [
        ("c0561a", "e58a2b", "f0a847"),
        ("7c1d1a", "b8322a", "d98f3f"),
        ("b08a1e", "e5c02f", "f1dd6b"),
        ("4d6b23", "86a33a", "c9c36a"),
        ("8e2a1f", "cf5a35", "e9b45a"),
    ]
    spots = [(-0.17, 0.06), (-0.02, 0.09), (-0.06, -0.07), (-0.14, -0.06), (0.03, -0.01)]
    for k, (colors, (x, y)) in enumerate(zip(skins, spots, strict=True)):
        skin = t.mottled((64, 128), rng, colors, contrast=0.25, beta=1.5, grain=0.1)
        parts[f"fruit_{k}"] = s.ball(
            (x, y, 0.115 + 0.012 * k),
            0.062 + 0.003 * (k % 3),
            s.plastic(skin, 0.25),
            yaw=40.0 * k,
            squash=1.18 if k == 2 else 0.93,
            tilt=80 if k == 2 else 8,
        )
    parts["top_fruit"] = s.ball(
        (-0.07, 0.02, 0.215),
        0.06,
        s.diffuse(t.cells((64, 128), rng, count=90, colors=("5a1f33", "8c2f4a", "b5566b"), joint=0.3)),
        squash=0.95,
    )
    return parts
