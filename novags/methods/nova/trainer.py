"""NOVA-GS as a whole: enhance, denoise, and fit with L_total = L_recon + L_geo + L_SH (paper, section 4.7)."""

import dataclasses
import hashlib
import json
import time
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from novags.methods.enhanced.gaussian_fit import fit_for
from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.applying import enhanced
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.nova.checkpoint import file_as_tensor, tensor_as_file
from novags.methods.nova.config import NovaConfig, parts
from novags.methods.nova.consistency import ConsistencyLoss
from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.sh_penalty import noise_map, penalty_weights
from novags.methods.problem import Problem
from novags.methods.reconstruction import Progress, Reconstruction
from novags.methods.start import start_gaussians
from novags.process import give_back
from novags.splats.files.tensors import digest, read, write_tensors
from novags.splats.gaussians import Gaussians
from novags.splats.training.fit import LOG_EVERY, fit
from novags.splats.training.flags import Flags, tell
from novags.splats.training.guard import NotFinite
from novags.splats.training.step import HarmonicsPenalty, Step
from sensor_model.files.reading import reading

SAVE_INTERVAL = 60.0  # s between two checkpoints of the warm-up: its steps take from milliseconds to many seconds


class _PseudoClean:
    """The denoised image of each view, computed on demand and kept until the denoiser has trained further."""

    def __init__(self, enhanced: Tensor, denoiser: Denoiser | None, config: NovaConfig) -> None:
        self.enhanced, self.denoiser, self.config = enhanced, denoiser, config
        self.images = enhanced if denoiser is None else torch.empty_like(enhanced)
        self.steps: dict[int, int] = {}  # of the denoiser, when it made the image of a view

    def __call__(self, view: int) -> Tensor:
        """[H, W, 3] without gradient; without a denoiser the enhanced picture itself."""
        return self._not_older(view, self.config.refresh_after)

    def all_now(self) -> Tensor:
        """[C, H, W, 3] by the denoiser in its present state."""
        for view in range(len(self.images)):
            self._not_older(view, 1)
        return self.images

    def _not_older(self, view: int, age: int) -> Tensor:
        """The image of a view, made anew if the denoiser has done so many steps since, or more."""
        if self.denoiser is not None and (view not in self.steps or self.denoiser.step - self.steps[view] >= age):
            if self.config.refresh_after == 1 and self.steps and self.denoiser.step not in self.steps.values():
                self.let_go()  # none of them will be used again
            with torch.no_grad():
                # Past autograd, which would refuse a graph that holds the image of another view. No graph holds an
                # image that is made anew: that is done before its first use in an iteration.
                self.images.data[view] = self.denoiser.denoise(view)
            self.steps[view] = self.denoiser.step
        return self.images[view]

    def let_go(self) -> None:
        """Give the memory of all images back; they are made anew when they are asked for.

        On a CPU an image takes memory once it is written: half a gigabyte of 43 views of 1 Mpx.
        """
        if self.denoiser is not None:
            self.steps.clear()
            del self.images
            self.images = torch.empty_like(self.enhanced)

    def target(self, view: int) -> Tensor:
        """[H, W, 3], with gradient into the denoiser if it takes part in L_recon."""
        if self.denoiser is None or self.config.detach_target:
            return self(view)
        return self.denoiser.denoise(view)

    def state(self) -> dict[str, Tensor]:
        """The images that the denoiser in its present state might not reproduce, by view and denoiser step."""
        if self.config.refresh_after == 1:
            return {}
        return {f"clean.{view}.{step}": self.images[view] for view, step in self.steps.items()}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state`."""
        for name, image in tensors.items():
            if name.startswith("clean."):
                view, step = map(int, name.split(".")[1:])
                if not 0 <= view < len(self.enhanced) or image.shape != self.enhanced[view].shape:
                    raise ValueError(f"{name} does not fit any view: delete it, the run then starts over")
                self.images[view], self.steps[view] = image.to(self.enhanced), step


def run_identity(problem: Problem, config: NovaConfig) -> Tensor:
    """Hash of everything that a run depends on, uint8."""
    start, dark = problem.start, problem.encoded(config.pictures)
    content = digest(problem.views.viewmats, problem.views.Ks, dark, start.points, start.colors)
    settings = json.dumps([dataclasses.asdict(config), problem.seed, start.extent], sort_keys=True, default=str)
    run = hashlib.blake2b((content + settings).encode(), digest_size=16)
    return torch.tensor(list(run.digest()), dtype=torch.uint8)


class _Training:
    """Denoiser, confidence network and their schedule beside the splat iterations.

    Their state is saved together with the fit's checkpoint, in one file: with two files, an interruption between the
    writes would pair networks and splats of different iterations.
    """

    def __init__(self, problem: Problem, enhanced: Tensor, config: NovaConfig, checkpoint: Path | None) -> None:
        iterations = config.fit.iterations
        self.config, self.enhanced = config, enhanced
        self.flags = Flags.on(enhanced.device)
        self.sizes: dict[str, float] = {}  # of the networks, as they were read on a GPU
        self.denoiser: Denoiser | None = None
        if config.denoiser is not None:
            total = config.denoiser.total_steps(iterations)
            cfa = None if problem.raw is None else problem.raw.cfa
            self.denoiser = Denoiser(
                enhanced, config.denoiser, total_steps=total, seed=problem.seed, cfa=cfa, flags=self.flags
            )
        self.clean = _PseudoClean(enhanced, self.denoiser, config)
        self.noise: dict[int, tuple[int, Tensor]] = {}  # view -> noise map, and the step that its image was made at
        self.geo: ConsistencyLoss | None = None
        if config.consistency is not None and config.consistency.weight > 0:
            noisy = config.consistency.warped == "enhanced"
            self.geo = ConsistencyLoss(
                problem.views, enhanced.__getitem__ if noisy else self.clean, config.consistency,
                iterations=iterations, seed=problem.seed, flags=self.flags,
            )  # fmt: skip
        self.run = run_identity(problem, config)
        self.start: Gaussians | None = None
        self.stepping = False  # networks are between two splat iterations
        self.seconds = 0.0  # before the splats start, in interrupted attempts too
        self.fit_path = checkpoint
        self.path = None if checkpoint is None else checkpoint.with_name(f"{checkpoint.stem}.denoiser.safetensors")
        if self.path is not None and self.path.exists():
            with reading(self.path, "delete it, the run then starts over"):
                self._restore(read(self.path))
        elif checkpoint is not None and checkpoint.exists():
            raise ValueError(f"{checkpoint} lacks the networks that belong to it: delete it, the run then starts over")

    @property
    def learns_on(self) -> bool:
        """Whether the denoiser learns beside the fit too."""
        return self.config.denoiser is not None and self.config.denoiser.denoise_every is not None

    def warm_up(self, problem: Problem, progress: Progress | None) -> Gaussians:
        """Train the denoiser alone, then make the Gaussians that the splats start from, coloured by it."""
        if self.start is not None:
            return self.start
        started = time.perf_counter() - self.seconds
        if self.denoiser is not None:
            self._train_denoiser(self.denoiser, started, progress)
        clean = self.clean.all_now()
        give_back()  # of the network's maps, before all pictures are read once more
        sh_degree, init_scale = self.config.fit.sh_degree, self.config.init_scale
        dark = problem.encoded(self.config.pictures)
        self.start = start_gaussians(problem.start, dark, clean, sh_degree=sh_degree, init_scale=init_scale)
        if self.learns_on and self.config.refresh_after == 1:
            del clean
            self.clean.let_go()  # before the network's next step, after which none of them will be used again
        self.seconds = time.perf_counter() - started
        self.save()
        return self.start

    def _train_denoiser(self, denoiser: Denoiser, started: float, progress: Progress | None) -> None:
        steps, saved = denoiser.config.warmup_steps, time.perf_counter()

        def report(step: int, loss: float) -> None:
            if progress is not None:
                progress(step, steps + self.config.fit.iterations, {"denoiser": loss})

        while denoiser.step < steps:
            try:
                loss = denoiser.train_step()
                self.seconds = time.perf_counter() - started
                if time.perf_counter() - saved > SAVE_INTERVAL:
                    self.save()
                    saved = time.perf_counter()
                tell(self.flags, denoiser.step, steps, loss, partial(report, denoiser.step))
            except NotFinite as stop:
                if self.path is None:
                    raise
                self.save_stopped(stop)
                raise NotFinite(f"{stop}; {self.path} leads there again", resumable=stop.resumable) from None

    def before_step(self, iteration: int) -> None:
        """Bring both networks up to a splat iteration, then save if the fit has just saved."""
        self.stepping = True
        if self.geo is not None:
            self.geo.update()
        denoiser = self.denoiser
        if denoiser is not None and denoiser.step < denoiser.config.total_steps(iteration):
            denoiser.train_step()
        self.stepping = False
        if self.flags is not None and iteration % LOG_EVERY == LOG_EVERY - 1:
            norms = self.norms()
            self.flags.keep(torch.stack(list(norms.values())), partial(self._read, list(norms)))
        fit = self.config.fit
        if iteration and (iteration % fit.checkpoint_every == 0 or iteration == fit.iterations):
            self.save()

    def save_stopped(self, stop: NotFinite) -> None:
        """Save the state of the networks before the step that stopped, if the splats are saved in that state too.

        On a GPU they have gone on when a fault is known: the last that was saved leads there again.
        """
        if not stop.resumable or self.flags is not None:
            return
        if not self.stepping:  # gradients of this iteration's backward pass would count twice when it is done again
            for part in (self.geo, self.denoiser):
                if part is not None:
                    part.optimizer.zero_grad(set_to_none=True)
        self.save()

    def norms(self) -> dict[str, Tensor]:
        """Norm of the weights of each network, scalars."""
        networks = {"denoiser": self.denoiser, "confidence": self.geo}
        sums = {
            name: [p.detach().square().sum().double() for p in part.network.parameters()]
            for name, part in networks.items() if part is not None
        }  # fmt: skip
        return {f"norm_{name}": torch.stack(each).sum().sqrt() for name, each in sums.items()}

    def _read(self, names: list[str], numbers: list[float]) -> None:
        self.sizes = dict(zip(names, numbers, strict=True))

    def noise_weights(self, step: Step) -> Tensor:
        """The weights of this iteration's L_SH."""
        clean = self.clean(step.view)
        made, known = self.clean.steps[step.view], self.noise.get(step.view)
        if known is None or known[0] != made:
            if self.learns_on:
                self.noise.clear()  # a view's image is another one when it is visited again
            known = self.noise[step.view] = (made, noise_map(self.enhanced[step.view], clean))
        assert self.config.sh_weight is not None
        return self.config.sh_weight * penalty_weights(step.info["means2d"][0].detach(), step.visible, known[1])

    def save(self) -> None:
        """Write everything that the next iteration depends on, the fit's checkpoint included."""
        if self.path is None or self.fit_path is None:
            return
        if self.flags is not None:
            self.flags.read()
        tensors = self.clean.state() | (self.geo.state() if self.geo is not None else {})
        if self.denoiser is not None:
            tensors |= self.denoiser.state()
        tensors["run"] = self.run
        tensors["seconds"] = torch.tensor(self.seconds, dtype=torch.float64)
        if self.start is not None:
            tensors |= {f"start.{name}": tensor for name, tensor in self.start.tensors().items()}
        if self.fit_path.exists():
            tensors["fit"] = file_as_tensor(self.fit_path)
        write_tensors(self.path, tensors)

    def _restore(self, tensors: dict[str, Tensor]) -> None:
        run = tensors.get("run", torch.empty(0))
        if run.dtype != self.run.dtype or not torch.equal(run, self.run):
            raise ValueError(f"{self.path} belongs to a run of other images or settings: delete it or restore them")
        if self.denoiser is not None:
            self.denoiser.restore(tensors)
        self.clean.restore(tensors)
        if self.geo is not None:
            self.geo.restore(tensors)
        self.seconds = float(tensors["seconds"])
        if not 0 <= self.seconds < float("inf"):
            raise ValueError(f"{self.path} states {self.seconds} s: delete it, the run then starts over")
        device = self.enhanced.device
        start = {name.removeprefix("start."): t.to(device) for name, t in tensors.items() if name.startswith("start.")}
        self.start = Gaussians(**start) if start else None
        assert self.fit_path is not None
        if "fit" in tensors:
            tensor_as_file(tensors["fit"], self.fit_path)
        else:  # the fit's first checkpoint may be there, but without the networks of that moment
            self.fit_path.unlink(missing_ok=True)


def suited(config: NovaConfig, problem: Problem) -> NovaConfig:
    """The configuration with `packed` and `per_channel` decided for the pictures of this problem.

    Raises:
        ValueError: If channels are to be blinded one by one, but their noise is not independent; if mosaics are to be
            blinded, but the pictures were not made from mosaics, or L_recon is to reach the denoiser through the
            demosaicing.
    """
    if config.denoiser is None:
        return config
    spots, shared = config.denoiser.blind_spots, problem.channels_share
    mosaics = problem.raw is not None and problem.raw.cfa is not None and shared == ("demosaicing",)
    if spots.packed and not mosaics:
        raise ValueError(
            "denoiser.blind_spots.packed needs pictures that were demosaiced from a known colour filter array, and not "
            f"changed further, and here {_reason(problem)}: set it to none (decided for the pictures) or false"
        )
    packed = mosaics and config.detach_target if spots.packed is None else spots.packed
    if packed and not config.detach_target:
        raise ValueError(
            "denoiser.blind_spots.packed has no gradient through its demosaicing: leave detach_target True, or set it "
            "to false"
        )
    if spots.per_channel and shared and not packed:
        raise ValueError(
            "denoiser.blind_spots.per_channel needs channels with independent noise, and here they share it through "
            f"{' and '.join(shared)}: a blinded channel could be inferred from the others. Set it to none (decided for "
            "the pictures) or false"
        )
    per_channel = (packed or not shared) if spots.per_channel is None else spots.per_channel
    spots = dataclasses.replace(spots, per_channel=per_channel, packed=packed)
    return dataclasses.replace(config, denoiser=dataclasses.replace(config.denoiser, blind_spots=spots))


def _reason(problem: Problem) -> str:
    """Why the pictures hold no mosaic."""
    if further := [share for share in problem.channels_share if share != "demosaicing"]:
        return f"{' and '.join(further)} changed them"
    return "the camera has none" if problem.raw is not None else "it is unknown without raw frames"


def train(
    problem: Problem,
    config: NovaConfig,
    *,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
) -> Reconstruction:
    """Reconstruct a scene from noisy dark views.

    Args:
        problem: The problem; its seed and extent override `config.fit`.
        config: All choices.
        progress: Called with (steps done, of how many, losses); denoiser warm-up and splat iterations count alike.
        checkpoint: The fit's checkpoint file. Everything that a run continues from is stored beside it, in
            `<stem>.denoiser.safetensors`, with a copy of the fit's. If that file exists, the run continues.

    Returns:
        A reconstruction; `targets` are the denoised images. Seconds: "enhance", "denoise" (warm-up), "fit" (with the
        concurrent denoiser steps), the latter two including interrupted attempts.

    Raises:
        ValueError: If a checkpoint is damaged or belongs to another run, or the configuration does not suit the
            pictures.
        NotFinite: As `fit` says, and for the networks; checkpoints then hold networks and splats before that step.
    """
    config = suited(dataclasses.replace(config, fit=fit_for(problem, config.fit)), problem)
    started = time.perf_counter()
    images = enhanced(problem, config.enhance, config.pictures)
    enhancing = time.perf_counter() - started
    training = _Training(problem, images, config, checkpoint)
    start = training.warm_up(problem, progress)
    warmup = parts(config)["denoiser"]

    def report(done: int, total: int, entry: dict[str, float]) -> None:
        if progress is not None:
            sizes = training.sizes if training.flags else {k: float(v) for k, v in training.norms().items()}
            progress(warmup + done, warmup + total, entry | sizes)

    penalty = None if config.sh_weight is None else HarmonicsPenalty(training.noise_weights)
    try:
        result = fit(
            start, problem.views, training.clean.target, config.fit,
            extra_losses=[loss for loss in (training.geo, penalty) if loss is not None],
            before_step=training.before_step, needs_depth=training.geo.due if training.geo else False,
            checkpoint=checkpoint, progress=progress and report, flags=training.flags,
        )  # fmt: skip
        training.before_step(config.fit.iterations)
        if training.flags is not None:
            training.flags.read()
    except NotFinite as stop:
        training.save_stopped(stop)
        raise
    scene = GaussianScene.of(result.gaussians, config.fit)
    return Reconstruction(
        scene=scene,
        along=scene.along(result.kept),
        space="enhanced",
        config=config,
        enhancement=enhancement_record(config.enhance, config.pictures),
        enhanced=images,
        targets=training.clean.all_now(),
        viewmats=None if config.fit.refine_cameras is None else result.viewmats,
        losses=result.losses,
        seconds={"enhance": enhancing, "denoise": training.seconds, "fit": result.seconds},
        found={} if training.geo is None else {"consistency": training.geo.facts()},
    )
