"""The pictures of a report: for a few views, everything from the dark exposure to the error map, as data URIs."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import matplotlib
import numpy as np

from novags.methods.problem import encode
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source
from novags.testbed.metrics import affine_aligned
from novags.testbed.references import enhanced_dark, references, true_depth
from simscenes.sets.pictures.png import read_png

VIEWS_OF_EACH_KIND = 4  # held-out and training views shown: enough to judge, small enough to mail
MAX_SIDE = 640  # px; larger pictures are shrunk for the report only
PNG_PIXELS = 256 * 256  # above it JPEG: noise compresses badly, and the file would grow by megabytes
TRUTHS = {
    "enhanced": ("Truth: noise-free", "the same exposure without noise, enhanced alike"),
    "linear": ("Truth: noise-free", "the same exposure without noise, in linear light"),
    "lit": ("Truth: well lit", "the scene in good light"),
}
LONG = {  # of imported photographs
    "enhanced": ("Truth: long exposure", "brought to the light of the dark one, enhanced alike"),
    "linear": ("Truth: long exposure", "brought to the light of the dark one"),
}
WORDS = {"enhanced": "noise-free", "linear": "noise-free", "lit": "well-lit"}
ERROR_CEILING = 0.25  # sRGB code units at the bright end of the error maps, the same in every report


@dataclass(frozen=True)
class Tile:
    """One picture with what it shows."""

    key: str
    label: str
    note: str
    alt: str
    uri: str


@dataclass(frozen=True)
class ViewTiles:
    """All pictures of one view."""

    name: str
    held_out: bool
    width: int
    height: int
    depth_range: tuple[float, float] | None
    tiles: tuple[Tile, ...]


def pick_views(capture: Capture) -> list[int]:
    """A few held-out views, then a few training views, spread evenly."""
    return [*_spread(capture.cameras.test_indices), *_spread(capture.cameras.train_indices)]


def _spread(indices: Sequence[int]) -> list[int]:
    places = np.linspace(0, len(indices) - 1, min(VIEWS_OF_EACH_KIND, len(indices)))
    return [indices[round(place)] for place in places]


def view_tiles(
    i: int, runs: Mapping[str, Run], main: str, capture: Capture, lit: Source, metrics: Mapping[str, Any]
) -> ViewTiles:
    """Everything there is to see of view `i`; `main` names the run whose denoised images and depth are shown."""
    name, held_out = capture.names[i], i in capture.cameras.test_indices
    run, tiles = runs[main], list[Tile]()

    def add(key: str, label: str, note: str, image: np.ndarray) -> None:
        tiles.append(Tile(key, label, note, f"{label}, view {name}: {note}", data_uri(image)))

    add("dark", "Dark input", "what the camera delivers, 8-bit sRGB", capture.srgb8(i))
    if run.enhancement is not None:
        noisy = enhanced_dark(capture, i, run.enhancement)
        add("enhanced", "Enhanced", "the dark input made bright, noise included", noisy)
    if (denoised := run.path / "denoised" / f"{name}.png").exists():
        add("denoised", f"Denoised by {main}", "what the scene is fitted to", read_png(denoised))
    renders = {other: made.rendering(name) for other, made in runs.items()}
    for other, image in renders.items():
        note = _render_note(other, name, held_out, metrics)
        add(f"render-{other}", f"Rendered by {other}", note, shown(image, runs[other]))
    truths = {other: references(made, capture, lit, i) for other, made in runs.items()}
    for kind, image in truths[main].items():
        label, note = LONG[kind] if capture.imported and kind in LONG else TRUTHS[kind]
        add(f"truth-{kind}", label, note, encode(image) if kind == "linear" else image)
    for other, image in renders.items():
        if not truths[other]:
            continue
        kind, truth = next(iter(truths[other].items()))
        note = f"distance to the {WORDS[kind]} truth after affine alignment"
        add(f"error-{other}", f"Error of {other}", note, error_map(shown(image, runs[other]), shown(truth, kind=kind)))
    depth_range = _add_depths(add, i, run, main, lit, name)
    return ViewTiles(name, held_out, capture.cameras.rig.width, capture.cameras.rig.height, depth_range, tuple(tiles))


def shown(image: np.ndarray, run: Run | None = None, kind: str = "") -> np.ndarray:
    """A picture for display: linear light as sRGB code."""
    linear = kind == "linear" or (run is not None and run.space == "linear")
    return encode(image) if linear else image


def _render_note(name: str, view: str, held_out: bool, metrics: Mapping[str, Any]) -> str:
    if not held_out:
        return "a training view"
    scores = next(iter(metrics["methods"][name]["views"][view].values()), None)
    if scores is None:
        return "held out; not scored, because no truth is known"
    number = scores.get("aligned_psnr", scores.get("linear_psnr"))
    if number is None:
        return "held out; not scored, because the reference shows nothing"
    return f"held out; {'aligned ' if 'aligned_psnr' in scores else 'linear '}PSNR {number:.1f} dB"


def _add_depths(add: Any, i: int, run: Run, main: str, lit: Source, name: str) -> tuple[float, float] | None:
    depth, alpha = run.depth(name)
    z, seen = depth * run.depth_scale, alpha > 0.5
    if not seen.any():
        return None
    near, far = (float(v) for v in np.percentile(z[seen], (1, 99)))
    add(f"depth-{main}", f"Depth of {main}", f"expected depth, {near:.3g} to {far:.3g}", depth_map(z, seen, near, far))
    true = true_depth(lit, i)
    if true is not None:
        picture = depth_map(true, np.isfinite(true), near, far)
        add("depth-true", "True depth", "of the scene, on the same scale", picture)
    return near, far


def error_map(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean absolute difference over the channels after alignment, magma, black = 0, bright = `ERROR_CEILING`."""
    error = np.abs(affine_aligned(image, truth) - truth).mean(-1)
    return colour_map(error / ERROR_CEILING, "magma")


def depth_map(z: np.ndarray, seen: np.ndarray, near: float, far: float) -> np.ndarray:
    """Depth [h,w] in viridis, near = dark, far = bright; grey where nothing is seen."""
    # A flat scene has near = far; any positive width shows it as one colour.
    coloured = colour_map(np.where(seen, z - near, 0) / max(far - near, 1e-6), "viridis")
    coloured[~seen] = 0.5
    return coloured


def colour_map(values: np.ndarray, name: str) -> np.ndarray:
    """[h,w] in 0..1 (clipped) -> float32 [h,w,3] by a perceptually uniform, colour-blind safe map."""
    return matplotlib.colormaps[name](np.clip(values, 0.0, 1.0))[..., :3].astype(np.float32)


def data_uri(image: np.ndarray) -> str:
    """A float image [h,w,3] in 0..1 as a data URI: PNG while small, JPEG above `PNG_PIXELS`."""
    height, width = image.shape[:2]
    shrink = MAX_SIDE / max(height, width)
    if shrink < 1:
        size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    codes = np.round(np.clip(image, 0.0, 1.0) * 255).astype(np.uint8)[..., ::-1]
    small = codes.shape[0] * codes.shape[1] <= PNG_PIXELS
    kind, options = ("png", []) if small else ("jpeg", [cv2.IMWRITE_JPEG_QUALITY, 92])
    done, data = cv2.imencode(f".{kind}", np.ascontiguousarray(codes), options)
    assert done
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
