"""A rendering job: every view of a rig into a set folder, resumable view by view."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import resource
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.backend import activate
from simscenes.exr import read_exr, write_exr
from simscenes.layout import write_cameras, write_json
from simscenes.multiview import MultiviewSet, encode_srgb, load_set
from simscenes.render.geometry import geometry_channels
from simscenes.render.radiance import render_radiance
from simscenes.render.source import LoadedScene, build_scene
from simscenes.render.sparse import surface_points
from simscenes.rigs import Rig
from simscenes.scenes import default_rig

DEFAULT_SPP = 256
FORMAT = 1  # of the folder; a change renders again
_KEY = "novagsKey"

Progress = Callable[[int, int, str], None]


class Stopwatch:
    """Seconds per named stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Any:
        """Add the time spent inside to one stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def render_set(
    scene: str | dict[str, Any] | Path,
    rig: Rig | None,
    out: str | Path,
    *,
    spp: int | None = None,
    target_error: float | None = None,
    plan: str = "auto",
    variant: str = "auto",
    seed: int = 0,
    progress: Progress | None = None,
) -> MultiviewSet:
    """Render a scene into a set folder: radiance with variance, geometry, 8-bit images, cameras, sparse points.

    A folder that already holds the same set is returned as it is; an interrupted render goes on with the views that
    are missing.

    Args:
        scene: Name from `SCENES` ("tabletop", or "tabletop:3" for its variation 3) or a Mitsuba scene dict.
        rig: Cameras; None for the scene's default rig of 32 views at 128 x 128.
        out: Folder to write.
        spp: Samples per pixel, rounded up to what the sampler can lay out; 256 if neither this nor `target_error`.
        target_error: Relative RMSE (root mean variance over mean radiance) at which each view stops.
        plan: "auto", or a transport to force.
        variant: Mitsuba variant, see `choose_variant`.
        seed: Of the Monte Carlo noise; each view's noise depends on it and on the camera, not on the view's place.
        progress: Called with (views done, views in all, what is going on).

    Raises:
        ValueError: If an argument is out of range, the scene cannot be loaded, or it renders to impossible radiance.
    """
    _check_quality(spp, target_error)
    if rig is None:
        if not isinstance(scene, str):
            raise ValueError("render_set: rig may be None only for a scene from the catalogue; give the cameras")
        rig = default_rig(scene, 32, 128, 128)
    out, watch = Path(out), Stopwatch()
    with watch.stage("load"):
        mi = activate(variant)
        loaded = build_scene(scene, mi)
    settings = {"max_depth": 8, "rr_depth": 2}
    config = {
        "format": FORMAT, "scene": loaded.name, "scene_digest": loaded.digest, "seed": seed, "variant": mi.variant(),
        "spp": spp if spp is not None or target_error is not None else DEFAULT_SPP, "target_error": target_error,
        "integrator": {"type": "path", **settings},
    }  # fmt: skip
    names = [f"{i:04d}" for i in range(len(rig))]
    digest = _digest(config, rig)
    if _is_complete(out, digest, names):
        return load_set(out)
    (out / "set.json").unlink(missing_ok=True)
    spent = _render_views(mi, loaded, rig, out, names, config, watch, progress)
    with watch.stage("write"):
        scale, points = _finish_images(out, names, rig, seed)
        write_cameras(out, names, rig, points=points)
    meta = {
        **config, "digest": digest, "kind": "rendered", "n_views": len(rig), "width": rig.width, "height": rig.height,
        "exposure_scale": scale, "views": spent, "shapes": list(loaded.shapes), "materials": list(loaded.materials),
        "seconds": watch.seconds, "peak_bytes": _peak_bytes(), "versions": _versions(),
    }  # fmt: skip
    write_json(out / "set.json", meta)
    return load_set(out)


def _check_quality(spp: int | None, target_error: float | None) -> None:
    if spp is not None and target_error is not None:
        raise ValueError("render_set: give spp or target_error, not both")
    if spp is not None and spp < 2:
        raise ValueError(f"render_set: spp must be >= 2, because the variance needs two halves, got {spp}")
    if target_error is not None and not 0 < target_error < 1:
        raise ValueError(
            f"render_set: target_error is a relative RMSE and must lie between 0 and 1, got {target_error}"
        )


def _digest(config: dict[str, Any], rig: Rig) -> str:
    text = json.dumps([config, rig.width, rig.height], sort_keys=True).encode()
    return hashlib.sha256(text + rig.viewmats.tobytes() + rig.Ks.tobytes()).hexdigest()


def _view_key(config: dict[str, Any], rig: Rig, i: int) -> str:
    view = Rig(viewmats=rig.viewmats[i : i + 1], Ks=rig.Ks[i : i + 1], width=rig.width, height=rig.height)
    return _digest(config, view)


def _is_complete(out: Path, digest: str, names: list[str]) -> bool:
    try:
        same = json.loads((out / "set.json").read_text(encoding="utf-8")).get("digest") == digest
    except (OSError, ValueError, AttributeError):
        return False
    files = [out / "gt" / f"{n}.exr" for n in names] + [out / "images" / f"{n}.png" for n in names]
    return same and all(f.is_file() for f in files)


def _render_views(
    mi: Any,
    loaded: LoadedScene,
    rig: Rig,
    out: Path,
    names: list[str],
    config: dict[str, Any],
    watch: Stopwatch,
    progress: Progress | None,
) -> dict[str, Any]:
    """Render what is missing; samples and relative error of every view."""
    (out / "gt").mkdir(parents=True, exist_ok=True)
    for stale in set((out / "gt").glob("*.exr")) - {out / "gt" / f"{n}.exr" for n in names}:
        stale.unlink()
    integrator = mi.load_dict(config["integrator"])
    extent = float(np.linalg.norm(np.array(loaded.scene.bbox().extents())))
    spent: dict[str, Any] = {}
    for i, name in enumerate(names):
        if progress:
            progress(i, len(names), f"view {name}")
        path, key = out / "gt" / f"{name}.exr", _view_key(config, rig, i)
        header = _finished_header(path, key)
        if header is None:
            with watch.stage("radiance"):
                radiance = render_radiance(
                    mi, loaded.scene, integrator, rig, i,
                    extent=extent, seed=config["seed"], spp=config["spp"], target_error=config["target_error"],
                )  # fmt: skip
            with watch.stage("geometry"):
                channels = geometry_channels(mi, loaded, rig, i)
            for k, c in enumerate("RGB"):
                channels[c], channels[f"var.{c}"] = radiance.mean[..., k], radiance.variance[..., k]
            header = {"spp": radiance.spp, "relativeError": radiance.error, _KEY: key,
                      "worldToCamera": rig.viewmats[i].astype(np.float32)}  # fmt: skip
            with watch.stage("write"):
                write_exr(path, channels, header)
        spent[name] = {"spp": int(header["spp"]), "relative_error": float(header["relativeError"])}
    if progress:
        progress(len(names), len(names), "images")
    return spent


def _finished_header(path: Path, key: str) -> dict[str, Any] | None:
    """Header of a view that was rendered before with the same settings, else None."""
    if not path.is_file():
        return None
    try:
        header = read_exr(path)[1]
    except ValueError:
        return None  # cut short by a crash of the machine: rendered again
    return header if header.get(_KEY) == key else None


def _finish_images(out: Path, names: list[str], rig: Rig, seed: int) -> tuple[float, Any]:
    """Write the 8-bit images with one exposure for the whole set, and draw the sparse points."""
    import cv2

    (out / "images").mkdir(exist_ok=True)
    radiance, depths = [], []
    for name in names:
        channels, _ = read_exr(out / "gt" / f"{name}.exr")
        radiance.append(np.stack([channels[c] for c in "RGB"], -1))
        depths.append(channels["Z"])
    scale = exposure_scale(radiance)
    images = [encode_srgb(r * np.float32(scale)) for r in radiance]
    for name, image in zip(names, images, strict=True):
        temporary = out / "images" / f".{name}.{os.getpid()}.tmp.png"
        if not cv2.imwrite(str(temporary), np.ascontiguousarray(image[..., ::-1])):
            raise OSError(f"render_set: cannot write {temporary}")
        os.replace(temporary, out / "images" / f"{name}.png")
    return scale, surface_points(rig, depths, lambda i: images[i], seed=seed)


def exposure_scale(radiance: list[NDArray[np.float32]]) -> float:
    """One exposure for the set: 97 % of all pixels stay below white, so a lamp in view does not darken the room."""
    white = float(np.quantile(np.concatenate([r.max(-1).ravel() for r in radiance]), 0.97))
    return 1.0 / white if white > 0 else 1.0


def _peak_bytes() -> int:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else 1024 * peak)


def _versions() -> dict[str, str]:
    return {p: importlib.metadata.version(p) for p in ("mitsuba", "drjit", "numpy")} | {
        "python": sys.version.split()[0]
    }
