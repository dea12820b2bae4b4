"""ST-LPIPS, a learned perceptual distance whose weights come in a package: Ghildyal and Liu, ECCV 2022 (2207.13686).

It is not LPIPS: its networks were trained anew, with a blur before each subsampling, so that a shift by a pixel hardly
counts. Figures of LPIPS cannot be compared with it. Of the package `stlpips_pytorch` only the weights are read.
"""

from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from novags.testbed.metrics.metric import Metric
from novags.testbed.metrics.picture import Image
from sensor_model.files.door import admitted

if TYPE_CHECKING:
    from torch import Tensor

PACKAGE = "stlpips_pytorch"
WEIGHTS = Path("weights") / "vST0.0" / "alex_shift_tolerant.pth"
SMALLEST = 21  # px; of a shorter side the third blur has nothing to reflect
HOW_TO_GET = "pip install 'novags[st-lpips]'"
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # of the input, -1..1, by channel
# Convolutions by their names among the weights, with their padding; those after which a maximum and a blur follow.
LAYERS, PADDING, POOLED = ("slice1.0", "slice2.5", "slice3.9", "slice4.11", "slice5.13"), (2, 2, 1, 1, 1), (0, 1)
NO_FEATURES = 1e-10  # added to the length of features over channels: where all are 0 it would be divided by


def st_lpips(image: Image, reference: Image) -> float:
    """Perceptual distance with the AlexNet form, 0 for equal images; equation 1 of LPIPS with ST-LPIPS's network.

    Args:
        image: [h, w, 3], sRGB code in 0..1.
        reference: The same.

    Raises:
        ValueError: If images are smaller than `SMALLEST`, or the package is missing: the message says how to get it.
    """
    if (why := missing(image.shape[1], image.shape[0])) is not None:
        raise ValueError(why)
    import torch

    with torch.no_grad():
        pair = [
            torch.from_numpy(np.ascontiguousarray(x.transpose(2, 0, 1)[None], np.float32)) for x in (image, reference)
        ]
        weights = network()
        distance = 0.0
        for k, (one, other) in enumerate(zip(*(features(x, weights) for x in pair), strict=True)):
            squared = (_normal(one) - _normal(other)).square()
            distance += float((squared * weights[f"lin{k}.model.1.weight"]).sum(1).mean())
        return distance


def features(code: "Tensor", weights: "dict[str, Tensor]") -> "list[Tensor]":
    """Features [1, channels, h, w] of each of the five layers, of a picture [1, 3, h, w] in 0..1."""
    import torch
    from torch.nn.functional import conv2d, max_pool2d

    x = (2 * code - 1 - torch.tensor(SHIFT)[:, None, None]) / torch.tensor(SCALE)[:, None, None]
    found = []
    for k, (layer, padding) in enumerate(zip(LAYERS, PADDING, strict=True)):
        x = conv2d(x, weights[f"net.{layer}.weight"], weights[f"net.{layer}.bias"], padding=padding)
        x = (_halved(x) if k == 0 else x).relu()
        found.append(x)
        x = _halved(max_pool2d(x, 3, 1)) if k in POOLED else x
    return found


def _halved(x: "Tensor") -> "Tensor":
    """Every second pixel of a picture blurred by [1 2 1] along both sides."""
    import torch
    from torch.nn.functional import conv2d, pad

    line = torch.tensor([1.0, 2.0, 1.0]) / 4
    kernel = torch.outer(line, line).expand(x.shape[1], 1, 3, 3)
    return conv2d(pad(x, (2, 2, 2, 2), mode="reflect"), kernel, stride=2, groups=x.shape[1])


def _normal(x: "Tensor") -> "Tensor":
    """Features divided by their length over the channels."""
    return x / (x.square().sum(1, keepdim=True).sqrt() + NO_FEATURES)


@cache
def network() -> "dict[str, Tensor]":
    """The weights by name, loaded once.

    Raises:
        ValueError: If the file is not the one of `PACKAGE` 0.0.2.
    """
    import torch

    path = _weights()
    assert path is not None  # `missing` was asked
    found = torch.load(admitted(path), map_location="cpu", weights_only=True)
    wanted = [f"net.{layer}.{kind}" for layer in LAYERS for kind in ("weight", "bias")]
    wanted += [f"lin{k}.model.1.weight" for k in range(len(LAYERS))]
    if lacking := [name for name in wanted if name not in found]:
        raise ValueError(f"{path} must hold the weights of ST-LPIPS (AlexNet form), {lacking[0]} is not there: install "
                         f"{PACKAGE} 0.0.2")  # fmt: skip
    return {name: found[name] for name in wanted}


def missing(width: int | None = None, height: int | None = None) -> str | None:
    """Why it cannot be computed here, of images of a size if one is given, and how to get it; None if it can."""
    if width is not None and height is not None and min(width, height) < SMALLEST:
        return f"ST-LPIPS needs images of at least {SMALLEST} x {SMALLEST} pixels, got {width} x {height}"
    return None if _weights() is not None else f"the package {PACKAGE} is not installed; {HOW_TO_GET}"


def _weights() -> Path | None:
    spec = find_spec(PACKAGE)
    for folder in (spec and spec.submodule_search_locations) or ():
        if (Path(folder) / WEIGHTS).is_file():
            return Path(folder) / WEIGHTS
    return None


ST_LPIPS = Metric(heading="ST-LPIPS", score=st_lpips, more=False, missing=missing)
