"""Procedural textures with natural spectra.

Every texture is linear RGB reflectance, float32 [h,w,3] inside 0.02..0.85, made from a random generator alone.
Contrast falls off like 1/f, so most of it survives at the 128 to 256 pixel images of quick experiments, while some
detail stays below a pixel. Colours are written as sRGB hex, as a painter would pick them.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sensor_model.isp import srgb_to_linear
from simscenes.scenes.parts.remembered import remembered

Rng = np.random.Generator
Texels = NDArray[np.float32]
Field = NDArray[np.float64]


def color(hex_code: str) -> Field:
    """Linear RGB [3] of an sRGB hex colour such as "c08040"."""
    return srgb_to_linear(np.array([int(hex_code[i : i + 2], 16) for i in (0, 2, 4)]) / 255.0)


def fractal(shape: tuple[int, int], rng: Rng, *, beta: float = 1.2, stretch: tuple[float, float] = (1, 1)) -> Field:
    """Tileable noise [h,w], zero mean and unit variance, amplitude spectrum 1/f**beta.

    Args:
        shape: (h, w) in texels.
        rng: Source of randomness.
        beta: Steepness; natural images lie near 1, larger is smoother.
        stretch: Relative feature length along (y, x).
    """
    fy = np.fft.fftfreq(shape[0])[:, None] * shape[0] * stretch[0]
    fx = np.fft.rfftfreq(shape[1])[None, :] * shape[1] * stretch[1]
    radius = np.hypot(fy, fx)
    radius[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal(shape)) / radius**beta
    noise = np.fft.irfft2(spectrum, s=shape)
    return noise / noise.std()


def ramp(t: Field, colors: Sequence[str]) -> Field:
    """Colour ramp: scalars in 0..1 [h,w] -> linear RGB [h,w,3] between evenly spaced colours."""
    stops = np.stack([color(c) for c in colors])
    knots = np.linspace(0, 1, len(colors))
    return np.stack([np.interp(t, knots, stops[:, k]) for k in range(3)], -1)


def finish(rgb: Field, rng: Rng, *, grain: float = 0.12, hue: float = 0.05, beta: float = 1.1) -> Texels:
    """Weather a texture: multiply by 1/f luminance and hue variation, then keep it a possible reflectance."""
    shape = rgb.shape[:2]
    shade = grain * fractal(shape, rng, beta=beta)[..., None]
    tint = hue * fractal(shape, rng, beta=1.6)[..., None] * np.array([1.0, -0.2, -1.0])  # warmer here, cooler there
    return np.clip(rgb * np.exp(shade + tint), 0.02, 0.85).astype(np.float32)


def plain(shape: tuple[int, int], rng: Rng, hex_code: str, **wear: float) -> Texels:
    """One colour, weathered; `wear` as for `finish`."""
    return finish(np.broadcast_to(color(hex_code), (*shape, 3)), rng, **wear)


def mottled(
    shape: tuple[int, int], rng: Rng, colors: Sequence[str], *, contrast: float = 0.3, beta: float = 1.2, **wear: float
) -> Texels:
    """Clouds of 1/f noise through a colour ramp; `beta` as for `fractal`, `wear` as for `finish`."""
    return finish(ramp(np.clip(0.5 + contrast * fractal(shape, rng, beta=beta), 0, 1), colors), rng, **wear)


def _grid(shape: tuple[int, int]) -> tuple[Field, Field]:
    y, x = np.mgrid[: shape[0], : shape[1]]
    return (y + 0.5) / shape[0], (x + 0.5) / shape[1]


@remembered
def wood(shape: tuple[int, int], rng: Rng, *, planks: int = 4, colors: Sequence[str] = ()) -> Texels:
    """Planks along x with stretched grain, each of its own shade."""
    y, x = _grid(shape)
    row = np.minimum((y * planks).astype(int), planks - 1)
    offset = rng.uniform(0, 1, planks)[row]
    joint = np.abs(((x + offset) * 2.0) % 1.0 - 0.5) > 0.492
    gap = (np.abs((y * planks) % 1.0 - 0.5) > 0.475) | joint
    grain = fractal(shape, rng, beta=1.1, stretch=(1, 9)) + 0.6 * np.sin(40 * y + 3 * fractal(shape, rng, beta=1.8))
    shade = rng.normal(0, 0.22, (planks, 3))[row, ((x + offset) * 2.0).astype(int) % 3]
    rgb = ramp(0.5 + 0.16 * grain + shade, colors or ("4a2f1b", "8a5a33", "b98a58", "d9b483"))
    return finish(np.where(gap[..., None], 0.25 * rgb, rgb), rng, grain=0.08)


@remembered
def bricks(shape: tuple[int, int], rng: Rng, *, rows: int = 12, columns: int = 6, colors: Sequence[str] = ()) -> Texels:
    """Running-bond brickwork with mortar, each brick of its own shade."""
    y, x = _grid(shape)
    row = (y * rows).astype(int)
    u = x * columns + 0.5 * (row % 2)
    shade = rng.normal(0, 1, (rows, columns))[row, u.astype(int) % columns]
    wobble = 0.03 * fractal(shape, rng, beta=1.3)
    mortar = (np.abs(u % 1.0 - 0.5) + wobble > 0.46) | (np.abs((y * rows) % 1.0 - 0.5) + wobble > 0.42)
    rgb = ramp(0.5 + 0.2 * shade + 0.13 * fractal(shape, rng), colors or ("5c2a1e", "8f4a33", "b5694a", "d39a77"))
    return finish(np.where(mortar[..., None], color("b8ad9c") * (1 + 0.1 * shade[..., None]), rgb), rng)


@remembered
def cells(shape: tuple[int, int], rng: Rng, *, count: int = 60, colors: Sequence[str], joint: float = 0.1) -> Texels:
    """Voronoi cells (cobbles, terrazzo, leather), tileable, rounded towards their dark joints."""
    from scipy.spatial import cKDTree  # a third of a second that a list of scenes need not wait for

    y, x = _grid(shape)
    points, shades = rng.uniform(0, 1, (count, 2)), rng.uniform(0, 1, count)
    nearest, owner = cKDTree(points, boxsize=1.0).query(np.stack([y, x], -1), k=2)
    gap = (nearest[..., 1] - nearest[..., 0]) * np.sqrt(count)
    edge = np.clip(gap / joint, 0, 1)
    rgb = ramp(np.clip(shades[owner[..., 0]] + 0.1 * fractal(shape, rng), 0, 1), colors)
    return finish(rgb * (0.25 + 0.75 * edge[..., None]), rng)


@remembered
def marble(shape: tuple[int, int], rng: Rng, *, colors: Sequence[str] = ("e8e4dc", "c9c2b8", "7d7a78")) -> Texels:
    """Veined stone: ridges of warped noise."""
    ridge = np.exp(-4 * np.abs(fractal(shape, rng, beta=1.7))) + 0.6 * np.exp(
        -6 * np.abs(fractal(shape, rng, beta=1.5))
    )
    return finish(ramp(np.clip(0.8 * ridge + 0.1 * fractal(shape, rng), 0, 1), colors), rng, grain=0.06)


@remembered
def motif(
    shape: tuple[int, int], rng: Rng, *, repeats: tuple[int, int], colors: Sequence[str], edge: float = 4.0
) -> Texels:
    """Printed pattern: one random mirrored figure repeated over the sheet, as in wallpaper, cloth and rugs.

    `edge` is how sharp the print is: 4 is ink on paper, 1 a faded dye that bleeds into its ground.
    """
    y, x = _grid(shape)
    u, v = np.abs((x * repeats[1]) % 1.0 - 0.5) * 2, np.abs((y * repeats[0]) % 1.0 - 0.5) * 2
    a = rng.integers(1, 3, 6)
    field = np.cos(np.pi * a[0] * u) * np.cos(np.pi * a[1] * v) + np.cos(np.pi * a[2] * np.hypot(u, v) * 1.2)
    field += 0.7 * np.cos(np.pi * (a[3] * u + a[4] * v)) + 0.10 * fractal(shape, rng)
    steps = 0.5 + 0.5 * np.tanh(edge * np.sin(2.2 * field))  # bands: print and ground share the sheet
    levels = np.clip(0.62 * steps + 0.19 * (field + 1), 0, 1)
    return finish(ramp(levels, colors), rng)


def bordered(texels: Texels, hex_code: str, width: float = 0.08) -> Texels:
    """Lay a frame of one weathered colour around a texture."""
    y, x = _grid(texels.shape[:2])
    edge = (np.minimum(y, 1 - y) * texels.shape[0] < width * min(texels.shape[:2])) | (
        np.minimum(x, 1 - x) * texels.shape[1] < width * min(texels.shape[:2])
    )
    shade = 0.5 + texels.mean(-1, keepdims=True)
    return np.where(edge[..., None], np.clip(color(hex_code) * shade, 0.02, 0.85), texels).astype(np.float32)


@remembered
def painting(shape: tuple[int, int], rng: Rng, *, colors: Sequence[str], strokes: int = 40) -> Texels:
    """Abstract picture: a coloured ground with random discs, bars and rings."""
    y, x = _grid(shape)
    x = x * shape[1] / shape[0]
    rgb = ramp(np.clip(0.5 + 0.3 * fractal(shape, rng, beta=1.6), 0, 1), colors)
    for k in range(strokes):
        size = 0.35 / (1 + 0.12 * k)
        cy, cx, angle = rng.uniform(0, 1), rng.uniform(0, shape[1] / shape[0]), rng.uniform(0, np.pi)
        a, b = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle), (y - cy) * np.cos(angle) - (x - cx) * np.sin(angle)
        radius = np.hypot(a, b)
        figures = (
            radius < size * 0.6,
            (np.abs(a) < size) & (np.abs(b) < size * 0.18),
            np.abs(radius - size * 0.6) < size * 0.1,
        )
        inside = figures[int(rng.integers(3))]
        rgb[inside] = color(colors[int(rng.integers(len(colors)))]) * rng.uniform(0.7, 1.2)
    return finish(rgb, rng, grain=0.1, hue=0.08)


@remembered
def lettering(shape: tuple[int, int], rng: Rng, text: str, *, ink: str, paper: str) -> Texels:
    """Framed text as large as fits, printed on worn paper or paint."""
    import cv2

    canvas = np.zeros(shape, dtype=np.uint8)
    thickness = max(2, min(shape) // 14)
    (w, h), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, 1.0, 1)
    scale = 0.72 * min(shape[1] / w, shape[0] / h)
    origin = (int((shape[1] - w * scale) / 2), int((shape[0] + h * scale) / 2))
    cv2.putText(canvas, text, origin, cv2.FONT_HERSHEY_DUPLEX, scale, 255, thickness, cv2.LINE_AA)
    cv2.rectangle(canvas, (thickness, thickness), (shape[1] - thickness, shape[0] - thickness), 255, thickness)
    mask = canvas[..., None] / 255.0
    return finish(color(paper) * (1 - mask) + color(ink) * mask, rng, grain=0.15, hue=0.08)


@remembered
def spines(shape: tuple[int, int], rng: Rng, *, colors: Sequence[str], count: int = 18) -> Texels:
    """A shelf of book spines of differing width, height and title bands."""
    rgb = np.full((*shape, 3), 0.03)
    edges = np.concatenate([[0], np.cumsum(rng.uniform(0.6, 1.6, count))])
    edges = (edges / edges[-1] * shape[1]).astype(int)
    for left, right in zip(edges[:-1], edges[1:], strict=True):
        top = int(rng.uniform(0.02, 0.25) * shape[0])
        rgb[top:, left + 1 : right] = color(colors[int(rng.integers(len(colors)))])
        for band in rng.uniform(top / shape[0] + 0.05, 0.95, 3):
            row, thick = int(band * shape[0]), max(2, int(rng.uniform(0.01, 0.06) * shape[0]))
            rgb[row : row + thick, left + 1 : right] = color(colors[int(rng.integers(len(colors)))])
    return finish(rgb, rng)


def stacked(parts: Sequence[Texels], rows: int) -> Texels:
    """Tile equally sized textures into `rows` rows, row by row."""
    columns = len(parts) // rows
    lines = [np.concatenate(parts[r * columns : (r + 1) * columns], axis=1) for r in range(rows)]
    return functools.reduce(lambda a, b: np.concatenate([a, b], axis=0), lines)
