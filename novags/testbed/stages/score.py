"""Scores of one run against the truth: held-out views in 3D, training images in 2D.

Two references, never mixed. `enhanced` is the noise-free dark exposure put through the enhancement of its noisy twin
(same gamma, same epsilon): what a method would show if noise were all it had to fight, so it isolates noise. `lit` is
the well-lit render or the photograph itself: what the field reports, dominated by differences of tone.
"""

from typing import Any

import numpy as np
import torch

from novags.methods.enhancers.guided import enhance
from novags.testbed.console import Update
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.png import read_png
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source
from novags.testbed.metrics import (
    Image,
    PerceptualDistance,
    affine_aligned,
    gaussian_blur,
    image_scores,
    mean_scores,
    psnr,
)

BLUR_SIGMA = 1.2  # px; the fixed bar a denoiser has to clear
BLUR_GRID = tuple(float(s) for s in np.geomspace(0.4, 8.0, 20))  # px; the harder bar: the best of these for the images


def enhanced_pair(run: Run, capture: Capture, i: int) -> tuple[Image, Image]:
    """The dark exposure of view `i` as the run enhanced it, and its noise-free twin through the same enhancement."""
    dark = torch.from_numpy(capture.dark(i, run.dark_source))
    noisy, params = enhance(dark, run.enhance_config)
    return noisy.numpy(), enhance(torch.from_numpy(capture.clean(i)), run.enhance_config, params)[0].numpy()


def score_test_views(
    run: Run, capture: Capture, lit: Source, lpips: PerceptualDistance | None, progress: Update
) -> dict[str, Any]:
    """Scores of every held-out view against both references, and their means: `{"mean": ..., "views": ...}`."""
    views: dict[str, Any] = {}
    indices = capture.cameras.test_indices
    for done, i in enumerate(indices):
        name = capture.names[i]
        rendered = read_png(run.path / "renders" / f"{name}.png")
        _, reference = enhanced_pair(run, capture, i)
        views[name] = {
            "enhanced": image_scores(rendered, reference, lpips),
            "lit": image_scores(rendered, lit.lit(i), lpips),
        }
        progress(done + 1, len(indices), f"view {name}")
    mean = {kind: mean_scores([scores[kind] for scores in views.values()]) for kind in ("enhanced", "lit")}
    return {"mean": mean, "views": views}


def score_training_images(run: Run, capture: Capture) -> dict[str, Any]:
    """2D scores of the training images against the enhanced noise-free exposure, beside Gaussian blurs.

    Returns:
        `enhanced`, `denoised` (only if the method denoises), `blur` (sigma 1.2 px) and `best_blur` (the sigma of
        `BLUR_GRID` that suits these very images), each with mean `psnr` and `aligned_psnr`; blurs also with `sigma`.
    """
    enhanced, denoised, references = [], [], []
    for i in capture.cameras.train_indices:
        name = capture.names[i]
        enhanced.append(read_png(run.path / "enhanced" / f"{name}.png"))
        if (run.path / "denoised").is_dir():
            denoised.append(read_png(run.path / "denoised" / f"{name}.png"))
        references.append(enhanced_pair(run, capture, i)[1])
    scores = {"enhanced": _mean_psnr(enhanced, references)}
    if denoised:
        scores["denoised"] = _mean_psnr(denoised, references)
    blurs = {sigma: _blur_scores(enhanced, references, sigma) for sigma in (BLUR_SIGMA, *BLUR_GRID)}
    best = max(blurs, key=lambda sigma: blurs[sigma]["aligned_psnr"])
    return {**scores, "blur": blurs[BLUR_SIGMA], "best_blur": blurs[best]}


def _mean_psnr(images: list[Image], references: list[Image]) -> dict[str, float]:
    pairs = list(zip(images, references, strict=True))
    return {
        "psnr": float(np.mean([psnr(image, reference) for image, reference in pairs])),
        "aligned_psnr": float(
            np.mean([psnr(affine_aligned(image, reference), reference) for image, reference in pairs])
        ),
    }


def _blur_scores(images: list[Image], references: list[Image], sigma: float) -> dict[str, float]:
    return {**_mean_psnr([gaussian_blur(image, sigma) for image in images], references), "sigma": sigma}


def merge(metrics: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """One metrics.json for an experiment from those of its runs, with the recovered fractions.

    Args:
        metrics: The metrics.json of each run, by method.

    Returns:
        Methods and what was unavailable of all runs; `recovered` = (method - naive) / (oracle - naive) in aligned PSNR
        against `enhanced`, for every method but these two.
    """
    methods = {name: run["methods"][name] for name, run in metrics.items()}
    unavailable = {what: why for run in metrics.values() for what, why in run["unavailable"].items()}
    recovered, why = recovered_fractions(methods)
    if why is not None:
        unavailable["recovered"] = why
    return {"methods": methods, "recovered": recovered, "unavailable": unavailable}


def recovered_fractions(methods: dict[str, Any]) -> tuple[dict[str, float], str | None]:
    """The share of what noise costs that each method wins back, and why there is none if there is none."""
    missing = [name for name in ("naive", "oracle") if name not in methods]
    if missing:
        return {}, f"the recovered fraction needs the method(s) {' and '.join(missing)}: reconstruct and score them too"
    value = {name: method["mean"]["enhanced"]["aligned_psnr"] for name, method in methods.items()}
    span = value["oracle"] - value["naive"]
    if span < 0.1:  # dB; a fraction of so little would be scatter divided by scatter
        return {}, f"the oracle is only {span:+.2f} dB from naive: noise costs too little here to speak of a fraction"
    others = [name for name in methods if name not in ("naive", "oracle")]
    return {name: (value[name] - value["naive"]) / span for name in others}, None
