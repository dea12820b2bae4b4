"""NOVA-GS as a whole: enhance, denoise, and fit with L_total = L_recon + L_geo + L_SH (paper, section 4.7)."""

import dataclasses
import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from novags.methods.enhancers.guided import EnhanceConfig, enhance
from novags.methods.nova.checkpoint import file_as_tensor, read, tensor_as_file
from novags.methods.nova.consistency import ConsistencyConfig, ConsistencyLoss
from novags.methods.nova.denoiser import Denoiser, DenoiserConfig
from novags.methods.nova.sh_penalty import noise_map, sh_penalty
from novags.methods.problem import MethodInput, MethodResult
from novags.methods.start import start_gaussians
from novags.splats.checkpoint import digest, write_tensors
from novags.splats.fit import FitConfig, Step, fit
from novags.splats.gaussians import Gaussians

Progress = Callable[[int, int, dict[str, float]], None]
SAVE_INTERVAL = 60.0  # s between two checkpoints of the warm-up: its steps take from milliseconds to many seconds


@dataclass(frozen=True, kw_only=True)
class NovaConfig:
    """The whole method. `fit.dssim_weight` is the paper's lambda; L_recon is the fit's own photometric loss."""

    enhance: EnhanceConfig = field(default_factory=EnhanceConfig)
    denoiser: DenoiserConfig = field(default_factory=DenoiserConfig)
    consistency: ConsistencyConfig | None = field(default_factory=ConsistencyConfig)
    sh_weight: float | None = 1.0  # of L_SH
    # "The masked loss serves as the sole optimization objective for the denoiser" (section 4.3.3). False lets L_recon
    # reach it too, which is how section 4.7 can be read ("jointly optimized in an end-to-end manner").
    detach_target: bool = True
    refresh_after: int = 1  # denoiser steps after which a view's pseudo-clean image is computed anew
    init_scale: float = 0.7
    fit: FitConfig = field(default_factory=FitConfig)

    def __post_init__(self) -> None:
        if self.sh_weight is not None and self.sh_weight < 0:
            raise ValueError(f"sh_weight must be >= 0 or None, got {self.sh_weight}")
        if self.refresh_after < 1:
            raise ValueError(f"refresh_after must be >= 1, got {self.refresh_after}")


class _PseudoClean:
    """The denoised image of each view, computed when asked for and kept while the denoiser has not moved on."""

    def __init__(self, denoiser: Denoiser, config: NovaConfig) -> None:
        self.denoiser, self.config = denoiser, config
        self.cached: dict[int, tuple[int, Tensor]] = {}

    def __call__(self, view: int) -> Tensor:
        """[H, W, 3] without gradient."""
        step, image = self.cached.get(view, (-self.config.refresh_after, None))
        if image is None or self.denoiser.step - step >= self.config.refresh_after:
            with torch.no_grad():
                image = self.denoiser.denoise(view)
            self.cached[view] = (self.denoiser.step, image)
        return image

    def target(self, view: int) -> Tensor:
        """[H, W, 3], with gradient into the denoiser if it takes part in L_recon."""
        return self(view) if self.config.detach_target else self.denoiser.denoise(view)

    def state(self) -> dict[str, Tensor]:
        """The images that the denoiser as it stands might not give again, by view and denoiser step."""
        if self.config.refresh_after == 1:
            return {}
        return {f"clean.{view}.{step}": image for view, (step, image) in self.cached.items()}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state`."""
        for name, image in tensors.items():
            if name.startswith("clean."):
                view, step = map(int, name.split(".")[1:])
                self.cached[view] = (step, image.to(self.denoiser.images))


def run_identity(inputs: MethodInput, config: NovaConfig) -> Tensor:
    """Hash of all that a run depends on, uint8."""
    views = (inputs.views.viewmats, inputs.views.Ks, inputs.dark, inputs.init.points, inputs.init.colors)
    told = json.dumps([dataclasses.asdict(config), inputs.seed, inputs.init.extent], sort_keys=True, default=str)
    run = hashlib.blake2b((digest(*views) + told).encode(), digest_size=16)
    return torch.tensor(list(run.digest()), dtype=torch.uint8)


class _Training:
    """Denoiser, confidence network and their schedule beside the splat iterations.

    What they need to go on is saved together with the fit's checkpoint, in one file: were the two apart, an
    interruption between them would pair networks and splats of different iterations.
    """

    def __init__(self, inputs: MethodInput, enhanced: Tensor, config: NovaConfig, checkpoint: Path | None) -> None:
        iterations = config.fit.iterations
        self.config, self.enhanced = config, enhanced
        total = config.denoiser.total_steps(iterations)
        self.denoiser = Denoiser(enhanced, config.denoiser, total_steps=total, seed=inputs.seed)
        self.clean = _PseudoClean(self.denoiser, config)
        self.noise: dict[int, tuple[Tensor, Tensor]] = {}  # view -> a pseudo-clean image and the noise map made of it
        self.geo: ConsistencyLoss | None = None
        if config.consistency is not None and config.consistency.weight > 0:
            self.geo = ConsistencyLoss(
                inputs.views, self.clean, config.consistency, iterations=iterations, seed=inputs.seed
            )
        self.run = run_identity(inputs, config)
        self.start: Gaussians | None = None
        self.seconds = 0.0  # until the splats start, of interrupted attempts too
        self.fit_path = checkpoint
        self.path = None if checkpoint is None else checkpoint.with_name(f"{checkpoint.stem}.denoiser.safetensors")
        if self.path is not None and self.path.exists():
            self._restore(read(self.path))
        elif checkpoint is not None and checkpoint.exists():
            raise ValueError(f"{checkpoint} lacks the networks that belong to it: delete it, the run then starts over")

    def warm_up(self, inputs: MethodInput, progress: Progress | None) -> Gaussians:
        """Train the denoiser alone, then make the Gaussians that the splats start from, coloured by it."""
        if self.start is not None:
            return self.start
        saved = time.perf_counter()
        started = saved - self.seconds
        steps = self.config.denoiser.warmup_steps
        while self.denoiser.step < steps:
            loss = self.denoiser.train_step()
            self.seconds = time.perf_counter() - started
            if time.perf_counter() - saved > SAVE_INTERVAL:
                self.save()
                saved = time.perf_counter()
            if progress is not None:
                progress(self.denoiser.step, steps + self.config.fit.iterations, {"denoiser": loss})
        clean = torch.stack([self.clean(i) for i in range(len(inputs.views))])
        sh_degree, init_scale = self.config.fit.sh_degree, self.config.init_scale
        self.start = start_gaussians(inputs.init, inputs.dark, clean, sh_degree=sh_degree, init_scale=init_scale)
        self.seconds = time.perf_counter() - started
        self.save()
        return self.start

    def before_step(self, iteration: int) -> None:
        """Bring both networks up to a splat iteration, then save if the fit has just saved."""
        if self.geo is not None:
            self.geo.update()
        if self.denoiser.step < self.config.denoiser.total_steps(iteration):
            self.denoiser.train_step()
        fit = self.config.fit
        if iteration and (iteration % fit.checkpoint_every == 0 or iteration == fit.iterations):
            self.save()

    def noise_penalty(self, step: Step) -> Tensor | None:
        """Weighted L_SH of this iteration."""
        if not self.config.sh_weight:
            return None
        clean = self.clean(step.view)
        known = self.noise.get(step.view)
        if known is None or known[0] is not clean:
            known = self.noise[step.view] = (clean, noise_map(self.enhanced[step.view], clean))
        noise = known[1]
        return self.config.sh_weight * sh_penalty(step.gaussians.sh, step.info["means2d"], step.info["radii"], noise)

    def save(self) -> None:
        """Write all that the next iteration depends on, the fit's checkpoint included."""
        if self.path is None or self.fit_path is None:
            return
        tensors = self.denoiser.state() | self.clean.state() | (self.geo.state() if self.geo is not None else {})
        tensors["run"] = self.run
        tensors["seconds"] = torch.tensor(self.seconds, dtype=torch.float64)
        if self.start is not None:
            tensors |= {f"start.{name}": tensor for name, tensor in self.start.tensors().items()}
        if self.fit_path.exists():
            tensors["fit"] = file_as_tensor(self.fit_path)
        write_tensors(self.path, tensors)

    def _restore(self, tensors: dict[str, Tensor]) -> None:
        if not torch.equal(tensors.get("run", torch.empty(0)), self.run):
            raise ValueError(f"{self.path} belongs to a run of other images or settings: delete it or restore them")
        self.denoiser.restore(tensors)
        self.clean.restore(tensors)
        if self.geo is not None:
            self.geo.restore(tensors)
        self.seconds = float(tensors["seconds"])
        start = {name.removeprefix("start."): t for name, t in tensors.items() if name.startswith("start.")}
        self.start = Gaussians(**start) if start else None
        assert self.fit_path is not None
        if "fit" in tensors:
            tensor_as_file(tensors["fit"], self.fit_path)
        else:  # the fit's first checkpoint may be there, but without the networks of that moment
            self.fit_path.unlink(missing_ok=True)


def train(
    inputs: MethodInput,
    config: NovaConfig,
    *,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
) -> MethodResult:
    """Reconstruct a scene from noisy dark views.

    Args:
        inputs: Views, dark images, initial points and seed.
        config: All choices; `config.fit.seed` and `config.fit.extent` are overridden by `inputs`.
        progress: Called with (steps done, of how many, losses); denoiser warm-up and splat iterations count alike.
        checkpoint: The fit's checkpoint file. All that a run goes on from lies beside it, in
            `<stem>.denoiser.safetensors`, with a copy of the fit's; if that is there already, it does.

    Returns:
        MethodResult; `targets` are the denoised images. Seconds: "enhance", "denoise" (warm-up), "fit" (with the
        concurrent denoiser steps), the latter two of interrupted attempts too.

    Raises:
        ValueError: If a checkpoint is damaged or belongs to another run.
    """
    fit_config = dataclasses.replace(config.fit, seed=inputs.seed, extent=inputs.init.extent)
    config = dataclasses.replace(config, fit=fit_config)
    started = time.perf_counter()
    enhanced, _ = enhance(inputs.dark, config.enhance)
    enhancing = time.perf_counter() - started
    training = _Training(inputs, enhanced, config, checkpoint)
    start = training.warm_up(inputs, progress)
    warmup = config.denoiser.warmup_steps
    result = fit(
        start, inputs.views, training.clean.target, fit_config,
        extra_losses=[loss for loss in (training.geo, training.noise_penalty) if loss is not None],
        before_step=training.before_step, needs_depth=training.geo.due if training.geo else False,
        checkpoint=checkpoint,
        progress=progress and (lambda done, total, entry: progress(warmup + done, warmup + total, entry)),
    )  # fmt: skip
    training.before_step(fit_config.iterations)
    return MethodResult(
        gaussians=result.gaussians,
        enhanced=enhanced,
        targets=training.denoiser.denoise_all(),
        losses=result.losses,
        seconds={"enhance": enhancing, "denoise": training.seconds, "fit": result.seconds},
        config=dataclasses.asdict(config),
    )
