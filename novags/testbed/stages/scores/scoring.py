"""Scores of one run against the truth: held-out views in 3D, training pictures in 2D, depth, cameras, consistency."""

from collections.abc import Collection
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from novags.methods.enhancers import ENHANCERS
from novags.methods.problem import encode
from novags.testbed.console.speed import frames_per_second
from novags.testbed.console.terminal import Console, Update
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.exposures import Exposures, as_compared, exposures_of
from novags.testbed.folders.references import LINEAR, missing_references, references, true_depth
from novags.testbed.folders.run import CAMERAS, METRICS, SCENE, Run, open_run
from novags.testbed.folders.set import Source
from novags.testbed.folders.truth_noise import reference_halves
from novags.testbed.ledger.code import Code, code_of
from novags.testbed.ledger.stage import run_stage
from novags.testbed.metrics import missing, modules, networks, protocol_of
from novags.testbed.metrics.consistency import ConsistencyScores, consistency_scores
from novags.testbed.metrics.geometry import GeometryScores, geometry_scores, seen_points, surface_scores
from novags.testbed.metrics.images import aligned_psnr, gaussian_blur, image_scores, mean_scores, psnr
from novags.testbed.metrics.linear import linear_scores
from novags.testbed.metrics.picture import Image
from novags.testbed.metrics.truth import ERROR, WITHIN
from novags.testbed.stages.scores.lengths import held_out_scores
from novags.testbed.stages.scores.noise import noise_scores
from sensor_model.files.lock import locked
from simscenes.sets.geometry.correspondence import flow
from simscenes.sets.pictures.png import read_png
from simscenes.sets.readers.ply_points import read_ply_points

BLUR_SIGMA = 1.2  # px; the fixed bar a denoiser has to clear
BLUR_GRID = tuple(float(s) for s in np.geomspace(0.4, 8.0, 20))  # px; the harder bar: the best of these for the images


def score(run_path: Path, console: Console) -> dict[str, Any]:
    """Score the run at `run_path` against the truth of its capture; returns its metrics.json.

    Raises:
        ValueError: If the run, its capture or its set cannot be read, or they have changed since the run was made.
        BlockingIOError: If another process is writing to the run.
    """
    with locked(run_path, make=False):  # before anything is read: a new reconstruction may be under way
        return _score(run_path, console)


def _score(run_path: Path, console: Console) -> dict[str, Any]:
    run = open_run(run_path)
    if run.lacks is not None:  # scores without it would take the place of the whole ones
        raise ValueError(f"{run_path} cannot be scored: {run.lacks}")
    captured, lit = run.inputs(console)
    lacking = missing(captured.cameras.rig.width, captured.cameras.rig.height)

    def inputs() -> dict[str, str]:
        return {"run": run.digest(), "capture": captured.digest(), "set": lit.digest()}

    def work(_: None) -> dict[str, Any]:
        with console.progress(f"score {run.name}") as progress:
            asked = protocol_of(captured.record.dataset) | networks() - lacking.keys()
            scores = score_test_views(run, captured, lit, asked, progress)
        method = {
            **scores,
            "along": [score_along(then, captured, lit) for then in run.along()],
            **({} if (held := held_out_scores(run, captured)) is None else {"held_out": held}),
            "training_2d": score_training_images(run, captured, lit),
            "noise": noise_scores(run, captured, lit),
            "cameras": run.record.get("cameras"),
            "seconds": stage_seconds(run, captured, lit),
            "peak_bytes": run.peak_bytes,
            "frames_per_second": frames_per_second(run.path / SCENE, run.path / CAMERAS, run.record),
        }
        unavailable = dict(lacking)
        if scores["geometry"] is None:
            unavailable["geometry"] = (
                "the true depth is not known: photographs, or a set scaled down for the capture"
                if run.has_depth
                else "the program gives no depth: the pictures of some test views have no channel Z"
            )
        unavailable |= missing_references(run, captured, lit)
        unavailable |= shows_nothing(scores["views"])
        return {"methods": {run.name: method}, "unavailable": unavailable}

    return run_stage(
        "score", run_path, METRICS, code=code_of_scores(run, captured, lit), inputs=inputs,
        opened={"run": run.digest(), "capture": captured.content, "set": lit.content},
        config={"unavailable": sorted(lacking)}, owns=(METRICS,),
        prepare=lambda: None, work=work, console=console, overwrite=True,  # scores describe what is there now
    )  # fmt: skip


def code_of_scores(run: Run, captured: Capture, lit: Source) -> Code:
    """The code that scores a run: the stage, the enhancement that its references go through, the reader of its set,
    and the camera's effects from outside.
    """
    enhancer = None if run.enhancement is None else ENHANCERS.module_of(run.enhancement["enhancer"])
    return code_of(__name__, enhancer, *modules(), *lit.modules, *captured.modules)


def score_test_views(
    run: Run, capture: Capture, lit: Source, asked: Collection[str], progress: Update
) -> dict[str, Any]:
    """Scores of every held-out view against each of its references, and their means; `asked`: as of `image_scores`.

    Returns:
        `mean` and `views` hold the image scores by reference (None in `mean` for one that is not known); `geometry` the
        scores of depth (None if unknown), with the view consistency.
    """
    views: dict[str, Any] = {}
    depths = dict[str, GeometryScores]()
    indices = capture.cameras.test_indices
    exposures = exposures_of(run, capture, lit) if run.space == "linear" else None
    for done, i in enumerate(indices):
        name = capture.names[i]
        views[name] = view_scores(run, capture, lit, i, exposures, asked)
        if run.has_depth and (truth := true_depth(lit, i)) is not None:
            depth, alpha = run.depth(name)
            depths[name] = geometry_scores(depth * run.depth_scale, alpha, truth)
        progress(done + 1, len(indices), f"view {name}")
    missing: dict[str, Any] = dict.fromkeys(missing_references(run, capture, lit))
    kinds = next(iter(views.values())).keys()
    consistency = view_consistency(run, capture, lit, exposures) if depths else None
    return {
        "mean": missing | {kind: mean_scores([scores[kind] for scores in views.values()]) for kind in kinds},
        "views": views,
        "geometry": {
            **mean_scores([*depths.values()]),
            **surface_of(run, capture, lit),
            "consistency": consistency,
            "views": depths,
        }
        if depths
        else None,
    }


def surface_of(run: Run, capture: Capture, lit: Source) -> dict[str, Any]:
    """Scores of the surface that the rendered views show against a scan; {} without one."""
    if lit.scan is None:
        return {}
    rig = capture.cameras.rig
    shown = list(range(len(capture.names))) if run.shows_training_views else capture.cameras.test_indices
    points = (seen_points(depth * run.depth_scale, alpha, rig.Ks[i], rig.viewmats[i])
              for i in shown for depth, alpha in [run.depth(capture.names[i])])  # fmt: skip
    return dict(surface_scores(points, read_ply_points(lit.scan, most=None).xyz))


def view_scores(
    run: Run, capture: Capture, lit: Source, i: int, exposures: Exposures | None, asked: Collection[str]
) -> dict[str, Any]:
    """Scores of view `i` against each of its references; `exposures`: of a run in linear light."""
    rendered, halves = run.rendering(capture.names[i]), reference_halves(run, capture, lit, i)
    gain = None if exposures is None else exposures.dark
    return {
        kind: linear_scores(rendered, reference, gain, halves.get(kind))
        if kind in LINEAR
        else image_scores(as_compared(rendered, run, capture, kind, exposures), reference, asked, halves.get(kind))
        for kind, reference in references(run, capture, lit, i).items()
    }


def score_along(run: Run, capture: Capture, lit: Source) -> dict[str, Any]:
    """Scores of a run after fewer iterations, `run.at`: without networks, which cost more than they say here."""
    exposures = exposures_of(run, capture, lit) if run.space == "linear" else None
    indices = capture.cameras.test_indices
    views = {capture.names[i]: view_scores(run, capture, lit, i, exposures, ()) for i in indices}
    kinds = next(iter(views.values())).keys()
    means = {kind: mean_scores([scores[kind] for scores in views.values()]) for kind in kinds}
    return {"iterations": run.at, "mean": means, "views": views}


def shows_nothing(views: dict[str, Any]) -> dict[str, str]:
    """Why scores are missing that need a reference with something to see, by the name of the score."""
    found = {}
    for kind in next(iter(views.values())):
        number = "linear_psnr" if kind in LINEAR else "aligned_psnr"
        within = [name for name, scores in views.items() if scores[kind].get(number + ERROR) == inf]
        if within:
            found[f"{number} against {kind}"] = (
                f"{WITHIN} in {len(within)} of {len(views)} views ({within[0]}{', ...' if len(within) > 1 else ''}), "
                "which the mean leaves out: render the held-out views with more samples (--truth-samples)"
            )
        blank = [name for name, scores in views.items() if scores[kind][number] is None and name not in within]
        if blank:
            lost = "linear_psnr" if kind in LINEAR else "aligned scores"
            what = lost if kind == "linear" else f"{lost} against {kind}"
            shows = "black" if kind in LINEAR else "one colour to within 1/255 in every channel"
            found[what] = (
                f"the reference is {shows} in {len(blank)} of {len(views)} views ({blank[0]}"
                f"{', ...' if len(blank) > 1 else ''}), so that a blank picture scores like the truth: "
                "use more light (--electrons)"
            )
    return found


def view_consistency(
    run: Run, capture: Capture, lit: Source, exposures: Exposures | None
) -> dict[str, float | None]:  # fmt: skip
    """Mean colour change along true correspondences from each held-out view to the view after it.

    `exposures`: of a run in linear light. All scores are None for a run whose training views were not rendered, since
    the view after is one of them, and for a scan, which leaves out parts of the views.
    """
    if not run.shows_training_views or lit.scanned:
        return dict.fromkeys(ConsistencyScores.__annotations__)
    found: list[Any] = []
    for i in capture.cameras.test_indices:
        j = i + 1 if i + 1 < len(capture.names) else i - 1
        moved = flow(lit.views, i, j)
        (here, true_here), (there, true_there) = (_in_code(run, capture, lit, k, exposures) for k in (i, j))
        found.append(consistency_scores((here, there), (true_here, true_there), moved.displacement, moved.visible))
    return dict(mean_scores(found))


def _in_code(run: Run, capture: Capture, lit: Source, i: int, exposures: Exposures | None) -> tuple[Image, Image]:
    """View `i` as rendered and its first reference, both as pictures of one exposure."""
    kind, reference = next(iter(references(run, capture, lit, i).items()))
    rendered = run.rendering(capture.names[i])
    if kind not in LINEAR:
        return as_compared(rendered, run, capture, kind, exposures), reference
    gain = 1.0 if exposures is None or exposures.dark is None else exposures.dark
    return encode(gain * rendered), encode(reference)


def score_training_images(run: Run, capture: Capture, lit: Source) -> dict[str, Any] | None:
    """2D scores of the training pictures against the enhanced noise-free exposure, beside Gaussian blurs.

    Returns:
        `enhanced`, `denoised` (only if the method denoises), `blur` (sigma 1.2 px) and `best_blur` (the sigma of
        `BLUR_GRID` that suits these images best), each with mean `psnr` and `aligned_psnr`; blurs also with `sigma`.
        Where no reference has contrast, `aligned_psnr` is None and `best_blur` is left out. None for a method that
        enhances no pictures, and where the noise-free exposure is not known.
    """
    if run.enhancement is None or not (run.path / "enhanced").is_dir() or not capture.holds("truth"):
        return None
    enhanced, denoised, truth = [], [], []
    for i in capture.cameras.train_indices:
        name = capture.names[i]
        if not (run.path / "enhanced" / f"{name}.png").exists():
            continue  # a view without a camera
        enhanced.append(read_png(run.path / "enhanced" / f"{name}.png"))
        if (run.path / "denoised").is_dir():
            denoised.append(read_png(run.path / "denoised" / f"{name}.png"))
        truth.append(references(run, capture, lit, i)["enhanced"])
    scores = {"enhanced": _mean_psnr(enhanced, truth)}
    if denoised:
        scores["denoised"] = _mean_psnr(denoised, truth)
    blurs = {sigma: _blur_scores(enhanced, truth, sigma) for sigma in (BLUR_SIGMA, *BLUR_GRID)}
    if scores["enhanced"]["aligned_psnr"] is None:
        return {**scores, "blur": blurs[BLUR_SIGMA]}
    best = max(blurs, key=lambda sigma: blurs[sigma]["aligned_psnr"])
    return {**scores, "blur": blurs[BLUR_SIGMA], "best_blur": blurs[best]}


def _mean_psnr(images: list[Image], references: list[Image]) -> dict[str, Any]:
    pairs = list(zip(images, references, strict=True))
    return mean_scores([{"psnr": psnr(*pair), "aligned_psnr": aligned_psnr(*pair)} for pair in pairs])


def _blur_scores(images: list[Image], references: list[Image], sigma: float) -> dict[str, Any]:
    return {**_mean_psnr([gaussian_blur(image, sigma) for image in images], references), "sigma": sigma}


def stage_seconds(run: Run, captured: Capture, lit: Source) -> dict[str, float]:
    """Seconds of every stage that led to the run, and of the parts of its reconstruction."""
    made = lit.views.meta.get("stage")  # a render, or the poses of photographs
    seconds = {} if made is None else {str(made.get("name", "render")): float(made["seconds"])}
    seconds["import" if captured.imported else "capture"] = float(captured.record.stage["seconds"])
    seconds["reconstruct"] = float(run.record["stage"]["seconds"])
    return {**seconds, **{f"reconstruct/{part}": float(s) for part, s in run.record["seconds"].items()}}
