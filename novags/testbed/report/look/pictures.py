"""The pictures of a report: for a few views, everything from the dark exposure to the maps of error, depth, normals."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from novags.methods.problem import encode
from novags.testbed.folders.references import LINEAR, enhanced_dark, pictured, references, true_depth
from novags.testbed.folders.run import Run
from novags.testbed.report.look.album import Album, Picture, Script
from novags.testbed.report.look.maps import depth_map, error_map, normal_map, normals_of_depth
from novags.testbed.report.look.probe import probe_of
from novags.testbed.report.place import Place
from novags.testbed.report.verdict import leading
from simscenes.sets.pictures.png import read_png

TRUTHS = {
    "enhanced": ("Truth: noise-free", "the same exposure without noise, enhanced alike"),
    "enhanced_demosaiced": ("Truth: demosaiced", "the noise-free mosaic, interpolated and enhanced alike"),
    "linear": ("Truth: dark", "the same exposure without noise, not enhanced"),
    "linear_demosaiced": ("Truth: dark, demosaiced", "the noise-free mosaic, interpolated, not enhanced"),
    "lit": ("Truth: well lit", "the scene in good light"),
}
LONG = {  # of imported photographs
    "enhanced": ("Truth: long exposure", "brought to the light of the dark one, enhanced alike"),
    "linear": ("Truth: dark long exposure", "brought to the light of the dark one, not enhanced"),
}
COLUMNS = ("render", "error", "depth", "normal")  # of the pictures of every method, side by side
PSNRS = {"aligned_psnr": "aligned", "linear_psnr": "linear", "tone_aligned_psnr": "tone-aligned"}
WORDS = {"enhanced": "noise-free", "linear": "noise-free", "lit": "well-lit"}


@dataclass(frozen=True)
class Tile:
    """One picture with its caption."""

    key: str
    label: str
    note: str
    alt: str
    picture: Picture

    @property
    def caption(self) -> str:
        """What is to be read below it, beside the words of its row and its column."""
        kind = self.key.partition("-")[0]
        return self.note if kind == "render" else "" if kind in COLUMNS else self.label.rpartition(": ")[2]


@dataclass(frozen=True)
class ViewTiles:
    """All pictures of one view, and the known values of its pixels."""

    name: str  # of the view
    held_out: bool  # whether no method was shown it
    width: int  # of the camera, pixels
    height: int  # of the camera, pixels
    tiles: tuple[Tile, ...]  # its pictures
    probe: dict[str, Any] | None = None  # the header of its pixels' numbers; None without raw frames
    data: Script | None = None  # these numbers

    @property
    def rows(self) -> list[tuple[str, list[Tile | None]]]:
        """The pictures in rows: the camera's, those of each method in the order of `COLUMNS`, and the truth's."""
        known = {tile.key: tile for tile in self.tiles}
        names = [key.partition("-")[2] for key in known if key.startswith("render-")]
        of = {name: [known.get(f"{column}-{name}") for column in COLUMNS] for name in names}
        true = next((tile for key, tile in known.items() if key.startswith("truth-")), None)
        truth = [true, None, known.get("depth-true"), known.get("normal-true")]
        shown = {tile.key for row in (*of.values(), truth) for tile in row if tile}
        rest = dict[str, list[Tile | None]]()
        for tile in self.tiles:
            kind, _, name = tile.key.partition("-")
            if tile.key not in shown:
                row = "Other truths" if kind == "truth" else f"{name}, as light" if name else "Camera"
                rest.setdefault(row, []).append(tile)
        camera = rest.pop("Camera", [])
        return [row for row in (("Camera", camera), *of.items(), ("Truth", truth), *rest.items()) if any(row[1])]


@dataclass
class _Tiles:
    """Tiles of one view in the making."""

    album: Album
    view: str
    made: list[Tile] = field(default_factory=list)

    def add(self, key: str, label: str, note: str, image: np.ndarray) -> None:
        picture = self.album.add(image, exact=key.partition("-")[0] not in COLUMNS[1:])  # nobody reads codes of maps
        told = f"Rendered by {label}" if key.startswith("render-") else label
        self.made.append(Tile(key, label, note, f"{told}, {self.view}: {note}", picture))


def view_tiles(i: int, place: Place, album: Album, called: str = "") -> ViewTiles:
    """Everything there is to see of view `i`; its pictures go into `album`.

    The denoised images belong to the main run, whose depth sets the scale of all. `called`: which place it is, on a
    page that shows several.
    """
    capture, runs, main = place.capture, place.runs, place.main
    name, held_out = capture.names[i], i in capture.cameras.test_indices
    title = f"{called}, view {name}" if called else name
    run, tiles = runs[main], _Tiles(album, title if called else f"view {name}")
    evened = ", brought to the exposure and white balance of all" if capture.record.uneven.exposures else ""
    if capture.is_dark(i):
        tiles.add("dark", "Dark input", f"what the camera delivers, 8-bit sRGB{evened}", capture.srgb8(i))
    if capture.is_dark(i) and run.enhancement is not None:
        noisy = enhanced_dark(capture, i, run.enhancement)
        tiles.add("enhanced", "Enhanced", "the dark input made bright, noise included", noisy)
    if (denoised := run.path / "denoised" / f"{name}.png").exists():
        tiles.add("denoised", f"{main}: denoised", "what the scene is fitted to", read_png(denoised))
    shown = {other: each for other, each in runs.items() if held_out or each.shows(name)}
    _add_renders(tiles, i, place, shown, held_out)
    _add_geometry(tiles, i, place, shown)
    width, height = capture.cameras.rig.width, capture.cameras.rig.height
    if (probe := probe_of(capture, i)) is None:
        return ViewTiles(title, held_out, width, height, tuple(tiles.made))
    data = album.add_data(f"probe-{title}", probe.data)
    return ViewTiles(title, held_out, width, height, tuple(tiles.made), probe.header, data)


def _add_renders(tiles: _Tiles, i: int, place: Place, runs: Mapping[str, Run], held_out: bool) -> None:
    """The render of each of these runs, its reference, and the difference."""
    capture, name, shows = place.capture, place.capture.names[i], dict[str, np.ndarray]()
    light = {other: run.rendering(name) for other, run in runs.items()}
    for other, run in runs.items():
        shows[other] = pictured(run, capture, light[other])
        note = render_note(place, other, name) if held_out else "training view"
        tiles.add(f"render-{other}", other, note, shows[other])
    for other, exposures in ((other, found) for other, found in place.exposures.items() if other in runs):
        of = {"dark": (exposures.dark, "dark input"), "lit": (exposures.lit, "well-lit truth")}
        for kind, (gain, what) in of.items():
            if gain is not None:
                note = f"its linear light at the exposure of the {what}, not enhanced"
                label = f"{other}: {'dark' if kind == 'dark' else 'well lit'}"
                tiles.add(f"{kind}-{other}", label, note, encode(gain * light[other]))
    truths = {other: references(run, capture, place.lit, i) for other, run in place.runs.items()}
    for kind, image in truths[place.main].items():
        label, note = LONG[kind] if capture.imported and kind in LONG else TRUTHS[kind]
        tiles.add(f"truth-{kind}", label, note, shown(image, kind))
    for other, image in shows.items():
        if truths[other]:
            _add_error(tiles, other, image, truths[other])


def shown(image: np.ndarray, kind: str) -> np.ndarray:
    """A reference for display: linear light as sRGB code."""
    return encode(image) if kind in LINEAR else image


def render_note(place: Place, name: str, view: str) -> str:
    """What the caption of a render of a held-out view says: its score by which the runs of the place compare."""
    scores = place.metrics["methods"][name]["views"].get(view)
    if not scores:
        return "not scored, because no truth is known"
    kind, main, _ = leading(place) or (next(iter(scores)), "aligned_psnr", "")
    own = scores.get(kind) or next(iter(scores.values()))
    key = next((key for key in (main, *PSNRS) if own.get(key) is not None), None)
    return "not scored, because the reference shows nothing" if key is None else f"{PSNRS[key]} PSNR {own[key]:.1f} dB"


def _add_error(tiles: _Tiles, name: str, image: np.ndarray, truths: Mapping[str, np.ndarray]) -> None:
    kind, truth = next(iter(truths.items()))
    note = f"distance to the {WORDS[kind]} truth after affine alignment"
    tiles.add(f"error-{name}", f"{name}: error", note, error_map(image, shown(truth, kind)))


def _add_geometry(tiles: _Tiles, i: int, place: Place, runs: Mapping[str, Run]) -> None:
    """Depth and normals of each of these runs and of the truth, all depths on the scale of the main run's."""
    capture, lit, found = place.capture, place.lit, dict[str, tuple[np.ndarray, np.ndarray]]()
    geometry = None if lit.scaled else lit.views.geometry(i)
    for name, run in runs.items():
        depth, alpha = run.depth(capture.names[i])
        if (alpha > 0.5).any():
            found[name] = (depth * run.depth_scale, alpha > 0.5)
    if (truth := true_depth(lit, i)) is not None:
        found[""] = (truth, np.isfinite(truth) & (truth > 0))
    scale = next((found[name] for name in (place.main, "", *found) if name in found and found[name][1].any()), None)
    if scale is None:
        return
    near, far = (float(v) for v in np.percentile(scale[0][scale[1]], (1, 99)))
    for name, (z, seen) in found.items():
        picture = depth_map(z, seen, near, far)
        if name:
            tiles.add(f"depth-{name}", f"{name}: depth", f"depth, {near:.3g} to {far:.3g}", picture)
        else:
            tiles.add("depth-true", "Truth: depth", "of the scene, on the same scale", picture)
    rig = capture.cameras.rig
    for name, (z, seen) in found.items():
        if name or geometry is None:
            normals = normals_of_depth(np.where(seen, z, 0.0), np.asarray(rig.Ks[i], np.float64))
            note = "of the surface that its depth makes"
            label = f"{name}: normals" if name else "Truth: normals"
            tiles.add(f"normal-{name or 'true'}", label, note, normal_map(normals, seen))
        else:
            turned = geometry["geometric_normals"] @ np.asarray(rig.viewmats[i], np.float64)[:3, :3].T
            tiles.add("normal-true", "Truth: normals", "of the scene, camera axes", normal_map(turned, seen))
