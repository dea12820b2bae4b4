"""LPIPS, the perceptual distance of a learned network, where its package and weights are on the machine."""

import numpy as np

from novags.testbed.metrics.picture import Image


class PerceptualDistance:
    """LPIPS with the AlexNet backbone, if package and weights are on the machine; it never downloads."""

    SMALLEST = 31  # px; of a shorter side the second pooling of AlexNet leaves nothing
    HOW_TO_GET = (
        "install the extra (scripts/setup lpips) and, once with network access, run: "
        "python -c \"import lpips; lpips.LPIPS(net='alex')\""
    )

    def __init__(self) -> None:
        """Load the network.

        Raises:
            ValueError: If the package or its weights are missing; the message says how to get them.
        """
        if (missing := self.missing()) is not None:
            raise ValueError(missing)
        import lpips

        self._network = lpips.LPIPS(net="alex", verbose=False).eval()

    @classmethod
    def missing(cls, width: int | None = None, height: int | None = None) -> str | None:
        """Why LPIPS cannot be computed here, of images of a size if one is given, and how to get it; None if it can."""
        from importlib.util import find_spec
        from pathlib import Path

        if width is not None and height is not None and min(width, height) < cls.SMALLEST:
            return f"LPIPS needs images of at least {cls.SMALLEST} x {cls.SMALLEST} pixels, got {width} x {height}"
        if find_spec("lpips") is None:
            return f"the lpips package is not installed; {cls.HOW_TO_GET}"
        import torch

        if not list(Path(torch.hub.get_dir(), "checkpoints").glob("alexnet-*.pth")):
            return f"the AlexNet weights are not on this machine; {cls.HOW_TO_GET}"
        return None

    def __call__(self, image: Image, reference: Image) -> float:
        """Perceptual distance, 0 for equal images.

        Raises:
            ValueError: If the images are smaller than `SMALLEST`.
        """
        import torch

        height, width = image.shape[:2]
        if min(height, width) < self.SMALLEST:
            raise ValueError(self.missing(width, height))
        a, b = (torch.from_numpy(x.transpose(2, 0, 1)[None].astype(np.float32) * 2 - 1) for x in (image, reference))
        with torch.no_grad():
            return float(self._network(a, b))
