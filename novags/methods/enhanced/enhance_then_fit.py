"""Enhance every view, then fit Gaussians to the result, noise and all.

This is the published baseline (`naive`), and with the enhancers of others every "2D enhancer + GS" of the paper: the
same pictures, cameras, loss, iterations and number of Gaussians, so that the enhancement alone makes the difference.
"""

import dataclasses
import time
from pathlib import Path

from torch import Tensor, nn

from novags.methods.enhanced.by_enhancer import learning_steps, weights_of
from novags.methods.enhanced.config import EnhancedFitConfig
from novags.methods.enhanced.gaussian_fit import fit_enhanced
from novags.methods.enhancers import enhancement_record, network_of
from novags.methods.enhancers.applying import enhanced, settled
from novags.methods.enhancers.choice import Enhancement
from novags.methods.enhancers.enhancer import NETWORK
from novags.methods.enhancers.networks.kind import Kind, described
from novags.methods.enhancers.networks.rehearsal import learned
from novags.methods.inputs import Pictures
from novags.methods.problem import Problem, gathered
from novags.methods.reconstruction import Progress, Reconstruction, counted_on


def train(
    problem: Problem, config: EnhancedFitConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct from the enhanced noisy pictures; see `fit_enhanced`.

    An enhancing network comes from the files that the configuration names; without, it learns from the noisy pictures
    of the problem, and its state is kept beside the checkpoint, in `<stem>.enhancer.safetensors`.

    Returns:
        A reconstruction whose targets are the enhanced pictures. Seconds: "learn" of a network, "enhance" and "fit".

    Raises:
        LacksInput: If the network needs weights and none are named.
        ValueError: If weights or a checkpoint are damaged, or belong to something else.
    """
    kind: Kind | None = network_of(config.enhance)
    config = dataclasses.replace(config, enhance=settled(problem, config.enhance, config.pictures))
    if kind is None:
        return fit_enhanced(problem, config, enhanced, progress, checkpoint)
    return _with_network(kind, problem, config, progress, checkpoint)


def _with_network(
    kind: Kind, problem: Problem, config: EnhancedFitConfig, progress: Progress | None, checkpoint: Path | None
) -> Reconstruction:
    started, steps, files = time.perf_counter(), learning_steps(kind, config), weights_of(config)
    network, earlier = _network(kind, problem, config, progress, checkpoint)
    learning = earlier + time.perf_counter() - started

    def through(problem: Problem, enhance: Enhancement, pictures: Pictures) -> Tensor:
        dark = problem.encoded(pictures)
        return gathered((kind.picture(network, view, enhance)[0] for view in dark), dark)

    result = fit_enhanced(problem, config, through, counted_on(progress, steps), checkpoint)
    record = enhancement_record(config.enhance, config.pictures)
    result.enhancement = {**record, "config": {**record["config"], "weights": [NETWORK]}}
    # Cloned: a block that is applied several times is one tensor under several names, which no file may hold.
    result.network = {name: value.cpu().clone() for name, value in network.state_dict().items()}
    result.found = {"enhancer": {"learned_steps": steps} if kind.rehearsal and not files else described(files)}
    result.seconds = {"learn": learning, **result.seconds}
    return result


def _network(
    kind: Kind, problem: Problem, config: EnhancedFitConfig, progress: Progress | None, checkpoint: Path | None
) -> tuple[nn.Module, float]:
    """The network, and the seconds that stopped runs before this one have spent on it."""
    if kind.rehearsal is None or weights_of(config):
        return kind.load(config.enhance), 0.0
    path = None if checkpoint is None else checkpoint.with_name(f"{checkpoint.stem}.enhancer.safetensors")
    return learned(
        kind, config.enhance, problem.encoded(config.pictures), problem.seed,
        progress=progress, more=config.fit.iterations, checkpoint=path,
    )  # fmt: skip
