"""3DGS4LL: a lit scene of Gaussians from dark pictures, by a camera model that one lit scene has calibrated.

    target = blur(clip(K code^(1 / gamma) balance)),    loss = (1 - a) photometric(render, target)
             + a photometric(to_dark(render), code),    a grows from 0 to 1/2

That is its first branch; the third is in `luma.py`. photometric is (1 - w) L1 + w (1 - SSIM) of 3DGS. All scores of the
challenge are absolute, and a model that knows the camera's colours wins them: it saw a scene in good light.

Differences from the publication: 100,000 random first points are those of the camera source, as for all methods, and
3DGS-MCMC grows the scene. Its training may learn a dark curve of each picture in the place of the calibrated one; here
it is the calibrated one. Five models are averaged for the challenge: `3dgs4ll*5` does that.
"""

import time
from collections.abc import Iterable
from pathlib import Path

from torch import Tensor

from novags.methods.calibrated.camera_model import CameraModel, amplified, read_calibration, smoothed
from novags.methods.calibrated.config import AmplifiedConfig
from novags.methods.calibrated.fitting import fitted
from novags.methods.problem import Problem, gathered
from novags.methods.reconstruction import Progress, Reconstruction
from novags.splats.training.losses import photometric_loss
from novags.splats.training.step import Step


class DarkLoss:
    """The photometric loss of branch 1: of the lit render, and of what the camera makes of it in the dark."""

    def __init__(self, to_dark: CameraModel, dark: Tensor, config: AmplifiedConfig) -> None:
        self.to_dark, self.dark, self.config = to_dark, dark, config

    def trained_along(self) -> Iterable[Tensor]:
        """Nothing: the camera is calibrated."""
        return ()

    def share(self, iteration: int, iterations: int) -> float:
        """a: how much the dark picture counts."""
        grown = 1.0 if self.config.growing == 0 else min(1.0, iteration / (self.config.growing * iterations))
        return self.config.dark_weight * grown

    def __call__(self, step: Step, target: Tensor) -> Tensor:
        """The loss of a Step whose render is lit."""
        share, weight = self.share(step.iteration, step.iterations), self.config.fit.dssim_weight
        loss = (1 - share) * photometric_loss(step.render, target, weight)
        if share == 0:
            return loss
        return loss + share * photometric_loss(self.to_dark(step.render), self.dark[step.view], weight)


def amplified_targets(dark: Tensor, config: AmplifiedConfig) -> Tensor:
    """The pseudo-targets of branch 1 [C, H, W, 3], of dark codes."""
    known = read_calibration(config.calibration)
    gain, gamma = config.gain or known.gain, config.gamma or known.gamma
    balance = dark.new_tensor(config.balance or known.balance)
    each = (smoothed((amplified(view, gain, gamma) * balance).clamp(0, 1), config.blur) for view in dark)
    return gathered(each, dark)


def train(
    problem: Problem, config: AmplifiedConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct a lit scene from dark pictures; see `Method.train`."""
    started = time.perf_counter()
    dark = problem.encoded(config.pictures)
    targets = amplified_targets(dark, config)
    loss = DarkLoss(read_calibration(config.calibration).to_dark, dark, config)
    return fitted(problem, config, dark, targets, loss, started, progress, checkpoint)
