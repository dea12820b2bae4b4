"""The Cornell box with textures, so that views can be matched."""

from __future__ import annotations

from typing import Any

import numpy as np

from simscenes.scenes.parts import shapes as s
from simscenes.scenes.parts import textures as t
from simscenes.scenes.scene import Scene, forward


def cornell(seed: int = 0) -> dict[str, Any]:
    """A closed-in box, 2 units wide, with red and green tiled sides, two printed blocks and a brass ball.

    Hard for: light that arrives by several bounces (a tenth of it here), colour bleeding from the sides, soft shadows,
    and a box whose open front shows only the inside. The open side faces -y, world z is up, z = -1 is the floor.

    Args:
        seed: Varies every texture and the turn of the blocks.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 2])
    tiles = t.cells((384, 384), rng, count=70, colors=("6f6a5e", "a79f8d", "d8d0bd", "8d8471"), joint=0.2)
    paper = t.motif((384, 384), rng, repeats=(4, 4), colors=("a89f8c", "e6dfcc", "c2a878", "70767a"))
    red = t.bricks((384, 384), rng, rows=10, columns=5, colors=("6d1410", "a32018", "c0392b", "d96a4e"))
    green = t.motif((384, 384), rng, repeats=(3, 3), colors=("123d1c", "2f7d3b", "6fae57", "1d5a2a"))
    plaster = t.marble((256, 256), rng, colors=("d9d4c8", "b9b2a3", "8a8478"))
    tall = t.painting((256, 256), rng, colors=("1d3557", "e63946", "f1e4c8", "457b9d", "ffb703"))
    short = t.wood((192, 192), rng, planks=3)
    leather = t.cells((128, 256), rng, count=30, colors=("2a6f97", "e9c46a", "bc4749"))
    yaw_tall, yaw_short = float(rng.uniform(12, 24)), float(rng.uniform(-26, -12))
    return {
        "type": "scene",
        "light": s.area_light((0.05, 0.1, 0.985), (0.45, 0, 0), (0, -0.4, 0), (9.5, 7.8, 5.4)),
        "floor": s.quad((0, 0, -1), (1, 0, 0), (0, 1, 0), s.diffuse(tiles)),
        "ceiling": s.quad((0, 0, 1), (1, 0, 0), (0, -1, 0), s.diffuse(plaster)),
        "back": s.quad((0, 1, 0), (1, 0, 0), (0, 0, 1), s.diffuse(paper)),
        "left": s.quad((-1, 0, 0), (0, 1, 0), (0, 0, 1), s.diffuse(red)),
        "right": s.quad((1, 0, 0), (0, -1, 0), (0, 0, 1), s.diffuse(green)),
        "tall_block": s.box((-0.35, 0.35, -0.4), (0.55, 0.55, 1.2), s.diffuse(tall), yaw=yaw_tall),
        "short_block": s.box((0.38, -0.15, -0.72), (0.55, 0.55, 0.56), s.diffuse(short), yaw=yaw_short),
        "ball": s.ball((0.38, -0.15, -0.24), 0.2, s.metal("Au", 0.25)),
        "small_ball": s.ball((-0.2, -0.45, -0.84), 0.16, s.plastic(leather, 0.1)),
    }


CORNELL = Scene(cornell, forward(58.0, position=(0, -1.75, 0), target=(0, 0.3, -0.15), extent=(0.62, 0.5), rows=4))
