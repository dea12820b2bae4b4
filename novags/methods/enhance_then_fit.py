"""The naive pipeline: enhance every view, then fit 3DGS-MCMC to the noisy result.

`naive` takes the paper's loss, L1 and D-SSIM; `naive-l1` L1 alone, which averages noise over the views instead of
rewarding its contrast.
"""

import dataclasses
import time
from dataclasses import dataclass, field
from pathlib import Path

from torch import Tensor

from novags.methods.enhancers.guided import EnhanceConfig, enhance
from novags.methods.nova.trainer import Progress
from novags.methods.problem import MethodInput, MethodResult
from novags.methods.start import start_gaussians
from novags.splats.fit import FitConfig, fit


@dataclass(frozen=True, kw_only=True)
class NaiveConfig:
    """What a fit to given images needs; the names mean what they mean in NovaConfig."""

    enhance: EnhanceConfig = field(default_factory=EnhanceConfig)
    init_scale: float = 0.7
    fit: FitConfig = field(default_factory=FitConfig)

    def with_l1(self) -> "NaiveConfig":
        """The same with L1 as the only image loss: the method `naive-l1`."""
        return dataclasses.replace(self, fit=dataclasses.replace(self.fit, dssim_weight=0.0))


def fit_images(
    inputs: MethodInput, images: Tensor, config: NaiveConfig, progress: Progress | None, checkpoint: Path | None
) -> MethodResult:
    """Fit Gaussians to images [C, H, W, 3] that stay as they are."""
    fit_config = dataclasses.replace(config.fit, seed=inputs.seed, extent=inputs.init.extent)
    start = start_gaussians(
        inputs.init, inputs.dark, images, sh_degree=fit_config.sh_degree, init_scale=config.init_scale
    )
    result = fit(start, inputs.views, lambda i: images[i], fit_config, progress=progress, checkpoint=checkpoint)
    return MethodResult(
        gaussians=result.gaussians,
        enhanced=images,
        targets=images,
        losses=result.losses,
        seconds={"fit": result.seconds},
        config=dataclasses.asdict(dataclasses.replace(config, fit=fit_config)),
    )


def train(
    inputs: MethodInput, config: NaiveConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> MethodResult:
    """Reconstruct from the enhanced noisy images.

    Args:
        inputs: Views, dark images, initial points and seed.
        config: All choices; `config.fit.seed` and `config.fit.extent` are overridden by `inputs`.
        progress: As in `splats.fit`.
        checkpoint: As in `splats.fit`.

    Returns:
        MethodResult whose targets are the enhanced images. Seconds: "enhance" and "fit".
    """
    started = time.perf_counter()
    enhanced, _ = enhance(inputs.dark, config.enhance)
    seconds = time.perf_counter() - started
    result = fit_images(inputs, enhanced, config, progress, checkpoint)
    result.seconds = {"enhance": seconds, **result.seconds}
    return result
