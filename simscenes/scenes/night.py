"""Scenes after dark: a foggy street, a market under coloured lamps, a room around a bare bulb."""

from __future__ import annotations

from typing import Any

import numpy as np

from simscenes.scenes.parts import shapes as s
from simscenes.scenes.parts import textures as t
from simscenes.scenes.scene import ROOM, Scene, forward, orbit


def street(seed: int = 0) -> dict[str, Any]:
    """A paved street in fog, three street lamps throwing cones of light, house fronts on both sides.

    Hard for: light scattered by the fog between surface and camera: contrast falls with distance, the cones are bright
    where no surface is. The fog fills a box the cameras look into from its open end, at -y. World z is up, metres.

    Args:
        seed: Varies every texture and the parked crates.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    import mitsuba as mi

    rng = np.random.default_rng([seed, 7])
    fog = {"type": "homogeneous", "albedo": {"type": "rgb", "value": [0.93, 0.94, 0.95]}, "sigma_t": 0.14,
           "phase": {"type": "hg", "g": 0.5}}  # fmt: skip
    left, right = (t.bricks((384, 512), rng, rows=20, columns=14) for _ in range(2))
    end = t.bricks((256, 256), rng, rows=16, columns=10, colors=("3f3a36", "6d625a", "9b8d7e"))
    paving = t.cells((512, 512), rng, count=260, colors=("4a4640", "77706a", "9c948a", "5f5a52"), joint=0.2)
    parts: dict[str, Any] = {
        "type": "scene",
        "fog": {
            "type": "cube",
            "to_world": s.place((0, 3.0, 2.0), 0, (2.6, 4.2, 2.3)),
            "bsdf": {"type": "null"},
            "interior": fog,
        },
        "ground": s.quad((0, 3, 0), (2.5, 0, 0), (0, 4.1, 0), s.diffuse(paving, tile=(1, 2))),
        "left": s.quad((-2.2, 3, 2.0), (0, 4.0, 0), (0, 0, 2.0), s.diffuse(left)),
        "right": s.quad((2.2, 3, 2.0), (0, -4.0, 0), (0, 0, 2.0), s.diffuse(right)),
        "end": s.quad((0, 7.0, 2.0), (2.2, 0, 0), (0, 0, 2.0), s.diffuse(end)),
        "moon": {"type": "constant", "radiance": {"type": "rgb", "value": [0.004, 0.006, 0.012]}},
    }
    iron = s.diffuse(t.finish(np.full((32, 32, 3), 0.08), rng, grain=0.3))
    for k, (x, y) in enumerate([(-1.35, 1.2), (1.35, 3.2), (-1.35, 5.4)]):
        parts[f"post_{k}"] = s.lathe(
            [(0.09, 0), (0.06, 0.2), (0.04, 2.9), (0, 3.0)], iron, (x, y, 0), smooth=False, segments=12
        )
        parts[f"hood_{k}"] = s.lathe(
            [(0.26, 0), (0.2, 0.12), (0.0, 0.22)], iron, (0.75 * x, y, 2.75), smooth=False, segments=20
        )
        parts[f"arm_{k}"] = s.box((0.87 * x, y, 2.92), (abs(0.3 * x), 0.04, 0.04), iron)
        beam = mi.ScalarTransform4f().look_at(origin=[0.75 * x, y, 2.72], target=[0.55 * x, y, 0], up=[0, 1, 0])
        color = ([26.0, 18.0, 9.5], [18.0, 19.0, 22.0], [26.0, 17.0, 8.0])[k]
        parts[f"lamp_{k}"] = {
            "type": "spot",
            "to_world": beam,
            "intensity": {"type": "rgb", "value": color},
            "cutoff_angle": 42.0,
            "beam_width": 26.0,
        }
    for k, (x, y, size) in enumerate(
        [(-1.5, 2.3, 0.5), (-1.2, 2.8, 0.35), (1.5, 1.6, 0.45), (1.3, 4.6, 0.6), (0.4, 5.8, 0.5)]
    ):
        wood = s.diffuse(t.wood((96, 96), rng, planks=4))
        parts[f"crate_{k}"] = s.box((x, y, size / 2), (size, size, size), wood, yaw=float(rng.uniform(0, 90)))
    for k, (x, y) in enumerate([(-2.17, 1.0), (-2.17, 2.6), (-2.17, 4.6), (2.17, 2.2), (2.17, 4.0)]):
        poster = s.diffuse(t.painting((128, 96), rng, colors=("f1e4c8", "c0392b", "1d3557", "e2a73b")))
        parts[f"poster_{k}"] = s.box((x, y, 1.5), (0.04, 0.7, 1.0), poster)
    return parts


STREET = Scene(street, forward(62.0, position=(0, -1.6, 1.5), target=(0, 3.5, 1.1), extent=(0.9, 0.45), rows=4))


def market(seed: int = 0) -> dict[str, Any]:
    """A stall of fruit and cloth, half in the orange light of a sodium lamp, half in the blue of a white LED.

    Hard for: colour. The lamps are measured spectra (CIE HP1 and LED-B5) far from daylight; three colour channels
    multiply them with reflectances wrongly, and no single white balance fits. World z is up, the floor z = 0, metres.

    Args:
        seed: Varies every texture and the heaps.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 8])
    cloth = t.bordered(t.motif((320, 320), rng, repeats=(6, 6), colors=("d8ccb2", "c9b48f"), edge=1.0), "8c2f39", 0.1)
    walls = [
        t.wood((256, 320), rng, planks=6, colors=("4b4a45", "6b6861", "8b877d")),
        t.bricks((256, 256), rng),
        t.marble((256, 256), rng, colors=("c9c0ae", "b8ae9a", "a1977f")),
    ]
    parts: dict[str, Any] = {
        "type": "scene",
        "sodium": s.area_light((-0.9, -0.4, 2.4), (0.3, 0, 0), (0, -0.3, 0), s.lamp_spectrum("HP1", 16.0)),
        "led": s.area_light((1.0, -0.2, 2.4), (0.25, 0, 0), (0, -0.25, 0), s.lamp_spectrum("LED-B5", 17.0)),
        **s.stage(t.cells((320, 320), rng, count=120, colors=("5b5a58", "8c8880", "b7ae9e")), walls, height=2.6),
        "stall": s.box((0, 0.25, 0.3), (2.2, 1.2, 0.6), s.diffuse(cloth)),
    }
    goods = [
        ("c1121f", "e85d04", "ffba08"),
        ("2d6a4f", "74c69d", "b7e4c7"),
        ("5a189a", "9d4edd", "e0aaff"),
        ("f48c06", "ffd60a", "fff3b0"),
        ("0077b6", "48cae4", "caf0f8"),
        ("7f4f24", "b6ad90", "dda15e"),
    ]
    for k, colors in enumerate(goods):
        skin = s.diffuse(t.cells((64, 128), rng, count=50, colors=colors, joint=0.4))
        x, y = -0.8 + 0.32 * k, 0.05 + 0.3 * (k % 2)
        for j, (dx, dy, dz) in enumerate([(-0.07, -0.06, 0), (0.07, -0.05, 0), (0.0, 0.07, 0), (0.0, -0.01, 0.11)]):
            parts[f"fruit_{k}_{j}"] = s.ball((x + dx, y + dy, 0.67 + dz), 0.075, skin, yaw=float(rng.uniform(0, 360)))
        chips = t.stacked([t.plain((32, 32), rng, c) for c in colors], 1)
        parts[f"card_{k}"] = s.box(
            (x, -0.28, 0.72), (0.2, 0.02, 0.22), s.diffuse(chips), yaw=float(rng.uniform(-20, 20))
        )
    return parts


MARKET = Scene(
    market,
    orbit(56.0, target=(0.0, 0.2, 0.75), radius=1.7, elevation_deg=20.0, **ROOM),
    measured_lights=True,
)


def lantern(seed: int = 0) -> dict[str, Any]:
    """A dark workshop corner lit by one bare bulb that hangs in view.

    Hard for: dynamic range: the bulb is tens of thousands of times brighter than the walls, so that an exposure for one
    clips or drowns the other, and light falls off steeply around it. World z is up, the floor is z = 0, metres.

    Args:
        seed: Varies every texture and the tools.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 9])
    boards = [t.wood((320, 320), rng, planks=7, colors=("2c1a0e", "553519", "7c532c", "a27746")) for _ in range(3)]
    steel = s.metal("Cr", 0.35)
    parts: dict[str, Any] = {
        "type": "scene",
        "bulb": s.ball(
            (0.1, 0.1, 1.35), 0.035, s.diffuse(np.full((2, 2, 3), 0.3)), emitter=s.glow((900.0, 640.0, 380.0))
        ),
        "cord": s.box((0.1, 0.1, 2.0), (0.012, 0.012, 1.2), s.diffuse(t.finish(np.full((16, 16, 3), 0.06), rng))),
        **s.stage(t.cells((320, 320), rng, count=90, colors=("3f3a35", "6d665c", "8a8174")), boards, height=3.4),
        "bench": s.box((0, 0.55, 0.4), (2.2, 0.8, 0.8), s.diffuse(t.wood((192, 320), rng, planks=4))),
    }
    for k in range(6):
        jar = t.cells((96, 192), rng, count=40, colors=("1d3557", "c0392b", "e2a73b", "3f7d58", "f1e4c8"))
        profile = [(0, 0), (0.08, 0), (0.085, 0.02), (0.08, 0.17), (0.05, 0.2), (0.05, 0.22), (0, 0.22)]
        parts[f"jar_{k}"] = s.lathe(
            profile, s.diffuse(jar), (-0.85 + 0.3 * k, 0.75 - 0.05 * (k % 3), 0.8), yaw=30.0 * k
        )
    for k in range(5):
        x, length = -0.8 + 0.35 * k, float(rng.uniform(0.2, 0.45))
        parts[f"tool_{k}"] = s.box(
            (x, 0.38, 0.815),
            (0.03, length, 0.03),
            steel if k % 2 else s.diffuse(t.wood((32, 128), rng, planks=1)),
            yaw=float(rng.uniform(-40, 40)),
        )
        parts[f"picture_{k}"] = s.box(
            (-1.2 + 0.6 * k, 1.98, 1.55),
            (0.4, 0.02, 0.5),
            s.diffuse(t.painting((96, 80), rng, colors=("f1e4c8", "457b9d", "c0392b", "e2a73b"))),
        )
    return parts


LANTERN = Scene(lantern, orbit(62.0, target=(0.05, 0.4, 0.95), radius=1.8, elevation_deg=12.0, **ROOM))
