"""Clean pictures that belong to no scene: dead leaves, gradients, gratings, text and the catalogue's textures.

Every picture is linear RGB, float32 [size, size, 3], > 0, of any exposure; it follows from its number alone. They are
drawn at twice the size and averaged, so that edges are as soft as a camera's.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from simscenes.scenes.parts import textures

Rng = np.random.Generator
Picture = NDArray[np.float32]
FONTS = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_COMPLEX, cv2.FONT_HERSHEY_TRIPLEX)
LETTERS = np.array(list("ABCDEFGHIKLMNOPRSTUVWXYZabcdefghiklmnoprstuvz0123456789&?!"))


def picture(number: int, size: int) -> Picture:
    """The synthetic picture of this number."""
    rng = np.random.default_rng([number, 7])
    shape = (2 * size, 2 * size)
    kind = KINDS[int(rng.choice(len(KINDS), p=SHARES))]
    rgb = kind(shape, rng)
    if rng.random() < 0.5:
        rgb = rgb * _illumination(shape, rng)
    if rng.random() < 0.1:
        _lamps(rgb, rng)
    small = cv2.resize(rgb.astype(np.float32), (size, size), interpolation=cv2.INTER_AREA)
    if rng.random() < 0.4:
        small = cv2.GaussianBlur(small, (0, 0), float(rng.uniform(0.3, 1.2)))
    return np.maximum(small, 1e-4)


def _color(rng: Rng) -> NDArray[np.float64]:
    """A reflectance; most of them dull."""
    grey = np.exp(rng.uniform(np.log(0.02), np.log(0.9)))
    return grey * np.exp(rng.normal(0, rng.choice([0.05, 0.3, 0.8]), 3))


def _surface(shape: tuple[int, int], rng: Rng) -> NDArray[np.float64]:
    """A colour with some texture of its own."""
    rgb = np.broadcast_to(_color(rng), (*shape, 3)).copy()
    draw = rng.random()
    if draw < 0.35:
        rgb *= np.exp(rng.uniform(0.03, 0.5) * textures.fractal(shape, rng, beta=rng.uniform(0.6, 1.8)))[..., None]
    elif draw < 0.5:
        rgb += (_color(rng) - rgb) * _grating(shape, rng)[..., None]
    return rgb


def _grid(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    y, x = np.mgrid[: shape[0], : shape[1]]
    return y / shape[0], x / shape[1]


def _grating(shape: tuple[int, int], rng: Rng) -> NDArray[np.float64]:
    """Stripes in 0..1: sinusoids or bars, of any direction and period, straight or bent."""
    y, x = _grid(shape)
    angle = rng.uniform(0, np.pi)
    period = np.exp(rng.uniform(np.log(4), np.log(80))) / shape[0]
    phase = (np.cos(angle) * x + np.sin(angle) * y) / period
    if rng.random() < 0.5:
        phase = phase + rng.uniform(0.2, 2) * textures.fractal(shape, rng, beta=2.0)
    wave = np.sin(2 * np.pi * phase)
    return 0.5 + 0.5 * (wave if rng.random() < 0.5 else np.sign(wave))


def _leaves(shape: tuple[int, int], rng: Rng) -> NDArray[np.float64]:
    """Dead leaves (Lee, Mumford, Huang 2001): discs, bars and polygons of all sizes that hide one another."""
    rgb = _surface(shape, rng)
    largest = rng.uniform(0.15, 0.6)
    for _ in range(int(rng.integers(30, 200))):
        # Sizes follow r**-3 between the limits: the picture looks the same at every scale.
        low, high = 0.025**-2, largest**-2
        size = shape[0] * (low + (high - low) * rng.random()) ** -0.5
        centre = rng.uniform(0, shape[0], 2)
        inside = np.zeros(shape, np.uint8)
        cv2.fillPoly(inside, [_outline(centre, size, rng)], 1)
        top, left = np.maximum(np.floor(centre - 1.5 * size), 0).astype(int)[::-1]
        window = np.s_[top : top + int(3 * size) + 2, left : left + int(3 * size) + 2]
        part = inside[window].astype(bool)
        if part.size and part.any():
            patch = rgb[window]
            patch[part] = _surface(part.shape, rng)[part] if size > 12 else _color(rng)
    return rgb


def _outline(centre: NDArray[np.float64], size: float, rng: Rng) -> NDArray[np.int32]:
    corners = int(rng.choice([3, 4, 4, 5, 6, 40]))
    angles = np.linspace(0, 2 * np.pi, corners, endpoint=False) + rng.uniform(0, 2 * np.pi)
    radius = size * (1 if corners == 40 else rng.uniform(0.5, 1, corners))
    flat = rng.choice([1.0, rng.uniform(0.1, 1)])
    ring = np.stack([radius * np.cos(angles), flat * radius * np.sin(angles)], -1)
    turn = rng.uniform(0, np.pi)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.round(centre + ring @ rotation).astype(np.int32)


def _gradient(shape: tuple[int, int], rng: Rng) -> NDArray[np.float64]:
    """A smooth passage between two or three colours."""
    t = textures.fractal(shape, rng, beta=rng.uniform(1.8, 3.0))
    t = (t - t.min()) / np.ptp(t)
    return _color(rng) * (1 - t)[..., None] + _color(rng) * t[..., None]


def _gratings(shape: tuple[int, int], rng: Rng) -> NDArray[np.float64]:
    wave = _grating(shape, rng)[..., None]
    if rng.random() < 0.4:  # a chequered pattern
        other = _grating(shape, rng)[..., None]
        wave = wave * other + (1 - wave) * (1 - other)
    return _surface(shape, rng) * (1 - wave) + _surface(shape, rng) * wave


def _text(shape: tuple[int, int], rng: Rng) -> NDArray[np.float64]:
    """Lines of letters in one ink on a surface."""
    ink = np.zeros(shape, np.uint8)
    scale = float(np.exp(rng.uniform(np.log(0.5), np.log(4))))
    thick = max(1, int(round(scale * rng.uniform(0.8, 3))))
    row, font = 0.0, FONTS[int(rng.integers(len(FONTS)))]
    while row < shape[0]:
        row += 32 * scale
        line = "".join(rng.choice(LETTERS, 30))
        cv2.putText(ink, line, (int(rng.integers(-20, 20)), int(row)), font, scale, 255, thick, cv2.LINE_AA)
    mask = (ink / 255.0)[..., None]
    return _surface(shape, rng) * (1 - mask) + _surface(shape, rng) * mask


def _texture(shape: tuple[int, int], rng: Rng) -> NDArray[np.float64]:
    """A weathered material in colours of its own, or two of them beside each other."""
    rgb = _material(shape, rng)
    if rng.random() < 0.5:
        inside = _grating(shape, rng)[..., None] > rng.uniform(0.2, 0.8)
        rgb = np.where(inside, _material(shape, rng), rgb)
    return rgb


def _material(shape: tuple[int, int], rng: Rng) -> NDArray[np.float64]:
    colors = ["".join(f"{c:02x}" for c in rng.integers(10, 250, 3)) for _ in range(int(rng.integers(2, 5)))]
    draw = int(rng.integers(7))
    if draw == 0:
        made = textures.wood(shape, rng, planks=int(rng.integers(1, 8)), colors=colors)
    elif draw == 1:
        made = textures.bricks(
            shape, rng, rows=int(rng.integers(4, 20)), columns=int(rng.integers(2, 10)), colors=colors
        )
    elif draw == 2:
        made = textures.cells(shape, rng, count=int(rng.integers(10, 200)), colors=colors, joint=rng.uniform(0.03, 0.3))
    elif draw == 3:
        repeats = int(rng.integers(1, 8)), int(rng.integers(1, 8))
        made = textures.motif(shape, rng, repeats=repeats, colors=colors, edge=rng.uniform(1, 6))
    elif draw == 4:
        made = textures.painting(shape, rng, colors=colors, strokes=int(rng.integers(5, 60)))
    elif draw == 5:
        made = textures.spines(shape, rng, colors=colors, count=int(rng.integers(6, 30)))
    else:
        clouds = textures.ramp(0.5 + 0.2 * textures.fractal(shape, rng, beta=rng.uniform(0.7, 1.6)), colors)
        made = textures.finish(clouds, rng)
    return made.astype(np.float64)


def _illumination(shape: tuple[int, int], rng: Rng) -> NDArray[np.float64]:
    """Light that falls off smoothly, sometimes with the edge of a shadow."""
    y, x = _grid(shape)
    light = np.exp(rng.normal(0, 1.0) * (x - 0.5) + rng.normal(0, 1.0) * (y - 0.5))
    light = light * np.exp(rng.uniform(0, 0.6) * textures.fractal(shape, rng, beta=2.5))
    if rng.random() < 0.5:
        distance = np.cos(turn := rng.uniform(0, 2 * np.pi)) * (x - rng.uniform(0.2, 0.8)) + np.sin(turn) * (y - 0.5)
        light = light * (1 - rng.uniform(0.4, 0.95) / (1 + np.exp(-distance / rng.uniform(0.002, 0.05))))
    return light[..., None]


def _lamps(rgb: NDArray[np.float64], rng: Rng) -> None:
    """Some small spots many times brighter than the rest."""
    for _ in range(int(rng.integers(1, 5))):
        inside = np.zeros(rgb.shape[:2], np.uint8)
        cv2.circle(inside, tuple(int(c) for c in rng.integers(0, rgb.shape[0], 2)), int(rng.integers(2, 16)), 1, -1)
        rgb[inside.astype(bool)] = np.exp(rng.uniform(0, 3)) * np.exp(rng.normal(0, 0.2, 3))


KINDS = (_leaves, _gradient, _gratings, _text, _texture)
SHARES = (0.4, 0.08, 0.12, 0.1, 0.3)
