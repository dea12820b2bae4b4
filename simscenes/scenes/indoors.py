"""Rooms with things that people look at most closely: legible print, and faces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from simscenes.scenes.parts import sculpture
from simscenes.scenes.parts import shapes as s
from simscenes.scenes.parts import textures as t
from simscenes.scenes.printed.pages import CHART, NOTICES, VERSES, page
from simscenes.scenes.scene import ROOM, Scene, orbit

_JACKETS = ("1d3557", "8c2f39", "2f5d50", "d9a441", "5b3a6b", "e8dcc0", "36454f")


def _sheet(center: Sequence[float], size: tuple[float, float], texels: t.Texels, lean: float = 0.0) -> Any:
    """Paper on a wall behind it (north), turned by `lean` degrees in its plane."""
    a = np.radians(lean)
    right, up = np.array([np.cos(a), 0, np.sin(a)]), np.array([-np.sin(a), 0, np.cos(a)])
    return s.quad(center, size[0] / 2 * right, size[1] / 2 * up, s.diffuse(texels))


def bookshop(seed: int = 0) -> dict[str, Any]:
    """A bookshop's corner: a board with notices, an eye chart, shelves of books, an open book and cards on a table.

    Hard for: print. Letters from a hand's height down to below a pixel: enhancement, denoising and reconstruction can
    each lose them, and everybody sees which can still be read. World z is up, the floor is z = 0, metres.

    Args:
        seed: Varies the books, the papers' places and the wear.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 13])
    plaster = [t.marble((256, 256), rng, colors=("d8cdb8", "cfc3ab", "c3b598")) for _ in range(3)]
    parts: dict[str, Any] = {
        "type": "scene",
        "ceiling_lamp": s.area_light((0.3, -0.2, 2.55), (0.5, 0, 0), (0, -0.4, 0), (7.0, 6.2, 5.0)),
        "desk_lamp": s.area_light((-1.5, 0.6, 2.0), (0.15, 0, 0), (0, -0.13, 0.07), (9.0, 6.5, 3.6)),
        **s.stage(t.wood((384, 384), rng, planks=10), plaster, half=2.4),
        "ceiling": s.box((0, 0, 2.62), (4.8, 4.8, 0.04), s.diffuse(plaster[0])),
        "board": s.box((0.05, 2.38, 1.5), (1.7, 0.04, 1.15), s.diffuse(_cork(rng))),
    }
    for k, (text, x, z, width, height) in enumerate(NOTICES):
        paper = page((round(640 * height), round(640 * width)), rng, text, paper=("f3ecd8", "e9efe6", "f1dfd0")[k % 3])
        lean = float(rng.uniform(-4, 4))
        parts[f"notice_{k}"] = _sheet((x + 0.05, 2.355 - 0.001 * k, z), (width, height), paper, lean)
    chart = page((512, 352), rng, CHART, paper="f4f1e6", shrink=0.74)
    parts["chart"] = _sheet((1.6, 2.39, 1.45), (0.66, 0.96), chart)
    parts["sign"] = _sheet(
        (0.05, 2.39, 2.3), (1.3, 0.32), page((160, 640), rng, ("BOOKS",), paper="2f5d50", ink="efe2b8")
    )
    parts |= _shelves(rng) | _table(rng)
    return parts


BOOKSHOP = Scene(bookshop, orbit(58.0, target=(0.05, 1.3, 1.2), radius=1.9, elevation_deg=9.0, **ROOM))


def _cork(rng: t.Rng) -> t.Texels:
    return t.bordered(
        t.cells((256, 384), rng, count=900, colors=("a9784a", "b98a58", "c69a68"), joint=0.5), "5a3a1e", 0.05
    )


def _shelves(rng: t.Rng) -> dict[str, Any]:
    """Three shelves of books on the left, backs to the room."""
    wood = s.diffuse(t.wood((96, 192), rng, planks=2))
    parts: dict[str, Any] = {
        "case_left": s.box((-2.0, 2.2, 0.9), (0.04, 0.36, 1.8), wood),
        "case_right": s.box((-0.95, 2.2, 0.9), (0.04, 0.36, 1.8), wood),
    }
    for k, z in enumerate((0.08, 0.62, 1.16, 1.72)):
        parts[f"shelf_{k}"] = s.box((-1.475, 2.2, z), (1.05, 0.36, 0.04), wood)
        if k < 3:
            backs = t.spines((160, 420), rng, colors=_JACKETS, count=16)
            # Row 0 of a texture is its lower edge, where books stand.
            parts[f"books_{k}"] = s.quad((-1.475, 2.12, z + 0.22), (0.5, 0, 0), (0, 0, 0.2), s.diffuse(backs[::-1]))
    return parts


def _table(rng: t.Rng) -> dict[str, Any]:
    """A table before the board: an open book, two piles, cards with prices."""
    parts: dict[str, Any] = {
        "table": s.box((0.3, 1.1, 0.36), (1.8, 0.8, 0.72), s.diffuse(t.wood((192, 320), rng, planks=5)))
    }
    for side, verses in ((-1, VERSES[0]), (1, VERSES[1])):
        leaf = s.diffuse(page((512, 384), rng, verses, paper="f2ead6"))
        parts[f"leaf_{side}"] = s.quad(
            (0.25 + 0.155 * side, 0.95, 0.775), (0.15, 0, 0.02 * side), (0, 0.19, 0.035), leaf
        )
    parts["cover"] = s.box((0.25, 0.95, 0.735), (0.64, 0.4, 0.02), s.diffuse(t.plain((96, 96), rng, "6b2330")))
    for k, x in enumerate((-0.35, 0.95)):
        z = 0.72
        for j in range(4):
            thick, jacket = float(rng.uniform(0.03, 0.06)), _JACKETS[int(rng.integers(len(_JACKETS)))]
            cover = s.diffuse(t.bordered(t.plain((96, 96), rng, jacket), "d9c58a", 0.03))
            parts[f"pile_{k}_{j}"] = s.box(
                (x, 1.2, z + thick / 2), (0.24, 0.3, thick), cover, yaw=float(rng.uniform(-25, 25))
            )
            z += thick
        card = page((128, 192), rng, (("NEW", "4.50"), ("SALE", "1.20"))[k], paper="f6e9a8", ink="8c1c13")
        parts[f"card_{k}"] = s.quad((x + 0.02, 0.93, 0.8), (0.11, 0, 0), (0, 0.03, 0.075), s.diffuse(card))
    return parts


def busts(seed: int = 0) -> dict[str, Any]:
    """Busts of two people, a dog and a cat on plinths, modelled by light from one side.

    Hard for: faces, which everybody judges. They are smooth stone and bronze, told by shading alone: noise and a wrong
    normal both change who it is. World z is up, the floor is z = 0, metres.

    Args:
        seed: Varies the faces, the stones and the places.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 14])
    walls = [t.plain((256, 256), rng, c, grain=0.3) for c in ("4a5a52", "56635a", "56635a")]
    floor = t.cells((320, 320), rng, count=60, colors=("8d857a", "a79f93", "bcb4a6"), joint=0.08)
    parts: dict[str, Any] = {
        "type": "scene",
        "window": s.area_light((-1.95, -0.5, 1.6), (0, 0.7, 0), (0, 0, 0.8), (6.5, 7.0, 7.8)),
        "lamp": s.area_light((1.2, -0.8, 2.5), (0.25, 0, 0), (0, -0.22, 0.1), (8.0, 6.2, 4.0)),
        **s.stage(floor, walls),
    }
    stones = (
        s.diffuse(t.marble((256, 512), rng, colors=("e6e0d4", "d6cebf", "b3a998"))),
        s.diffuse(t.plain((256, 512), rng, "9a6a4a", grain=0.2)),
        s.plastic(t.plain((256, 512), rng, "4f3d24", grain=0.3), 0.25),
        s.diffuse(t.marble((256, 512), rng, colors=("7d8488", "8f979b", "5d6468"))),
    )
    sitters = (sculpture.person, sculpture.person, sculpture.dog, sculpture.cat)
    for k, (make, x, y, top) in enumerate(
        zip(sitters, (-0.55, 0.2, 0.85, -0.05), (0.5, 0.75, 0.3, -0.2), (0.75, 0.95, 0.6, 0.42), strict=True)
    ):
        place = (x + float(rng.uniform(-0.04, 0.04)), y, top)
        # Towards the middle of the cameras' arc, give or take.
        yaw = -35 * x + float(rng.uniform(-12, 12))
        parts[f"bust_{k}"] = make(rng).mesh(stones[k], place, yaw)
        plinth = s.diffuse(t.marble((160, 160), rng, colors=("c9c2b4", "b5ad9e", "958d80")))
        parts[f"plinth_{k}"] = s.box((place[0], y, top / 2), (0.46, 0.42, top), plinth, yaw=yaw)
    return parts


BUSTS = Scene(busts, orbit(50.0, target=(0.1, 0.3, 0.85), radius=1.75, elevation_deg=12.0, **ROOM))
