"""Scores that only a test bed can give: how much of the known noise is left, and the bias floor of the targets."""

import json
from typing import Any

import numpy as np
import torch

from novags.methods.enhancers import recorded
from novags.methods.enhancers.applying import enhanced_twin, enhanced_view
from novags.methods.enhancers.enhancer import stamps
from novags.methods.memo import Memo
from novags.methods.problem import encode
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.references import enhanced_dark, enhanced_truth, pictured
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source
from novags.testbed.metrics.images import PSNR_CEILING
from novags.testbed.metrics.noise import centred_noise, noise_share, squared_bias
from novags.testbed.metrics.picture import Image
from novags.testbed.stages.capturing import expose_view
from sensor_model.isp import develop, from_linear16
from sensor_model.planner import Plan
from simscenes.sets.pictures.png import read_png

VIEWS, EXPOSURES = 2, 4  # training views of the bias floor, and exposures of each
FURTHER = 1_000_000  # seeds of these exposures start here, so that none is one of the capture's
_FLOORS = Memo()  # by capture and enhancement: the runs of an experiment are scored one after another


def noise_scores(run: Run, capture: Capture, lit: Source) -> dict[str, float | None] | None:
    """Scores of the training views of a run that enhances its pictures; None if the noise-free exposure is not known.

    Returns:
        `known`: root mean square of the noise in the enhanced pictures, sRGB code. `targets`, `renders`: the share of
        it that is left in the targets of the fit, and in its renderings of the same views (None if there are none).
        `bias_floor`: PSNR in dB of the mean of infinitely many exposures, each enhanced, against the noise-free one,
        which a fit that averages cannot exceed; None where they cannot be taken again: of imported photographs, and of
        a camera by maps or dark frames, which a capture does not keep. Behind a colour filter array the errors of
        interpolation are not noise, but part of the bias.
    """
    if run.enhancement is None or not (run.path / "enhanced").is_dir() or not capture.holds("truth"):
        return None
    told = capture.record.simulated
    squares, targets, renders = [], [], []
    for i in capture.cameras.train_indices:
        name = capture.names[i]
        if not (run.path / "enhanced" / f"{name}.png").exists():
            continue  # a view without a camera
        noisy = enhanced_dark(capture, i, run.enhancement)
        truth = enhanced_truth(capture, i, run.enhancement, demosaiced=capture.demosaiced)
        squares.append(float(np.square(centred_noise(noisy, truth)).mean()))
        kind = "denoised" if (run.path / "denoised").is_dir() else "enhanced"
        targets.append(noise_share(read_png(run.path / kind / f"{name}.png"), noisy, truth))
        if run.shows_training_views:
            renders.append(noise_share(pictured(run, capture, run.rendering(name)), noisy, truth))
    return {
        "known": float(np.sqrt(np.mean(squares))) if squares else None,
        "targets": _mean(targets),
        "renders": _mean(renders),
        "bias_floor": None if told is None or told.measured else _floor_of(capture, lit, run.enhancement),
    }


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _floor_of(capture: Capture, lit: Source, enhancement: dict[str, Any]) -> float:
    key = (capture.content, json.dumps(enhancement, sort_keys=True), stamps(recorded(enhancement)[1]))
    return _FLOORS.once(key, lambda: bias_floor(capture, lit, enhancement))


def bias_floor(capture: Capture, lit: Source, enhancement: dict[str, Any]) -> float:
    """PSNR in dB that the mean of all exposures cannot exceed, at most `PSNR_CEILING`; see `noise_scores`.

    `VIEWS` training views are exposed anew, each `EXPOSURES` times, and enhanced as the run did it; each exposure's
    reference is the noise-free one through that exposure's own enhancement, as everywhere.
    """
    _, config = recorded(enhancement)
    indices = capture.cameras.train_indices
    found = []
    for i in indices[:: max(1, len(indices) // VIEWS)][:VIEWS]:
        clean = torch.from_numpy(capture.clean(i).copy())
        exposures, references = [], []
        for k in range(EXPOSURES):
            memo, pictures = Memo(), enhancement["pictures"]  # of this exposure alone
            dark = torch.from_numpy(exposed_again(capture, lit, i, FURTHER + k, pictures))
            exposures.append(enhanced_view(memo, "", dark, config, pictures, capture.noise_at(i))[0].numpy())
            references.append(enhanced_twin(memo, "", dark, clean, config, pictures, capture.noise_at(i)).numpy())
        found.append(squared_bias(exposures, references))
    mean = float(np.mean(found))
    return PSNR_CEILING if mean <= 10 ** (-PSNR_CEILING / 10) else -10 * float(np.log10(mean))


def exposed_again(capture: Capture, lit: Source, i: int, seed: int, pictures: str) -> Image:
    """Another exposure of view `i` of a simulated capture, as `Capture.dark` gives it."""
    record, told = capture.record, capture.record.simulated
    assert record.sensor is not None, "of a simulated capture"
    assert told is not None, "of a simulated capture"
    assert told.mean_green is not None, "of this version"
    uneven = record.uneven
    frame = expose_view(
        lit.radiance(i), record.sensor, record.exposure, electrons=told.electrons, mean_green=told.mean_green,
        seed=seed, view=i, plan=None if told.plan is None else Plan.from_dict(told.plan),
        times=uneven.times(i), frames=record.burst,
    )  # fmt: skip
    developed = develop(
        frame, uneven.seen_by(record.sensor, i), demosaic=record.demosaic, color_matrix=record.color_matrix,
        jpeg_quality=told.jpeg_quality,
    )  # fmt: skip
    if pictures == "8bit":
        return uneven.even_srgb(developed.srgb8.astype(np.float32) / 255, i)
    return encode(uneven.even(from_linear16(developed.linear16), i))
