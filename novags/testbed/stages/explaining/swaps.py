"""The table of swaps: which ingredient of a run its truth can replace, and how; one row each.

A row answers for one run: the configuration to make it again with, or scores of the run itself, or why neither is
known.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from novags.cameras import parse_cameras
from novags.cameras.sources.known import KnownConfig
from novags.methods import METHODS
from novags.methods.variant import Variant, dotted
from novags.settings import changed, flattened, has_setting
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.imported import MISSING
from novags.testbed.folders.run import EXPLAINED, Run
from novags.testbed.folders.set import Source
from novags.testbed.ledger.contents import jsonable
from novags.testbed.metrics.differences import Values
from novags.testbed.stages.configs.command import CommandConfig
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.stages.explaining.more import MORE, refuse_more
from novags.testbed.stages.explaining.recorded import as_recorded
from novags.testbed.stages.scores.comparing import values_of

# By reference, the first that is known. Tone is a step of its own: an enhancement is chosen by the pictures, so that
# without their noise it chooses another tone, which must not count as a loss of that step.
TONE = "tone_aligned_psnr"
SCORES = {"enhanced": TONE, "lit": TONE, "linear": "linear_psnr"}
PLAIN = "psnr"
Again = ReconstructConfig | CommandConfig  # what to make a run again with


class NotSwapped(ValueError):
    """Why an ingredient cannot be replaced by its truth."""


@dataclass(frozen=True)
class Case:
    """A run to explain, with all that it was made from."""

    run: Run
    capture: Capture
    source: Source
    scores: Mapping[str, Any]  # of the run
    commands: tuple[CommandConfig, ...] = ()  # programs that are known: a run may be by one of them

    @property
    def seed(self) -> str:
        """Tells it from other runs of the same method: seeds of the fit and of the exposures."""
        told = self.capture.record.simulated
        return f"{self.run.record.get('seed')}/{'' if told is None else told.noise_seed}"

    def folder(self, name: str) -> Path:
        """Where the run lies that has its truth of this name."""
        return self.run.path / EXPLAINED / name

    @cached_property
    def config(self) -> ReconstructConfig:
        """What it was made with.

        Raises:
            NotSwapped: If this version cannot make it so.
        """
        run = self.run
        if (method := METHODS.get(run.method)) is None:
            raise NotSwapped(
                f"{run.method} is a program: it has the true cameras, and points, fit and length of its own"
            )
        asked = run.record["stage"]["config"]

        def make() -> ReconstructConfig:
            variant = Variant(
                name=run.name, method=run.method, settings=run.record["variant"], fits=asked.get("fits", 1),
                title=run.record["title"].removesuffix(f" (from {METHODS.origin_of(run.method)})"),
            )  # fmt: skip
            return ReconstructConfig(
                variant=variant, config=changed(method.config(), dotted(asked["config"]), what=run.name),
                cameras=parse_cameras(asked["cameras"]), points=asked["points"], seed=asked["seed"],
                hold_out=asked.get("hold_out", 0), device=str(run.record["device"]).partition(":")[0],
            )  # fmt: skip

        try:
            config: ReconstructConfig = as_recorded(run.name, asked, make)
        except ValueError as error:
            raise NotSwapped(str(error)) from error
        return config

    @property
    def program(self) -> CommandConfig:
        """The program that made it.

        Raises:
            NotSwapped: If it is not among those that are known, or has changed.
        """
        own = {command.name: replace(command, seed=self.run.record["seed"]) for command in self.commands}
        if (found := own.get(self.run.method)) is None:
            raise NotSwapped(f"how {self.run.method} is run is not known: name its study file, --study FILE.toml")
        if jsonable(found.resolved()) != self.run.record["stage"]["config"]:
            raise NotSwapped(f"{self.run.method} is not the program that made {self.run.path}: it has changed since")
        return found

    @property
    def score(self) -> tuple[str, str]:
        """The reference and the score that its dB are counted in."""
        known = [kind for kind in SCORES if (self.scores["mean"].get(kind) or {}).get(SCORES[kind]) is not None]
        if not known:
            raise ValueError(f"{self.run.path} cannot be explained: no truth of its held-out views is known")
        return known[0], SCORES[known[0]]

    def values(self, scores: Mapping[str, Any], number: str | None = None) -> Values:
        """This score, or another one against its reference, by held-out view."""
        kind, own = self.score
        return values_of(scores, kind, number or own, seed=self.seed)


def cameras(case: Case) -> ReconstructConfig:
    """The set's own cameras, and first points that follow them."""
    settings = {"fit.refine_cameras": None} if has_setting(case.config.config, "fit.refine_cameras") else {}
    cameras = case.config.cameras if case.config.cameras.keeps_cameras else KnownConfig()
    config = replace(case.config, cameras=cameras, config=changed(case.config.config, settings))
    if config == case.config:
        raise NotSwapped("they are the true ones already")
    if case.capture.imported:
        raise NotSwapped("the true cameras of photographs are not known")
    return config


def points(case: Case) -> ReconstructConfig:
    """First points on the true surface."""
    if METHODS[case.config.variant.method].family == "NeRF":
        raise NotSwapped(f"{case.run.name} fits a field, which has no first points")
    _need_surface(case)
    if isinstance(case.config.cameras, KnownConfig) and not case.config.cameras.depth_error:
        raise NotSwapped("they are from the true depth already")
    return replace(case.config, given="points")


def noise(case: Case) -> Again:
    """The same exposures without noise."""
    if not case.capture.holds("truth"):
        raise NotSwapped(f"of this capture {MISSING['truth']}")
    if case.run.method not in METHODS:
        program = case.program
        if case.capture.record.uneven.exposures:
            raise NotSwapped("programs get views as taken, and noise-free ones are known of the common exposure alone")
        return replace(program, given="noise")
    if METHODS[case.config.variant.method].sees_clean:
        raise NotSwapped(f"{case.run.name} is given the noise-free exposures already")
    return replace(case.config, given="noise")


def tone(case: Case) -> Values:
    """Of every channel of a view the monotone curve that comes closest to the truth: all other steps are scored so."""
    if case.score[1] != TONE:
        raise NotSwapped(f"no score after a tone curve is known against {case.score[0]}")
    return case.values(case.scores)


def geometry(case: Case) -> ReconstructConfig:
    """Gaussians that start on the true surface and stay where they are."""
    if not has_setting(case.config.config, "fit.rates.means"):
        raise NotSwapped(f"{case.run.name} fits no Gaussians, which alone can be kept in their places")
    _need_surface(case)
    fixed = {"fit.rates.means": 0.0, "fit.rates.means_final": 0.0, "fit.mcmc": None}
    return replace(case.config, given="points", config=changed(case.config.config, fixed))


def colours(case: Case) -> ReconstructConfig:
    """Never: they have no truth apart from that of the pictures."""
    raise NotSwapped("the true colours of a Gaussian are not defined; what is wrong with them has come with the noise, "
                     "the cameras, the geometry or the tone")  # fmt: skip


def length(case: Case) -> ReconstructConfig | Values:
    """The best of the lengths that were scored along the fit; without them, twice the iterations."""
    if along := case.scores.get("along"):
        return case.values(max((*along, case.scores), key=lambda each: _mean(case.values(each))))
    name = next((name for name in flattened(case.config.config) if name in ("fit.iterations", "iterations")), None)
    if name is None:
        raise NotSwapped(f"{case.run.name} has no iterations")
    twice = 2 * flattened(case.config.config)[name]
    return replace(case.config, config=changed(case.config.config, {name: twice}))


def views(case: Case) -> ReconstructConfig:
    """Training views of the same scene, `MORE` times as many."""
    if METHODS[case.config.variant.method].sees_surface:
        raise NotSwapped(f"{case.run.name} is given the surface by view")
    try:
        refuse_more(case.capture, case.source)
    except ValueError as error:
        raise NotSwapped(str(error)) from error
    return replace(case.config, more=case.folder("more") / "capture")


def _need_surface(case: Case) -> None:
    if case.source.scaled or case.source.views.geometry(0) is None:
        raise NotSwapped("the true surface is not known: photographs, or a set scaled down for the capture")


def _mean(values: Values) -> float:
    return sum(values.values()) / len(values) if values else float("-inf")


@dataclass(frozen=True)
class Swap:
    """A row: what is replaced, by which truth, in words, and how.

    Attributes:
        truth: Completes "with ...".
        change: What to make the run again with, or values of the run itself. Raises NotSwapped.
        costs: Times the reconstruction of the run, about.
        above: The score of the run that it is compared with; None: that of all others.
    """

    truth: str
    change: Callable[[Case], Again | Values]
    costs: float = 1.0
    above: str | None = None


SWAPS = {
    "cameras": Swap("the true cameras", cameras),
    "points": Swap("first points on the true surface", points),
    "noise": Swap("the same exposures without noise", noise),
    "tone": Swap("the monotone curve of each channel that comes closest", tone, above=PLAIN),
    "geometry": Swap("Gaussians kept on the true surface", geometry),
    "colours": Swap("true colours", colours),
    "length": Swap("the best length along the fit, or twice the iterations", length, 2.0),
    "views": Swap(f"{MORE} times the training views", views),
}
