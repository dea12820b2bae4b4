"""LPIPS, the perceptual distance of a learned network, where its package and weights are on the machine."""

from functools import cache
from typing import Any

import numpy as np

from novags.testbed.metrics.metric import Metric
from novags.testbed.metrics.picture import Image

SMALLEST = 31  # px; of a shorter side the second pooling of AlexNet leaves nothing
HOW_TO_GET = (
    "pip install 'novags[lpips]' and, once with network access, run: "
    "python -c \"import lpips; lpips.LPIPS(net='alex')\""
)


def lpips(image: Image, reference: Image) -> float:
    """Perceptual distance with the AlexNet backbone, 0 for equal images; nothing is ever downloaded.

    Raises:
        ValueError: If the images are smaller than `SMALLEST`, or the package or its weights are missing; the message
            says how to get them.
    """
    height, width = image.shape[:2]
    if min(height, width) < SMALLEST:
        raise ValueError(missing(width, height))
    import torch

    a, b = (torch.from_numpy(x.transpose(2, 0, 1)[None].astype(np.float32) * 2 - 1) for x in (image, reference))
    with torch.no_grad():
        return float(network()(a, b))


@cache
def network() -> Any:
    """The network, loaded once.

    Raises:
        ValueError: If the package or its weights are missing.
    """
    if (why := missing()) is not None:
        raise ValueError(why)
    import lpips

    return lpips.LPIPS(net="alex", verbose=False).eval()


def missing(width: int | None = None, height: int | None = None) -> str | None:
    """Why LPIPS cannot be computed here, of images of a size if one is given, and how to get it; None if it can."""
    from importlib.util import find_spec
    from pathlib import Path

    if width is not None and height is not None and min(width, height) < SMALLEST:
        return f"LPIPS needs images of at least {SMALLEST} x {SMALLEST} pixels, got {width} x {height}"
    if find_spec("lpips") is None:
        return f"the lpips package is not installed; {HOW_TO_GET}"
    import torch

    if not list(Path(torch.hub.get_dir(), "checkpoints").glob("alexnet-*.pth")):
        return f"the AlexNet weights are not on this machine; {HOW_TO_GET}"
    return None


LPIPS = Metric(heading="LPIPS", score=lpips, more=False, missing=missing)
