"""The method as a whole: likelihood, targets, structure; several seeds, merged; every step judged by data."""

import dataclasses
import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from torch import Tensor

from novags.methods.enhanced.gaussian_fit import fit_for
from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.applying import enhanced, enhanced_light
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.inputs import LacksInput
from novags.methods.light import first_light
from novags.methods.memory import MANY
from novags.methods.noise_estimate import noise_of
from novags.methods.nova_plus.average import non_local_means
from novags.methods.nova_plus.bandwidth import choose_bandwidth
from novags.methods.nova_plus.checkpoints import claim, run_identity
from novags.methods.nova_plus.config import NovaPlusConfig, parts
from novags.methods.nova_plus.data import LightMeasurements, exposures
from novags.methods.nova_plus.judge import compare, mean_tone
from novags.methods.nova_plus.likelihood import Likelihood
from novags.methods.nova_plus.merge import merged
from novags.methods.nova_plus.plain import Distance, plain_config
from novags.methods.nova_plus.targets import LEFT, denoised_light, guided_light, towards
from novags.methods.problem import Problem, gathered
from novags.methods.reconstruction import Progress, Reconstruction
from novags.methods.tone import ToneCurve, tone_curve
from novags.process import give_back, sparing
from novags.splats.gaussians import Gaussians
from novags.splats.training.config import FitConfig, LearningRates
from novags.splats.training.fit import FitResult, fit
from novags.splats.training.step import PixelLoss

CHECKPOINTS = "checkpoints"
CHANGE = 0.03  # step in tone, about the error of a render, at which an enhanced picture's response is measured
SMOOTH = 0.02  # bandwidth, in tone, that smooths the render before that
GUIDE_BANDWIDTH = 0.7  # share of the averages' bandwidth that smooths the guide


def train(
    problem: Problem, config: NovaPlusConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct the light of a scene from noisy dark views.

    Args:
        problem: The problem; its seed and extent override `config.fit`.
        config: All choices.
        progress: Called with (iterations done, of how many, losses) of all fits together.
        checkpoint: Each fit has one of its own in the folder `checkpoints` beside it, named after stage and seed; a run
            goes on where the last of them ends.

    Returns:
        A reconstruction in linear light, in the unit of the linear 16-bit pictures. `targets` are the targets of stage
        2, enhanced. Seconds: "averages", and "fit" of all stages.

    Raises:
        LacksInput: If the problem has neither raw frames nor 16-bit linear pictures.
        ValueError: If the pictures hold no light, or a checkpoint is damaged or belongs to another run.
        NotFinite: As `fit` says.
    """
    started = time.perf_counter()
    fitting = dataclasses.replace(fit_for(problem, config.fit), cap_max=config.fit.cap_max)  # `gaussians` has the rule
    config = dataclasses.replace(config, fit=fitting)
    noise = noise_of(problem, config.noise)
    data = exposures(problem, noise, config.held_share)
    curve = tone_curve(data.greens)
    if checkpoint is not None:
        claim(checkpoint.parent / CHECKPOINTS, run_identity(problem, config, data))
    work = _Work(problem, config, data, curve, progress, checkpoint)
    work.found["noise"] = {"origin": noise.origin, "shared": list(data.shared)}
    firsts = [work.likelihood(seed) for seed in range(config.seeds)]
    final, targets = (firsts, None) if config.stages == "likelihood" else work.structure(firsts)
    del firsts
    gaussians = final[0] if len(final) == 1 else work.joined(final, targets)
    if config.plain:
        gaussians = work.or_plain(gaussians)
    scene = dataclasses.replace(GaussianScene.of(gaussians, work.base), tone=curve, matrix=data.matrix)
    between = time.perf_counter() - started - (work.seconds - work.earlier)  # done anew where a run goes on
    return Reconstruction(
        scene=scene,
        space="linear",
        config=config,
        enhancement=enhancement_record(config.enhance, config.pictures),
        enhanced=enhanced(problem, config.enhance, config.pictures),
        targets=None if targets is None else gathered(work.shown(targets), targets),
        viewmats=None if config.fit.refine_cameras is None else work.views.viewmats,
        losses=work.losses,
        seconds={"fit": work.seconds, "averages": between},
        found=work.found,
    )


class _Work:
    """One run: the data its stages share, and its findings."""

    def __init__(
        self, problem: Problem, config: NovaPlusConfig, data: LightMeasurements, curve: ToneCurve,
        progress: Progress | None, checkpoint: Path | None,
    ) -> None:  # fmt: skip
        self.problem, self.config, self.data, self.curve = problem, config, data, curve
        self.progress, self.checkpoint = progress, checkpoint
        self.base = config.fit
        self.views = problem.views
        self.large = not problem.views.viewmats.is_cuda and problem.views.height * problem.views.width >= MANY
        self.count = config.gaussians_each(len(data) * problem.views.height * problem.views.width)
        self.done, self.total = 0, sum(parts(config).values())
        self.seconds = self.earlier = 0.0  # of all fits, and of the fits in stopped runs before this one
        self.losses: list[dict[str, float]] = []
        self.found: dict[str, Any] = {
            "tone": {"top": curve.top, "k": curve.k}, "gaussians": self.count, "held_out_pixels": int(data.held.sum()),
        }  # fmt: skip

    def likelihood(self, seed: int) -> Gaussians:
        """Stage 1 of one seed."""
        loss = Likelihood(self.data, self.curve)
        # the loss is a mean: beside a third of the data, as with a mosaic, a prior weighs three times as much
        share = float(self.data.measured.float().mean())
        config = self._config("likelihood", seed, opacity_reg=self.base.opacity_reg / share)
        if seed == 0:
            config = dataclasses.replace(config, refine_cameras=self.base.refine_cameras)
        result = self._fit("likelihood", seed, self._first(), self.data.fitted_of, config, loss)
        self.views = dataclasses.replace(self.views, viewmats=result.viewmats)
        return result.gaussians

    def structure(self, firsts: list[Gaussians]) -> tuple[list[Gaussians], Tensor | None]:
        """Stage 2 of all seeds, and its targets; stage 1 itself, and None, if held-out data favour stage 1.

        It starts from the first points again: the thin, many-layered surfaces of stage 1 average noise well, but show
        the right colours from the wrong depth, and no loss would pull them out of it.
        """
        give_back()
        with sparing(self.large):
            h = self._bandwidth(firsts)
            targets = self.targets(non_local_means(self._guide(firsts), GUIDE_BANDWIDTH * h), h)
        seconds = []
        for seed in range(self.config.seeds):
            config = self._config("structure", seed)
            seconds.append(self._fit("structure", seed, self._first(), targets.__getitem__, config).gaussians)
        give_back()
        with sparing(self.large):
            guide = self._guide(firsts)
            weights = self.weights(non_local_means(guide, SMOOTH))
            worse = self._worse("structure", self._mean_tones(seconds), guide, weights)
        return (firsts, None) if worse else (seconds, targets)

    def _guide(self, firsts: list[Gaussians]) -> Tensor:
        """Tones of the training views [C, H, W, 3]; rendered where they are wanted, as they take much memory."""
        return gathered(self._mean_tones(firsts), self.data.light)

    def _bandwidth(self, firsts: list[Gaussians]) -> float:
        h = self.config.bandwidth
        if h is None:
            h, tried = choose_bandwidth(self._guide(firsts), self.data, self.curve)
            self.found |= {"bandwidths": tried} if tried else {}
        self.found["bandwidth"] = h
        return h

    def targets(self, tones: Iterable[Tensor], h: float) -> Tensor:
        """Tones [C, H, W, 3] that stage 2 fits, from tones [H, W, 3] that guide."""
        guide = gathered(tones, self.data.light)
        config = self.config
        light = guided_light(guide, self.data, self.curve, h, config.averaged_share, config.least_share)
        expected = (self.curve.light(view) for view in guide)
        del guide  # its memory is wanted once `expected` is used up
        give_back()
        clean = self.denoised(expected)
        self.found["denoised"] = clean is not None
        for seen, other in zip(light, light if clean is None else clean, strict=True):
            near = towards(seen, other, LEFT * self.data.noise(seen), self.curve, config.least_share)
            seen.copy_(self.curve.tone(seen + config.denoised_share * (near - seen)))
        return light

    def denoised(self, expected: Iterable[Tensor]) -> Iterator[Tensor] | None:
        """The light of the denoised data; None if denoising is off, or the data have no independent noise."""
        before = self.done
        self.done += parts(self.config)["denoiser"]

        def report(done: int, _: int, entry: dict[str, float]) -> None:
            if self.progress is not None:
                self.progress(before + done, self.total, entry)

        if self.config.denoise is None:
            return None
        try:
            return denoised_light(
                self.data, expected, self.config.denoise, seed=self.problem.seed, progress=report
            )  # fmt: skip
        except LacksInput:  # data share their noise, or have none
            return None

    def joined(self, sets: list[Gaussians], targets: Tensor | None) -> Gaussians:
        """All seeds as one set, trained a little further; the first seed alone, if held-out data favour that."""
        give_back()
        joined = merged(sets)
        loss = Likelihood(self.data, self.curve) if targets is None else None
        config = self._config(
            "merged", 0, rates=_scaled(self.base.rates, 0.1), mcmc=None, sh_every=1, opacity_reg=0.0,
            cap_max=len(joined),
        )  # fmt: skip
        aim = self.data.fitted_of if targets is None else targets.__getitem__
        joined = self._fit("merged", 0, joined, aim, config, loss).gaussians
        with sparing(self.large):
            first = gathered(self._tones(sets[0]), self.data.light)
            return sets[0] if self._worse("merged", self._tones(joined), first, self.weights(first)) else joined

    def or_plain(self, ours: Gaussians) -> Gaussians:
        """The whole method's Gaussians; those of a plain fit, if held-out data reject the former beside it."""
        give_back()
        config = plain_config(self._config("plain", 0), self.config.iterations("plain"))
        plain = self._fit(
            "plain", 0, self._first(), lambda i: self.curve.tone(self.data.fitted_of(i)), config, Distance()
        ).gaussians
        with sparing(self.large):
            other = gathered(self._tones(plain), self.data.light)
            return plain if self._worse("plain", self._tones(ours), other, self.weights(other)) else ours

    def _worse(self, part: str, tones: Iterable[Tensor], other: Tensor, weights: Tensor) -> bool:
        """Whether the held-out data reject a part. If no data are held out, nothing is judged, and the part is kept."""
        verdict = compare(tones, other, self.data, self.curve, weights)
        self.found[part] = dataclasses.asdict(verdict) if math.isfinite(verdict.deviation) else None
        return verdict.worse

    def weights(self, tones: Iterable[Tensor]) -> Tensor:
        """How strongly the enhanced pictures respond to a change in tone, squared, [C, H, W, 3]; with mean 1."""
        above, below = itertools.tee(tones)
        more, less = self.shown(view + CHANGE for view in above), self.shown(view - CHANGE for view in below)
        slopes = ((a - b) / (2 * CHANGE) for a, b in zip(more, less, strict=True))
        answer = gathered((slope.square() for slope in slopes), self.data.light)
        return answer.div_(answer.mean())

    def shown(self, tones: Iterable[Tensor]) -> Iterator[Tensor]:
        """Tones of the training views as pictures, each through the enhancement of its own view."""
        matrix = self.data.matrix
        light = (self.curve.light(view) if matrix is None else self.curve.light(view) @ matrix.T for view in tones)
        return enhanced_light(self.problem, light, self.config.enhance, self.config.pictures)

    def _first(self) -> Gaussians:
        """The first points, in the tones that the data have there."""
        start = self.problem.start
        colors = self.curve.tone(first_light(start, self.data)).clamp(0, 1).to(self.data.light)
        return Gaussians.from_points(
            start.points.to(colors), colors, sh_degree=self.base.sh_degree, init_scale=self.config.init_scale
        )

    def _config(self, part: str, seed: int, **changes: Any) -> FitConfig:
        # the seeds within one run must not coincide with seeds in runs with the next seeds
        seed = self.base.seed + 1000 * seed
        # one fit corrects the cameras, for all others: guides, merged seeds and renders need one frame
        common = {"iterations": self.config.iterations(part), "cap_max": self.count, "seed": seed,
                  "refine_cameras": None, "keep_at": ()}  # fmt: skip
        return dataclasses.replace(self.base, **{**common, **changes})

    def _tones(self, gaussians: Gaussians) -> Iterator[Tensor]:
        """Renders of the training views [H, W, 3], one by one."""
        scene = GaussianScene.of(gaussians, self.base)
        return (scene.render(view)[0][0] for view in self.views.each())

    def _mean_tones(self, sets: Sequence[Gaussians]) -> Iterator[Tensor]:
        """The tones of their mean light."""
        return (mean_tone(each, self.curve) for each in zip(*map(self._tones, sets), strict=True))

    def _fit(
        self, part: str, seed: int, start: Gaussians, target: Callable[[int], Tensor], config: FitConfig,
        loss: PixelLoss | None = None,
    ) -> FitResult:  # fmt: skip
        path = self.checkpoint and self.checkpoint.parent / CHECKPOINTS / f"{part}-{seed}.safetensors"

        def report(done: int, _: int, entry: dict[str, float]) -> None:
            if self.progress is not None:
                self.progress(self.done + done, self.total, entry)

        result = fit(start, self.views, target, config, photometric=loss, checkpoint=path, progress=report)
        self.losses += [{**entry, "iteration": self.done + entry["iteration"]} for entry in result.losses]
        self.done += config.iterations
        self.seconds += result.seconds
        self.earlier += result.earlier
        return result


def _scaled(rates: LearningRates, factor: float) -> LearningRates:
    """All rates times a factor, but for the last of the means."""
    names = ("means", "quats", "log_scales", "logit_opacities", "sh_dc", "sh_rest")
    scaled = {name: factor * getattr(rates, name) for name in names}
    return dataclasses.replace(rates, **{**scaled, "means": max(scaled["means"], rates.means_final)})
