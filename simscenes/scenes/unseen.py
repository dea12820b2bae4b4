"""Two scenes that stay unseen: methods are judged on them, and no setting of a method may be chosen on them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from simscenes.scenes.parts import shapes as s
from simscenes.scenes.parts import textures as t
from simscenes.scenes.scene import ROOM, Scene, orbit


def sofa(seed: int = 0) -> dict[str, Any]:
    """A living room in the evening: a sofa with printed cushions, a rug, pictures, a plant, a lamp on its stand.

    Hard for: cloth. Print and weave run over soft, round forms whose shading is weak, and the light falls off from
    the lamp to the far corners. World z is up, the floor is z = 0, metres. Kept unseen: no setting is chosen on it.

    Args:
        seed: Varies every texture, the cushions, the books and the plant.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 17])
    paper = [
        t.motif((384, 384), rng, repeats=(6, 9), colors=("c8b78f", "d8cba8", "a9996f"), edge=2.0) for _ in range(3)
    ]
    return {
        "type": "scene",
        "window": s.area_light((-2.15, -0.5, 1.6), (0, 0.55, 0), (0, 0, 0.6), (3.0, 3.6, 4.6)),
        "ceiling_lamp": s.area_light((0.0, 0.2, 2.55), (0.5, 0, 0), (0, -0.5, 0), (3.4, 2.7, 1.9)),
        **s.stage(t.wood((384, 384), rng, planks=11), paper, half=2.2),
        "skirting": s.box((0, 2.18, 0.06), (4.4, 0.04, 0.12), s.diffuse(t.plain((32, 256), rng, "e5dfd0"))),
        "rug": s.box((0.05, 0.2, 0.01), (2.5, 1.7, 0.02), s.diffuse(_rug(rng))),
        **_seats(rng),
        **_pictures(rng),
        **_lamp(rng),
        **_side_table(rng),
    }


def bicycle(seed: int = 0) -> dict[str, Any]:
    """A bicycle against a brick wall with ivy, a gate, crates and pots, under a grey sky and a lamp on the wall.

    Hard for: spokes and tubes before a pattern. A spoke is less than a pixel wide, the rims mirror the yard, and ivy
    hides and shows the bricks. World z is up, the ground is z = 0, metres. Kept unseen: no setting is chosen on it.

    Args:
        seed: Varies every texture, the ivy, the crates and how the front wheel is turned.

    Returns:
        Mitsuba scene dict without sensor. A variant must be active.
    """
    rng = np.random.default_rng([seed, 18])
    walls = [
        t.bricks((512, 512), rng, rows=28, columns=14),
        *(t.wood((256, 256), rng, planks=14, colors=("2f3b30", "4c5c48", "75836a")) for _ in range(2)),
    ]
    stones = t.cells((448, 448), rng, count=260, colors=("4e4a44", "77706a", "9c948a", "68645c"), joint=0.2)
    return {
        "type": "scene",
        "sky": s.area_light((0, -0.6, 2.9), (1.5, 0, 0), (0, -1.3, 0), (1.9, 2.1, 2.4)),
        "lamp": s.ball((1.15, 1.9, 1.85), 0.09, s.diffuse(np.full((2, 2, 3), 0.3)), emitter=s.glow((22.0, 15.0, 7.0))),
        **s.stage(stones, walls, half=2.1),
        **_bicycle(rng, np.array([-0.1, 1.45, 0.0])),
        "ivy": _ivy(rng),
        **_yard(rng),
    }


SOFA = Scene(sofa, orbit(56.0, target=(0.0, 0.75, 0.65), radius=2.1, elevation_deg=16.0, **ROOM))
BICYCLE = Scene(bicycle, orbit(54.0, target=(0.0, 1.0, 0.6), radius=2.2, elevation_deg=14.0, **ROOM))


def _rug(rng: t.Rng) -> t.Texels:
    middle = t.motif((256, 384), rng, repeats=(4, 6), colors=("6b1f2a", "a63d40", "d9b26f", "243b55"), edge=3.0)
    return t.bordered(t.bordered(middle, "243b55", 0.12), "d9b26f", 0.03)


def _cloth(rng: t.Rng, colors: tuple[str, ...], repeats: tuple[int, int] = (24, 24)) -> Any:
    return s.diffuse(t.motif((256, 256), rng, repeats=repeats, colors=colors, edge=1.0))


def _seats(rng: t.Rng) -> dict[str, Any]:
    """The sofa at the back wall and a stool before it; cushions lean on the sofa's back."""
    cover = _cloth(rng, ("44586b", "5a7086", "6d8499"))
    parts: dict[str, Any] = {
        "seat": s.box((-0.1, 1.55, 0.26), (1.9, 0.8, 0.3), cover),
        "back": s.box((-0.1, 1.9, 0.55), (1.9, 0.2, 0.75), cover, tilt=-6),
        "stool": s.lathe([(0, 0), (0.24, 0.0), (0.3, 0.08), (0.3, 0.28), (0.2, 0.36), (0, 0.37)],
                         _cloth(rng, ("7b4f32", "b07b4f", "e2c290"), (6, 8)), (0.35, 0.2, 0.02)),
    }  # fmt: skip
    for k, x in enumerate((-1.1, 0.9)):
        parts[f"arm_{k}"] = s.box((x, 1.58, 0.36), (0.18, 0.78, 0.5), cover)
        parts[f"roll_{k}"] = s.lathe([(0, 0), (0.11, 0), (0.11, 0.78), (0, 0.78)], cover, (x, 1.97, 0.62), tilt=90,
                                     smooth=False)  # fmt: skip
    prints = (
        ("b23a48", "f4e3c1"),
        ("e0a030", "3c4f2f", "f2e6c8"),
        ("2f5d50", "d8c690"),
        ("efe6d5", "8c2f39", "1d3557"),
    )
    for k, x in enumerate((-0.78, -0.36, 0.14, 0.56)):
        place = (x + float(rng.uniform(-0.04, 0.04)), 1.66, 0.6)
        print_ = s.diffuse(t.motif((192, 256), rng, repeats=(3, 6), colors=prints[k]))
        parts[f"cushion_{k}"] = s.ball(
            place, 0.21, print_, yaw=float(rng.uniform(-20, 20)), squash=0.42, tilt=62 + float(rng.uniform(-8, 8))
        )
    throw = s.diffuse(t.bordered(t.motif((256, 128), rng, repeats=(9, 4), colors=("d9cdb4", "7a8f6a")), "7a8f6a"))
    parts["throw"] = s.box((0.62, 1.42, 0.415), (0.42, 0.72, 0.012), throw, yaw=7)
    return parts


def _pictures(rng: t.Rng) -> dict[str, Any]:
    frame = s.plastic(t.wood((64, 128), rng, planks=1, colors=("2a1c12", "4f3620", "6e4c2c")), 0.2)
    parts: dict[str, Any] = {}
    grounds = (("1d3557", "a8c5c9", "f1e4c8"), ("5b3a6b", "d98c5f", "f2dcc2"), ("2f5d50", "b9c48a", "efe8cf"))
    for k, (x, z, w, h) in enumerate(((-0.95, 1.6, 0.6, 0.5), (-0.1, 1.65, 0.85, 0.62), (0.85, 1.55, 0.5, 0.66))):
        picture = t.painting((round(320 * h), round(320 * w)), rng, colors=grounds[k])
        parts[f"frame_{k}"] = s.box((x, 2.17, z), (w + 0.1, 0.05, h + 0.1), frame)
        parts[f"picture_{k}"] = s.quad((x, 2.14, z), (w / 2, 0, 0), (0, 0, h / 2), s.diffuse(picture))
    return parts


def _lamp(rng: t.Rng) -> dict[str, Any]:
    """A lamp on a stand in the corner: its shade glows, and the bulb lights ceiling and wall above it."""
    shade = s.diffuse(t.plain((64, 128), rng, "e8d6b0"))
    brass = s.metal("Cu", 0.2)
    return {
        "stand": s.lathe([(0, 0), (0.16, 0), (0.15, 0.03), (0.02, 0.06), (0.015, 1.35), (0, 1.36)], brass,
                         (1.55, 1.6, 0), smooth=False),
        "shade": s.lathe([(0.26, 1.3), (0.15, 1.62)], s.twosided(shade), (1.55, 1.6, 0), smooth=False,
                         emitter=s.glow((2.6, 1.8, 1.0))),
    }  # fmt: skip


def _side_table(rng: t.Rng) -> dict[str, Any]:
    """A small table on the left with books, a jug and a plant of narrow leaves."""
    wood = s.plastic(t.wood((128, 128), rng, planks=3, colors=("3b2414", "6b4526", "93653b")), 0.2)
    foot = np.array([-1.55, 0.95, 0.0])
    parts: dict[str, Any] = {
        "table_top": s.lathe([(0, 0.5), (0.32, 0.5), (0.33, 0.53), (0, 0.54)], wood, foot.tolist(), smooth=False),
        "table_leg": s.lathe([(0.16, 0), (0.05, 0.1), (0.035, 0.3), (0.08, 0.5)], wood, foot.tolist()),
        "jug": s.lathe([(0, 0), (0.08, 0), (0.11, 0.08), (0.06, 0.18), (0.075, 0.24), (0.06, 0.23), (0.045, 0.17)],
                       s.plastic(t.cells((96, 192), rng, count=80, colors=("e9e2d0", "38598b", "a2a8d3")), 0.1),
                       (foot + [0.12, -0.1, 0.54]).tolist()),
    }  # fmt: skip
    z = 0.54
    for k in range(3):
        thick = float(rng.uniform(0.025, 0.05))
        jacket = s.diffuse(t.bordered(t.plain((64, 96), rng, ("8c2f39", "2f5d50", "d9a441")[k]), "efe6d5", 0.1))
        parts[f"book_{k}"] = s.box((foot[0] - 0.12, foot[1] - 0.06, z + thick / 2), (0.22, 0.16, thick), jacket,
                                   yaw=float(rng.uniform(-30, 30)))  # fmt: skip
        z += thick
    pot = foot + [0.0, 0.75, 0.0]
    clay = s.diffuse(t.mottled((64, 128), rng, ("6e3320", "a85a38", "cf8a5e")))
    profile = [(0, 0), (0.16, 0), (0.2, 0.32), (0.17, 0.34), (0.16, 0.3), (0, 0.28)]
    parts["pot"] = s.lathe(profile, clay, pot.tolist())
    angle, lean = rng.uniform(0, 2 * np.pi, 60), rng.uniform(0.08, 0.5, 60)
    middle = pot + np.stack([0.5 * lean * np.cos(angle), 0.5 * lean * np.sin(angle), rng.uniform(0.6, 0.85, 60)], -1)
    tip = middle + np.stack([0.6 * lean * np.cos(angle), 0.6 * lean * np.sin(angle), rng.uniform(-0.1, 0.35, 60)], -1)
    leaf = s.twosided(s.diffuse(t.mottled((64, 64), rng, ("1f4020", "3f7030", "86a845"))))
    root = np.broadcast_to(pot + [0, 0, 0.3], middle.shape)
    parts["leaves"] = s.ribbons(np.concatenate([root, middle]), np.concatenate([middle, tip]), 0.035, leaf)
    return parts


def _tube(start: ArrayLike, end: ArrayLike, radius: float, bsdf: Any) -> Any:
    """A rod with closed ends."""
    first = np.asarray(start, dtype=np.float64)
    x, y, z = (along := np.asarray(end, dtype=np.float64) - first)
    length = float(np.linalg.norm(along))
    # Normals run from point to point: short bevels keep the shade of the ends off the rod between them.
    bevel = 0.3 * radius
    ends = [(0.0, 0.0), (radius, bevel), (radius, 2 * bevel)]
    profile = [*ends, *((r, length - z) for r, z in reversed(ends))]
    yaw, tilt = np.degrees(np.arctan2(x, -y)), np.degrees(np.arccos(z / length))
    return s.lathe(profile, bsdf, first.tolist(), float(yaw), tilt=float(tilt), smooth=False, segments=12)


def _ring(hub: s.Floats, across: ArrayLike, radius: float, thick: float, bsdf: Any) -> Any:
    """A torus around `hub` in the plane of the unit vector `across` and the vertical."""
    out = np.asarray(across, dtype=np.float64)
    axle = np.cross(out, [0.0, 0.0, 1.0])
    around, tube = np.linspace(0, 2 * np.pi, 65), np.linspace(0, 2 * np.pi, 13)
    radial = np.cos(around)[:, None] * out + np.sin(around)[:, None] * np.array([0.0, 0.0, 1.0])
    normals = -np.sin(tube)[None, :, None] * axle + np.cos(tube)[None, :, None] * radial[:, None]
    points = hub + radius * radial[:, None] + thick * normals
    u, v = np.broadcast_arrays((around / (2 * np.pi))[:, None], (tube / (2 * np.pi))[None])
    uv = np.stack([u, v], -1).reshape(-1, 2)
    return s.mesh(points.reshape(-1, 3), s.grid_faces(65, 13), uv, bsdf, normals.reshape(-1, 3))


def _wheel(name: str, hub: s.Floats, across: ArrayLike, rubber: Any, steel: Any) -> dict[str, Any]:
    """Tyre, rim, hub and 28 spokes."""
    out, up = np.asarray(across, dtype=np.float64), np.array([0.0, 0.0, 1.0])
    axle = np.cross(out, up)
    angle = np.linspace(0, 2 * np.pi, 28, endpoint=False)
    rim = hub + 0.29 * (np.cos(angle)[:, None] * out + np.sin(angle)[:, None] * up)
    # Spokes leave the hub's two flanges by turns, and not radially.
    flange = np.where(np.arange(28) % 2, 0.03, -0.03)[:, None] * axle
    lead = angle + np.where(np.arange(28) % 4 < 2, 0.9, -0.9)
    inner = hub + flange + 0.025 * (np.cos(lead)[:, None] * out + np.sin(lead)[:, None] * up)
    return {
        f"{name}_tyre": _ring(hub, out, 0.325, 0.024, rubber),
        f"{name}_rim": _ring(hub, out, 0.295, 0.012, steel),
        f"{name}_hub": _tube(hub - 0.04 * axle, hub + 0.04 * axle, 0.028, steel),
        f"{name}_spokes": s.ribbons(inner, rim, 0.004, steel),
    }


def _bicycle(rng: t.Rng, foot: Any) -> dict[str, Any]:
    """A roadster along x whose saddle leans towards the wall; the front wheel is turned a little."""
    paint = s.plastic(t.plain((64, 64), rng, ("8c1c13", "1f4d3a", "243b63")[int(rng.integers(3))], grain=0.2), 0.1)
    rubber = s.diffuse(t.finish(np.full((32, 256, 3), 0.05), rng, grain=0.3))
    steel = s.twosided(s.metal("Cr", 0.15))
    leather = s.plastic(t.mottled((64, 64), rng, ("3b2112", "6b3f22", "8f5d36")), 0.3)
    turned = np.radians(float(rng.uniform(8, 22)))
    rear, front = foot + [-0.55, 0, 0.35], foot + [0.53, 0, 0.35]
    crank, saddle, neck = foot + [-0.1, 0, 0.3], foot + [-0.25, 0, 0.82], foot + [0.36, 0, 0.84]
    bar = foot + [0.33, 0, 0.96]
    reach = 0.28 * np.array([np.sin(turned), np.cos(turned), 0])
    tubes = {
        "top_tube": (saddle - [-0.02, 0, 0.06], neck), "down_tube": (crank, neck - [-0.02, 0, 0.08]),
        "seat_tube": (crank, saddle), "stem": (neck - [-0.03, 0, 0.1], bar),
    }  # fmt: skip
    parts: dict[str, Any] = {name: _tube(a, b, 0.016, paint) for name, (a, b) in tubes.items()}
    for k, side in enumerate((-0.045, 0.045)):
        apart = np.array([0, side, 0])
        parts[f"chain_stay_{k}"] = _tube(crank + apart, rear + apart, 0.009, paint)
        parts[f"seat_stay_{k}"] = _tube(saddle - [0, 0, 0.1], rear + apart, 0.008, paint)
        parts[f"fork_{k}"] = _tube(neck - [-0.03, 0, 0.1], front + apart, 0.011, paint)
        parts[f"handle_{k}"] = _tube(bar, bar + np.sign(side) * reach + [-0.04, 0, 0.03], 0.012, steel)
        parts[f"grip_{k}"] = _tube(bar + np.sign(side) * reach + [-0.04, 0, 0.03],
                                   bar + np.sign(side) * reach + [-0.16, 0, 0.01], 0.017, rubber)  # fmt: skip
        pedal = crank + [0.12 * np.sign(side), 2.2 * side, 0.1 * np.sign(side)]
        parts[f"crank_{k}"] = _tube(crank + 2 * apart, pedal, 0.01, steel)
        parts[f"pedal_{k}"] = s.box(pedal + 0.6 * apart, (0.09, 0.08, 0.02), rubber)
    parts["sprocket"] = _ring(crank + [0, -0.05, 0], (1, 0, 0), 0.085, 0.008, steel)
    parts["saddle"] = s.ball(saddle + [-0.02, 0, 0.07], 0.13, leather, squash=0.35)
    wicker = s.diffuse(t.motif((128, 256), rng, repeats=(8, 16), colors=("4a3218", "b08a52")))
    parts["basket"] = s.box(foot + [0.55, 0, 0.9], (0.26, 0.34, 0.2), wicker)
    parts |= _wheel("rear", rear, (1.0, 0.0, 0.0), rubber, steel)
    return parts | _wheel("front", front, (np.cos(turned), -np.sin(turned), 0.0), rubber, steel)


def _ivy(rng: t.Rng) -> Any:
    """Leaves over the left of the wall, thinning out to the right; one mesh."""
    count = 900
    x, z = -2.0 + 1.9 * rng.beta(1, 2.2, count), 2.5 * rng.beta(1.6, 1.1, count)
    center = np.stack([x, 2.08 - rng.uniform(0.0, 0.09, count), z], -1)
    angle, size = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.035, 0.075, (count, 1))
    tilt = rng.uniform(-0.6, 0.3, count)
    u = np.stack([np.cos(angle), tilt * 0.5, np.sin(angle)], -1)
    v = np.stack([-np.sin(angle), tilt, np.cos(angle)], -1)
    corners = np.stack([center - size * u, center - 0.7 * size * v, center + size * u, center + 0.7 * size * v], 1)
    faces = (4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    shade = rng.uniform(0, 0.96, (count, 1, 2)) + np.array([[0, 0], [0.04, 0], [0.04, 0.04], [0, 0.04]])
    green = t.mottled((64, 64), rng, ("17301a", "2f5a26", "5f8a3a", "8f3f2a"))
    return s.mesh(corners.reshape(-1, 3), faces, shade.reshape(-1, 2), s.twosided(s.diffuse(green)))


def _yard(rng: t.Rng) -> dict[str, Any]:
    """A gate, crates with fruit, pots, and a sign on the wall."""
    plank = s.diffuse(t.wood((192, 128), rng, planks=6, colors=("3c5a66", "5f8290", "8fb0b8")))
    crate = s.diffuse(t.wood((96, 128), rng, planks=3))
    parts: dict[str, Any] = {
        "gate": s.box((1.3, 2.07, 0.75), (0.95, 0.08, 1.5), plank),
        "sign": s.box((0.2, 2.07, 1.75), (0.9, 0.04, 0.36),
                      s.diffuse(t.lettering((96, 240), rng, "NO 17", ink="f0e8d0", paper="1d3557")[::-1])),
        "crate_low": s.box((-1.25, 0.75, 0.17), (0.6, 0.42, 0.34), crate, yaw=float(rng.uniform(-20, 20))),
        "crate_high": s.box((-1.3, 0.8, 0.48), (0.5, 0.36, 0.28), crate, yaw=float(rng.uniform(-30, 30))),
    }  # fmt: skip
    for k in range(5):
        skin = s.plastic(t.mottled((64, 128), rng, ("a8231c", "d96c2c", "e9c46a")), 0.1)
        place = (-1.45 + 0.08 * k, 0.72 + 0.09 * float(rng.uniform(-1, 1)), 0.66)
        parts[f"apple_{k}"] = s.ball(place, 0.055, skin, squash=0.9)
    pot = [(0, 0), (0.13, 0), (0.18, 0.26), (0.2, 0.27), (0.2, 0.31), (0.17, 0.31), (0.15, 0.27), (0, 0.25)]
    for k, (x, y) in enumerate(((0.95, 0.9), (1.35, 1.15))):
        clay = s.diffuse(t.mottled((64, 128), rng, ("6e3320", "a85a38", "cf8a5e")))
        bloom = t.cells((64, 128), rng, count=160, joint=0.5,
                        colors=("2f5a1f", "6f9a3a", ("c2374f", "e0a030")[k], "4c7a2a"))  # fmt: skip
        parts[f"pot_{k}"] = s.lathe(pot, clay, (x, y, 0))
        parts[f"flowers_{k}"] = s.ball((x, y, 0.42), 0.2, s.diffuse(bloom), yaw=70.0 * k, squash=0.9)
    return parts
