"""The third branch of 3DGS4LL: colours by a camera model that one lit scene has calibrated, details of a network.

    luma = mean9(m) + 2 (r - mean9(r)),    chroma of m,    m = to_lit(K code^(1 / gamma)), r the network's luma

mean9 is the mean of 3 x 3 pixels; luma and chroma are YCbCr's. The network is Retinexformer, as published.
"""

import time
from pathlib import Path

import torch
from torch import Tensor

from novags.methods.calibrated.camera_model import mean_of_nine, read_calibration
from novags.methods.calibrated.fitting import fitted
from novags.methods.calibrated.luma_row import LumaConfig
from novags.methods.enhancers import network_of
from novags.methods.problem import Problem, gathered
from novags.methods.reconstruction import Progress, Reconstruction

TO_YCBCR = ((0.299, 0.587, 0.114), (-0.168736, -0.331264, 0.5), (0.5, -0.418688, -0.081312))  # ITU-R BT.601


def luma_targets(dark: Tensor, config: LumaConfig) -> Tensor:
    """The pseudo-targets [C, H, W, 3] of dark codes.

    Raises:
        LacksInput: If the weights of the network are not given.
    """
    known, kind = read_calibration(config.calibration), network_of(config.enhance)
    assert kind is not None
    network = kind.load(config.enhance)
    rows = dark.new_tensor(TO_YCBCR)
    back = torch.linalg.inv(rows.double()).to(dark)

    def target(view: Tensor) -> Tensor:
        shown = known.to_lit(known.amplified(view)) @ rows.T
        detail = (kind.picture(network, view, config.enhance)[0] @ rows.T)[..., :1]
        luma = mean_of_nine(shown[..., :1]) + config.detail * (detail - mean_of_nine(detail))
        return (torch.cat([luma, shown[..., 1:]], -1) @ back.T).clamp(0, 1)

    return gathered(map(target, dark), dark)


def train(
    problem: Problem, config: LumaConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct a lit scene from dark pictures; see `Method.train`.

    Raises:
        LacksInput: If the weights of the network are not given.
    """
    started = time.perf_counter()
    dark = problem.encoded(config.pictures)
    return fitted(problem, config, dark, luma_targets(dark, config), None, started, progress, checkpoint)
