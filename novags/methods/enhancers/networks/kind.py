"""The common part of all enhancing networks: where their weights come from, and how a picture goes through one.

The configuration of each is a frozen dataclass with `weights`, files or None.

A network is the same function for every picture. It has no parameters of a picture, so a noise-free exposure goes
through it unchanged: the difference from its noisy twin's result is then due to the noise alone, wherever in the
network. Only later steps of a method may have parameters of a picture.
"""

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import Adam

from novags.methods.enhancers.enhancer import stamps
from novags.methods.enhancers.files.weights import digest_of, fill, read_weights
from novags.methods.enhancers.pictures import check_picture
from novags.methods.inputs import LacksInput

_HELD: OrderedDict[Any, nn.Module] = OrderedDict()
HELD = 4  # networks that are kept in memory; a file is read once for all views


@dataclass(frozen=True)
class Rehearsal:
    """How a network learns from the dark pictures of a scene alone.

    Attributes:
        loss: (network, pictures [B, 3, H, W], config) -> loss.
        steps: Of the configuration: how many.
        optimizer: (network, config) -> Adam.
        clip: Largest norm of a gradient.
        batch: Of the configuration: crops per step, and their edge in px.
    """

    loss: Callable[[nn.Module, Tensor, Any], Tensor]
    steps: Callable[[Any], int]
    optimizer: Callable[[nn.Module, Any], Adam]
    clip: float
    batch: Callable[[Any], tuple[int, int]]


@dataclass(frozen=True)
class Kind:
    """A kind of network.

    Attributes:
        name: For people.
        make: (config) -> a network, its weights as at the start of a training.
        run: (network, picture [1, 3, H, W], config) -> enhanced picture, the same shape.
        finish: (that, config, params or None) -> the picture after the method's last steps, and its parameters.
        renamed: Names of official tensors -> names of the network's own.
        rehearsal: How it learns from a scene; None: it cannot.
        where: Where to get weights, for users who have none.
    """

    name: str
    make: Callable[[Any], nn.Module]
    run: Callable[[nn.Module, Tensor, Any], Tensor]
    renamed: Callable[[Mapping[str, Tensor]], Mapping[str, Tensor]] = lambda tensors: tensors
    finish: Callable[[Tensor, Any, Any], tuple[Tensor, Any]] = lambda bright, config, params: (bright, None)
    rehearsal: Rehearsal | None = None
    where: str = "the authors' file, or another of the same network, trained here"

    def load(self, config: Any) -> nn.Module:
        """The network with the weights that the configuration names, ready to enhance.

        Raises:
            LacksInput: If it names none.
            ValueError: If a file is missing or damaged, or holds another network's weights.
        """
        self.refuse_without_weights(config)
        key = (self.name, config, stamps(config))
        if key not in _HELD:
            network = self.make(config)
            fill(network, self.renamed(read_weights(config.weights)), config.weights)
            _HELD[key] = network.eval().requires_grad_(False)
            while len(_HELD) > HELD:
                _HELD.popitem(last=False)
        _HELD.move_to_end(key)
        return _HELD[key]

    def refuse_without_weights(self, config: Any) -> None:
        """Raise LacksInput for a configuration that names no weights."""
        if not config.weights:
            how = ", or train it on the scene (a method with this enhancer does)" if self.rehearsal else ""
            raise LacksInput(f"{self.name} has no weights: set enhance.weights to {self.where}{how}")

    def picture(self, network: nn.Module, dark: Tensor, config: Any, params: Any = None) -> tuple[Tensor, Any]:
        """One picture [H, W, 3] through the network, in 0..1, and the parameters of the last steps."""
        check_picture(dark)
        network.to(dark.device)
        with torch.no_grad():
            bright = self.run(network, dark.float().movedim(-1, 0)[None], config)
            bright, params = self.finish(bright, config, params)
        return bright[0].movedim(0, -1).clamp(0, 1).to(dark.dtype).contiguous(), params

    def enhance(self, dark: Tensor, config: Any, params: Any, noise: Any) -> tuple[Tensor, Any]:
        """As `Enhancer.enhance`."""
        return self.picture(self.load(config), dark, config, params)


def no_params(params: Sequence[None]) -> None:
    """`Enhancer.typical` of networks."""


def described(weights: Sequence[Path]) -> dict[str, Any]:
    """A run's record of files of weights: their names and the digest of their content."""
    return {"files": [path.name for path in weights], "digest": digest_of(weights)}


def crops(pictures: Tensor, count: int, size: int, rng: np.random.Generator) -> Tensor:
    """Random crops [count, 3, s, s] of pictures [C, H, W, 3]; s is `size`, or the shorter side."""
    views, height, width = pictures.shape[:3]
    side = min(size, height, width)
    cut = []
    for _ in range(count):
        view, top, left = (int(rng.integers(n)) for n in (views, height - side + 1, width - side + 1))
        cut.append(pictures[view, top : top + side, left : left + side])
    return torch.stack(cut).movedim(-1, 1).contiguous()
