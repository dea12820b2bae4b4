"""Truth in place of one ingredient of a problem: a function each, and the table of them."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch

from novags.cameras.align import align
from novags.cameras.estimate import CameraEstimate
from novags.cameras.sources.known import KnownConfig
from novags.methods.memo import Memo
from novags.methods.problem import Problem, stacked
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.set import Source
from novags.testbed.stages.camera_source import cameras_of, true_cameras


def noise(problem: Problem, capture: Capture, source: Source, estimate: CameraEstimate, indices: list[int]) -> Problem:
    """The pictures without noise, developed as the noisy ones are; cameras and first points stay."""
    linear = partial(stacked, partial(capture.clean_linear, demosaiced=True), indices)
    raw = None
    if problem.raw is not None and not capture.imported:
        raw = replace(problem.raw, dn=partial(stacked, partial(capture.truth, kind="clean"), indices))
    return replace(
        problem, srgb8=stacked(partial(capture.clean, demosaiced=True), indices), raw=raw,
        linear16=linear if capture.holds("images16") else None, shared=Memo(),
    )  # fmt: skip


def points(problem: Problem, capture: Capture, source: Source, estimate: CameraEstimate, indices: list[int]) -> Problem:
    """First points on the true surface, brought to the frame of the run's own cameras."""
    assert problem.n_gaussians is not None
    true = cameras_of(KnownConfig(), capture, source, indices, problem.n_gaussians, problem.seed,
                      torch.device("cpu"), Console(quiet=True))  # fmt: skip
    back = align(torch.tensor(estimate.rig.viewmats), true_cameras(capture)[indices]).similarity.inverse()
    start = replace(estimate, points=back.apply(true.points).float(), colors=true.colors, made_of=true.made_of)
    return replace(problem, start=start, shared=Memo())


GIVEN: dict[str, Callable[[Problem, Capture, Source, CameraEstimate, list[int]], Problem]] = {
    "noise": noise,
    "points": points,
}
