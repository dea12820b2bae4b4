"""A rendering job: every view of a rig into a set folder, resumable view by view."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from sensor_model.files.lock import locked
from sensor_model.plan import Plan
from simscenes.backend import backend_of, using_variant
from simscenes.job.accuracy import noise_target, warnings_about
from simscenes.job.cost import Stopwatch, peak_bytes, versions
from simscenes.job.finish import finish_set, view_store
from simscenes.job.identity import (
    SPENT,
    is_complete,
    job_digest,
    plan_identity,
    seconds_spent,
    without_nan,
)
from simscenes.job.views import Progress, RenderJob, render_views
from simscenes.loading.checks.physical import offset_warning
from simscenes.loading.load import LoadedScene, build_in_fewest_colors, build_scene, set_light_weights
from simscenes.loading.reference import SceneLike, SceneRef
from simscenes.optics import Optics
from simscenes.render.fitting import usual_rig
from simscenes.render.framing import with_lens
from simscenes.render.geometry import check_cameras
from simscenes.render.radiance import RenderMethod
from simscenes.render.smooth import missing
from simscenes.rigs import Rig
from simscenes.sets.multiview import MultiviewSet, load_set
from simscenes.sets.names import numbered
from simscenes.sets.writers.camera_files import write_json
from simscenes.sets.writers.layouts import EXPORTS
from simscenes.sets.writers.neighbours import DEPTHS
from simscenes.transport.plan import APERTURE, MOTION, TransportPlan
from simscenes.transport.planner import default_plan, plan_loaded

DEFAULT_SPP = 256
FORMAT = 6  # of the folder; sets of another format are rendered again
MOST_TRUTH = 1024  # times the samples
# Samples in a job, at 1.5 to 3 microseconds of processor time each: some ten minutes. The planner's slower
# measurements, up to a minute, are a tenth of that.
MEASURE_FROM = 3 * 10**8
ERROR_SEEN = (
    "relative_error estimates the noise from two independent halves of the samples; half.R/G/B is half their "
    "difference, var.R/G/B its square over 3 x 3 pixels, 9 degrees of freedom. noise_by_brightness is the noise at "
    "most, of each quarter of the pixels, darkest first; error and error_by_brightness add the light left out by the "
    "plan, at most (left_out: the whole picture, then its quarters). None sees a caustic that no sample found, nor "
    "spectra that RGB stands for; see plan."
)


def render_set(
    scene: SceneLike | SceneRef,
    rig: Rig | None,
    out: str | Path,
    *,
    spp: int | None = None,
    target_error: float | None = None,
    truth_samples: float = 1.0,
    denoise: bool = False,
    plan: str | Plan = "auto",
    optics: Optics | None = None,
    variant: str = "auto",
    seed: int = 0,
    allow_outside: bool = False,
    export: Sequence[str] = (),
    progress: Progress | None = None,
) -> MultiviewSet:
    """Render a scene into a set folder: radiance with variance, geometry, 8-bit images, cameras, sparse points.

    A folder that already holds the same set is returned unchanged; an interrupted render continues with the views that
    are missing.

    Args:
        scene: Name from `SCENES` ("tabletop", or "tabletop:3" for its variation 3), a Mitsuba scene dict, or the path
            of a Mitsuba XML file.
        rig: Cameras; None for 32 views: of the scene's default rig at 128 x 128, or around a foreign scene's sensor.
        out: Folder to write.
        spp: Samples per pixel, rounded up to whole passes; 256 if neither this nor `target_error`.
        target_error: Relative RMSE (noise and omitted light, over mean radiance) at which each view stops; its samples
            then go where a short pilot saw noise, instead of evenly over all pixels.
        truth_samples: Times these samples in held-out views (every 8th), which are the truth that others are judged
            by; of a target error, a target smaller by the root of it.
        denoise: Smooth training views, for previews; held-out ones stay as rendered. The error that is recorded is the
            one before. Needs the extra `denoise`.
        plan: A plan from `plan_transport`; "auto" to make one, measuring everything if the job is long; or "rgb" for
            plain path tracing to depth 64 without a plan.
        optics: Aperture, motion and colour filters; None for the lens of the scene's own sensor, at rest and seeing
            linear sRGB.
        variant: Mitsuba variant, see `choose_variant`; only its backend counts, since the plan decides on the colours.
        seed: Of the Monte Carlo noise; each view's noise depends on it and on the camera, not on the view's place.
        allow_outside: Let an XML scene read files outside its folder.
        export: Further layouts to write, each into the folder of its name inside `out`: "blender", "llff".
        progress: Called with (views done, total views, the current activity with the time left).

    Raises:
        ValueError: If an argument is out of range, the scene cannot be loaded, a camera is inside an object, or the
            scene renders to impossible radiance.
        BlockingIOError: If another process is writing to `out`.
    """
    _check_quality(spp, target_error, truth_samples)
    if denoise and (why := missing()) is not None:
        raise ValueError(f"render_set: denoise: {why}")
    if unknown := set(export) - set(EXPORTS):
        raise ValueError(f"render_set: export must name layouts of {sorted(EXPORTS)}, got {sorted(unknown)}")
    report = progress or (lambda done, total, what: None)
    watch, out, source = Stopwatch(), Path(out), SceneRef.of(scene)
    with locked(out, ("gt", "images", "sparse", DEPTHS, *EXPORTS)):
        variant = backend_of(variant)
        with watch.stage("load"):
            loaded = build_in_fewest_colors(source, variant, allow_outside=allow_outside)
        with watch.stage("load"), using_variant(loaded.variant) as mi:
            optics = with_lens(optics, loaded, mi)
            if rig is None:
                rig = usual_rig(source, loaded, 32, 128, 128)
        config = {
            "format": FORMAT, "scene": loaded.name,
            "scene_digest": loaded.digest, "seed": seed, "optics": asdict(optics),
            "spp": spp if spp is not None or target_error is not None else DEFAULT_SPP, "target_error": target_error,
            "plan": plan_identity(plan), "variant": variant,
        }  # fmt: skip
        names = numbered(len(rig))
        # Named where it is asked for, so that sets without it keep their digests.
        whole = {**config, "truth_samples": truth_samples, **({"denoise": True} if denoise else {})}
        digest = job_digest(whole, rig)
        if is_complete(out, digest, names):
            (out / SPENT).unlink(missing_ok=True)  # of a process that was killed before its very last step
            return _exported(load_set(out), export)
        with watch.stage("load"), using_variant(loaded.variant) as mi:
            check_cameras(mi, loaded, rig)  # before anything takes time
            for layout in export:
                EXPORTS[layout].check(rig)
        with watch.stage("plan"):
            report(0, len(names), "planning the light transport")
            samples = len(rig) * rig.width * rig.height * (spp or DEFAULT_SPP)
            wishes = {
                "variant": variant,
                "seed": seed,
                "measure": samples >= MEASURE_FROM,
                "allow_outside": allow_outside,
            }
            made = _make_plan(source, loaded, rig, optics, plan, wishes)
            for line in (*warnings_about(made, target_error), *offset_warning(loaded.scene, loaded.extent)):
                warnings.warn(line, stacklevel=2)
            method = _method(source, loaded, variant, made, optics, seed, allow_outside)
        pixels = {
            **config, "integrator": made.integrator(), "color": made.color, "lights": made.light_weights,
            "lens": method.optics.aperture_radius, "subframes": method.subframes,
            "noise_target": None if target_error is None else noise_target(target_error, made),
        }  # fmt: skip
        (out / "set.json").unlink(missing_ok=True)
        watch.earlier = seconds_spent(out, digest)
        with view_store(out, rig, optics.camera) as store:
            job = RenderJob(method, made, loaded, loaded.variant, rig, out, names, pixels, digest, store, watch, report,
                            truth_samples, denoise)  # fmt: skip
            views, predicted = render_views(job)
            with watch.stage("write"):
                finished = finish_set(out, names, rig, seed, store, loaded.name)
        found = {**finished, "views": views, "predicted_seconds": predicted}
        write_json(out / "set.json", without_nan({**whole, "digest": digest, **_facts(job, made), **found}))
        (out / SPENT).unlink(missing_ok=True)
        return _exported(load_set(out), export)


def _facts(job: RenderJob, made: TransportPlan) -> dict[str, Any]:
    """Entries of set.json besides the configuration and the results of the views."""
    surfaces, rig = job.surfaces, job.rig
    return {
        "kind": "rendered", "n_views": len(rig), "width": rig.width, "height": rig.height,
        "plan": made.to_dict(), "left_out": made.bias, "integrator": made.integrator(),
        "mitsuba_variant": job.method.variant, "demands": surfaces.demand,
        "error_seen": ERROR_SEEN, "shapes": list(surfaces.shapes), "materials": list(surfaces.materials),
        "seconds": job.watch.with_earlier(), "peak_bytes": peak_bytes(), "versions": versions(),
    }  # fmt: skip


def _exported(views: MultiviewSet, layouts: Sequence[str]) -> MultiviewSet:
    for layout in layouts:
        EXPORTS[layout].write(views, views.path / layout)
    return views


def _check_quality(spp: int | None, target_error: float | None, truth_samples: float) -> None:
    if spp is not None and target_error is not None:
        raise ValueError("render_set: give spp or target_error, not both")
    if spp is not None and spp < 2:
        raise ValueError(f"render_set: spp must be >= 2, because the variance needs two halves, got {spp}")
    if target_error is not None and not 0 < target_error < 1:
        raise ValueError(f"render_set: target_error is a relative RMSE and must lie in (0, 1), got {target_error}")
    if not 1 <= truth_samples <= MOST_TRUTH:
        raise ValueError(f"render_set: truth_samples must be 1 to {MOST_TRUTH}, got {truth_samples}")


def _make_plan(
    source: SceneRef, loaded: LoadedScene, rig: Rig, optics: Optics, plan: str | Plan, wishes: dict[str, Any]
) -> TransportPlan:
    if plan == "auto":
        return plan_loaded(source, loaded, rig=rig, optics=optics, **wishes)
    if plan == "rgb":
        return default_plan(optics, loaded.integrator)
    if isinstance(plan, TransportPlan):
        return plan
    raise ValueError(f"plan must be 'auto', 'rgb' or a plan from plan_transport, got {plan!r}")


def _method(
    source: SceneRef,
    loaded: LoadedScene,
    variant: str,
    made: TransportPlan,
    optics: Optics,
    seed: int,
    allow_outside: bool,
) -> RenderMethod:
    """The scene in the variant the plan calls for, with the plan's lights, integrator and lens."""
    if not made.is_on(APERTURE):
        optics = replace(optics, aperture_radius=None, focus_distance=None)
    frames = made.subframes if made.is_on(MOTION) else 1
    with using_variant(variant, made.color) as mi:
        colored = loaded if made.color == loaded.color else build_scene(source, mi, allow_outside=allow_outside)
        set_light_weights(colored, made.light_weights, mi)
        return RenderMethod(mi, mi.variant(), colored, mi.load_dict(made.integrator()), optics, frames, seed)
