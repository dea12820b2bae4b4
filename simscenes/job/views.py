"""The views of a job, one after the other: finished views of an earlier call are kept, the rest are rendered."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, floor, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from simscenes.backend import using_variant
from simscenes.job.accuracy import claimed, noise_limits, summary
from simscenes.job.cost import Stopwatch, predict_seconds
from simscenes.job.finish import ViewStore
from simscenes.job.identity import LEAST, SPENT, VIEW_KEY, finished_view, view_key
from simscenes.loading.load import LoadedScene
from simscenes.render.geometry import geometry_channels
from simscenes.render.radiance import RenderedView, RenderMethod, Tick
from simscenes.render.smooth import smoothed
from simscenes.rigs import Rig
from simscenes.sets.pictures.exr import write_exr
from simscenes.sets.writers.camera_files import is_test_view, write_json
from simscenes.transport.plan import TransportPlan

LIMITS = "noise limits"  # beside the header's entries; not in the file, since it follows from the pixels
# Times fewer samples than another view of the set took for the same error, at which a view is not believed: where few
# paths carry much light, the first estimate of a view's error is small until one of them is found. Views of one
# catalogue scene were seen to need up to six times the samples of another (`cornell`, 64 x 64, to 5 %: 196 and 35).
APART = 16
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class RenderJob:
    """The data that all views of one call share."""

    method: RenderMethod
    plan: TransportPlan
    surfaces: LoadedScene  # in the fewest colours, for the geometry; the scene of `method` may have more
    variant: str  # of `surfaces`
    rig: Rig
    out: Path
    names: list[str]
    config: dict[str, Any]  # everything that the pixels depend on
    digest: str  # of the whole job
    store: ViewStore
    watch: Stopwatch
    progress: Progress
    truth_samples: float = 1.0  # times the samples of other views, in held-out ones
    denoise: bool = False  # training views only: a held-out one is truth, and must be unbiased

    def worth(self, i: int) -> float:
        """How many times the samples of a training view one gets: `truth_samples` if it is held out."""
        return self.truth_samples if is_test_view(i) else 1.0

    def config_of(self, i: int, least: int = 0) -> dict[str, Any]:
        """Everything that the pixels of a view depend on; more samples in it are a smaller target.

        `least`: samples per pixel that the view has at least, on the word of its siblings.
        """
        spp, target, worth = self.config["spp"], self.config["noise_target"], self.worth(i)
        more = ({"denoised": True} if self.is_smoothed(i) else {}) | ({"least_spp": least} if least else {})
        return {**self.config, **more, "spp": None if spp is None else round(spp * worth),
                "noise_target": None if target is None else target / sqrt(worth)}  # fmt: skip

    def key(self, i: int, least: int = 0) -> str:
        """Identity of the pixels of a view."""
        return view_key(self.config_of(i, least), self.rig, i)

    def is_smoothed(self, i: int) -> bool:
        """Whether a view goes through the denoiser of pictures."""
        return self.denoise and not is_test_view(i)


def render_views(job: RenderJob) -> tuple[dict[str, Any], float]:
    """Render the missing views: samples, error and fireflies of every view, and the seconds predicted beforehand."""
    (job.out / "gt").mkdir(parents=True, exist_ok=True)
    paths = [job.out / "gt" / f"{name}.exr" for name in job.names]
    for stale in set((job.out / "gt").glob("[0-9]*.exr")) - set(paths):  # of a larger set; other files are not ours
        stale.unlink()
    headers = [_rendered_before(job, i, path) for i, path in enumerate(paths)]
    missing = [i for i, header in enumerate(headers) if header is None]
    predicted, views = 0.0, {i: RenderedView(job.method, job.rig, i) for i in missing}
    if missing:
        job.progress(len(paths) - len(missing), len(paths), "predicting the time")
        with job.watch.stage("predict"):
            with using_variant(job.method.variant):
                spp, target, worth = job.config["spp"], job.config["noise_target"], sum(map(job.worth, missing))
                predicted = predict_seconds(job.method, job.rig, views, spp, target, worth)
    left = predicted / max(sum(map(job.worth, missing)), 1)  # seconds per view of usual samples
    for done, i in enumerate(missing):

        def tick(part: float, i: int = i, done: int = done, each: float = left) -> None:
            seconds = each * (sum(map(job.worth, missing[done:])) - part * job.worth(i))
            what = f"view {job.names[i]}, {part:.0%}, about {seconds:.0f} s left"
            job.progress(len(paths) - len(missing) + done, len(paths), what)

        tick(0.0)
        headers[i] = _render_view(job, views.pop(i), paths[i], tick)
        write_json(job.out / SPENT, {"digest": job.digest, "seconds": job.watch.with_earlier()})
        # From here on, past views predict better than the pilot did; only radiance and geometry repeat for each view.
        spent = job.watch.seconds["radiance"] + job.watch.seconds["geometry"]
        left = spent / sum(map(job.worth, missing[: done + 1]))
    while again := stopped_early(job, headers):
        for i, least in again.items():
            said = (
                f"view {job.names[i]} again with {least} samples per pixel at least: others needed {APART} times more"
            )
            job.progress(len(paths), len(paths), said)
            view = RenderedView(job.method, job.rig, i)
            headers[i] = _render_view(job, view, paths[i], lambda part: None, least)
    found = {
        name: {"spp": int(h["spp"]), "fireflies": int(h["fireflies"]),
               **claimed(float(h["relativeError"]), h[LIMITS], job.plan)}
        for name, h in zip(job.names, headers, strict=True)
        if h is not None
    }  # fmt: skip
    fireflies = sum(view["fireflies"] for view in found.values())
    rare = f"; {fireflies} fireflies, see set.json" if fireflies else ""
    job.progress(len(paths), len(paths), f"images; {summary(found)}{rare}")
    return found, predicted


def stopped_early(job: RenderJob, headers: Sequence[dict[str, Any] | None]) -> dict[int, int]:
    """Views that another view of the set contradicts, and the samples per pixel that each has to have at least."""
    if job.config["noise_target"] is None:
        return {}
    spent = [int(header["spp"]) / job.worth(i) for i, header in enumerate(headers) if header is not None]
    least = max(spent, default=0.0) / APART
    return {i: ceil(least * job.worth(i)) for i, spp in enumerate(spent) if spp < floor(least)}


def _rendered_before(job: RenderJob, i: int, path: Path) -> dict[str, Any] | None:
    """Header of a view that an earlier call finished, else None; its light and depth go into the store."""
    with job.watch.stage("write"):
        if (found := finished_view(path, lambda least: job.key(i, least))) is None:
            return None
        channels, header = found
        job.store.put(i, channels)
        return header | {LIMITS: noise_limits(channels)}


def _render_view(job: RenderJob, view: RenderedView, path: Path, tick: Tick, least: int = 0) -> dict[str, Any]:
    with job.watch.stage("geometry"), using_variant(job.variant) as mi:
        channels = geometry_channels(mi, job.surfaces, job.rig, view.i)
    with job.watch.stage("radiance"), using_variant(job.method.variant):
        config = job.config_of(view.i)
        radiance = view.render(config["spp"], config["noise_target"], tick, least)
        mean = smoothed(radiance.mean, radiance.variance, channels) if job.is_smoothed(view.i) else radiance.mean
    for k, c in enumerate("RGB"):
        channels[c] = np.maximum(mean[..., k], 0)  # clips spectral light that lies outside the sRGB triangle
        channels[f"var.{c}"] = radiance.variance[..., k]
        channels[f"half.{c}"] = radiance.half[..., k]
    error = float(np.float32(radiance.error))  # as the header keeps it: a resumed render reports the value it reads
    header = {
        "spp": radiance.spp, "relativeError": error, "fireflies": radiance.fireflies,
        VIEW_KEY: job.key(view.i, least), "worldToCamera": job.rig.viewmats[view.i].astype(np.float32),
        **({LEAST: least} if least else {}),
    }  # fmt: skip
    with job.watch.stage("write"):
        write_exr(path, channels, header)
        job.store.put(view.i, channels)
    return header | {LIMITS: noise_limits(channels)}
