"""One method, trained on the virtual GPU and on the CPU, from the same random numbers.

What a CPU does differently by design is made the same: the noise that moves Gaussians comes from a generator instead of
a kernel's counter, places of crops from a stream of their own, blind spots are filled from as many draws, layers are
torch's own, and Gaussians are rendered by the readable rasteriser, as gsplat's stand-in does. All that is left are
other roundings.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest
import torch

from novags.methods import METHODS, chosen
from novags.methods.denoised.recorrupted import Adaptation
from novags.methods.enhancers.networks import rehearsal
from novags.methods.nova import denoiser as denoising
from novags.methods.nova.blindspot import replaced_everywhere
from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.resunet import Convolution, InstanceNorm
from novags.methods.problem import Problem
from novags.methods.reconstruction import Reconstruction
from novags.settings import has_setting
from novags.splats.raster import raster_gsplat
from novags.splats.training import fit as loop
from novags.splats.training.config import CameraRefinement
from novags.splats.training.updates.mcmc import _add_noise_torch
from tests.novags.gpu.stand_in import rasterization
from tests.novags.gpu.virtual import WAITED, virtual_gpu

ITERATIONS = 24
SHORT: dict[str, Any] = {
    "init_scale": 0.7, "fit.iterations": ITERATIONS, "fit.sh_degree": 1, "fit.sh_every": 3, "fit.mcmc.refine_start": 1,
    "fit.mcmc.refine_every": 12, "fit.mcmc.refine_stop": ITERATIONS, "denoiser.warmup_steps": ITERATIONS,
    "denoiser.network.widths": (8, 16), "denoiser.network.bottleneck": 16, "consistency.start": 0.2,
    "denoise.adapt.steps": ITERATIONS, "denoise.adapt.batch": 2, "enhance.steps": ITERATIONS, "seeds": 2,
    "fit.rays": 64, "pretrain.steps": ITERATIONS,
}  # fmt: skip
LOOPS = {"fit": (loop, "backpropagate"), "denoiser": (Denoiser, "train_step"), "adaptation": (Adaptation, "advance"),
         "enhancer": (rehearsal, "crops")}  # fmt: skip


def short(name: str, refine: bool = False, **more: Any) -> tuple[str, Any]:
    """A method and a configuration of it that is over in a moment, of a name of `novags list methods`."""
    variant = chosen(name)
    base = METHODS[variant.method].config()
    config = variant.config(base, {key: value for key, value in (SHORT | more).items() if has_setting(base, key)})
    if refine:
        config = dataclasses.replace(
            config, fit=dataclasses.replace(config.fit, refine_cameras=CameraRefinement(start=5, pull=0.1))
        )
    return variant.method, config


class Waiting:
    """Counts of `WAITED` at the beginning of every step of every loop."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.laps: dict[str, list[list[int]]] = {}
        for name, (owner, step) in LOOPS.items():
            patch.setattr(owner, step, self._counted(name, getattr(owner, step)))
        patch.setattr(loop, "_initial_state", self._begun("fit", loop._initial_state))

    def _begun(self, name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        def begun(*arguments: Any, **options: Any) -> Any:
            for each in LOOPS:  # the denoiser goes on beside it
                self.laps.setdefault(each, []).append([])
            return original(*arguments, **options)

        return begun

    def _counted(self, name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        def counted(*arguments: Any, **options: Any) -> Any:
            self.laps.setdefault(name, [[]])[-1].append(sum(WAITED.values()))
            return original(*arguments, **options)

        return counted

    def per_step(self) -> dict[str, float]:
        """Waits from the first to the last step of each loop, over the number of steps; of several fits, the most.

        Of a denoiser before the fit alone: beside it its waits are those of the fit.
        """
        found: dict[str, float] = {}
        for name, runs in self.laps.items():
            shares = [(laps[-1] - laps[0]) / (len(laps) - 1) for laps in runs if len(laps) > 1]
            if shares:
                found[name] = max(shares) if name == "fit" else shares[0]
        return found


def on_gpu(
    name: str, config: Any, problem: Problem, patch: pytest.MonkeyPatch
) -> tuple[Reconstruction, dict[str, float], list[torch.Tensor]]:
    """A reconstruction on the virtual GPU, waits per step of each loop, and what it renders, brought back."""
    with patch.context() as here, virtual_gpu():
        here.setattr(raster_gsplat, "rasterization", rasterization)
        waiting = Waiting(here)
        found = METHODS[name].train(problem.to("cuda"), config)
        shown = found.render(problem.views.to("cuda"))
        assert {x.device.type for x in shown} == {"cuda"}
        if found.viewmats is not None:
            found.viewmats = found.viewmats.cpu()
        return found, waiting.per_step(), [x.cpu() for x in shown]


def on_cpu(
    name: str, config: Any, problem: Problem, patch: pytest.MonkeyPatch
) -> tuple[Reconstruction, list[torch.Tensor]]:
    """The same on the CPU, with the same random numbers."""
    if has_setting(config, "fit.backend"):
        config = dataclasses.replace(config, fit=dataclasses.replace(config.fit, backend="torch"))
    with patch.context() as here:

        def add_noise(g: Any, amount: float, generator: torch.Generator, *, limit: float, good: None) -> None:
            _add_noise_torch(g, amount, generator, limit)

        here.setattr(loop, "add_noise", add_noise)
        here.setattr(InstanceNorm, "forward", InstanceNorm.plain)
        here.setattr(Convolution, "forward", Convolution.plain)
        here.setattr(denoising, "replace_masked", replaced_everywhere)
        for kind in (Denoiser, Adaptation):
            here.setattr(kind, "__init__", _with_own_places(kind.__init__))
        found = METHODS[name].train(problem, config)
        return found, list(found.render(problem.views))


def _with_own_places(original: Callable[..., None]) -> Callable[..., None]:
    def made(self: Any, *arguments: Any, **options: Any) -> None:
        original(self, *arguments, **options)
        self.places = torch.Generator().manual_seed(self.generator.initial_seed())

    return made
