"""Three lengths of one fit: its end, its own stop, which sees no truth, and its best by the truth.

A fit stops itself at the length that shows best some training views that nothing was trained on. Their dark pictures
have noise that the fit has never seen, so that the squared error against them is the error against their mean and a
constant: the length with the smallest is the best, but for chance. Whole views are held out, for nothing leaks from
them: no window of an enhancement or of a score, no interpolation of a mosaic, no denoiser has seen their pixels.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from novags.testbed.folders.capture import Capture
from novags.testbed.folders.references import enhanced_dark, pictured
from novags.testbed.folders.run import Run
from novags.testbed.metrics.images import aligned_psnr, mean_scores
from novags.testbed.stages.scores.comparing import SHARES


@dataclass(frozen=True)
class Stops:
    """Stops of a fit and their scores.

    Attributes:
        end: The score after all iterations.
        stop: After which iterations it stops itself.
        stopped: The score there.
        best: After which iterations the score is best.
        highest: The score there.
    """

    end: float
    stop: int
    stopped: float
    best: int
    highest: float


def held_out_scores(run: Run, capture: Capture) -> dict[str, Any] | None:
    """How well each length of a fit shows the dark pictures that it was not trained on; None where none were held out.

    Returns:
        `psnr`: mean aligned PSNR of the held-out training views against their own noisy pictures, enhanced, by
        iterations; `stop`: the length with the highest.
    """
    if not run.held or not run.along() or run.enhancement is None:
        return None
    places = [capture.names.index(name) for name in run.held]
    noisy = {capture.names[i]: enhanced_dark(capture, i, run.enhancement) for i in places}
    found = dict[int, float]()
    for then in (*run.along(), run):
        shown = {name: pictured(run, capture, then.rendering(name)) for name in noisy}
        mean = mean_scores([{"psnr": aligned_psnr(shown[name], picture)} for name, picture in noisy.items()])["psnr"]
        if mean is not None:
            found[then.at or run.iterations] = mean
    return {"psnr": found, "stop": max(found, key=found.__getitem__)} if found else None


def curve(scores: Mapping[str, Any], end: int, kind: str, score: str) -> dict[int, float]:
    """The score of one run by iterations, its `end` included, where it is known; {} without lengths before the end."""
    if not (along := scores.get("along")):
        return {}
    steps = [*((each["iterations"], each["mean"]) for each in along), (end, scores["mean"])]
    found = {at: (mean.get(kind) or {}).get(score) for at, mean in steps}
    return {at: value for at, value in sorted(found.items()) if value is not None}


def lengths_of(scores: Mapping[str, Any], kind: str, score: str) -> Stops | None:
    """The three lengths of a run by one score; None where no views were held out, or the score is not known."""
    held = scores.get("held_out")
    if held is None:
        return None
    end, stop = max(map(int, held["psnr"])), int(held["stop"])
    found = curve(scores, end, kind, score)
    if not {end, stop} <= found.keys():
        return None
    best = max(found, key=found.__getitem__)
    return Stops(found[end], stop, found[stop], best, found[best])


def length_columns(scores: Mapping[str, Any]) -> dict[str, Any]:
    """The same as columns of a table: `stop.iterations`, `stop.lit.tone_aligned_psnr`, `best.lit.iterations`, ..."""
    found = dict[str, Any]()
    for kind, score in SHARES.values():
        if (three := lengths_of(scores, kind, score)) is not None:
            found |= {
                "stop.iterations": three.stop, f"stop.{kind}.{score}": three.stopped,
                f"best.{kind}.iterations": three.best, f"best.{kind}.{score}": three.highest,
            }  # fmt: skip
    return found
