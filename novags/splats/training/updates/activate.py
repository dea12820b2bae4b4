"""Scales and opacities of trained Gaussians, and the 3DGS-MCMC regularisers, which are their means."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...cpu.memory import empty
from ...cpu.parallel import run
from ...cpu.training import activations
from ...first_order import first_order
from ...gaussians import Gaussians


def activate(
    gaussians: Gaussians, opacity_reg: float, scale_reg: float, *, fused: bool = True
) -> tuple[Tensor, Tensor, Tensor]:
    """Scales [N, 3], opacities [N], and the scalar opacity_reg * mean(opacities) + scale_reg * mean(scales).

    `fused`: by the CPU's kernels where they apply, which have no second derivative.
    """
    if fused and gaussians.means.device.type == "cpu":
        scales, mean_scale = _Activate.apply(gaussians.log_scales, False)
        opacities, mean_opacity = _Activate.apply(gaussians.logit_opacities, True)
        return scales, opacities, opacity_reg * mean_opacity + scale_reg * mean_scale
    scales, opacities = gaussians.scales, gaussians.opacities
    return scales, opacities, opacity_reg * opacities.mean() + scale_reg * scales.mean()


class _Activate(torch.autograd.Function):
    """exp or sigmoid of all values, and their mean, in one pass each way."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, is_sigmoid: bool) -> tuple[Tensor, Tensor]:
        inputs = values.detach().contiguous().numpy().reshape(-1)
        blocks = -(-inputs.size // activations.BLOCK)
        outputs, sums = empty(inputs.shape), np.empty(blocks)
        run(activations.forward, blocks, 1, is_sigmoid, inputs, outputs, sums)
        ctx.is_sigmoid, activated = is_sigmoid, torch.from_numpy(outputs).reshape(values.shape)
        ctx.save_for_backward(activated)
        return activated, values.new_tensor(sums.sum() / inputs.size)

    @staticmethod
    @first_order
    def backward(ctx: Any, v_values: Tensor, v_mean: Tensor) -> tuple[Tensor, None]:
        outputs = ctx.saved_tensors[0].numpy().reshape(-1)
        v_outputs = v_values.contiguous().numpy().reshape(-1)
        v_inputs, share = empty(outputs.shape), np.float32(float(v_mean) / outputs.size)
        blocks = -(-outputs.size // activations.BLOCK)
        run(activations.backward, blocks, 1, ctx.is_sigmoid, outputs, v_outputs, share, v_inputs)
        return torch.from_numpy(v_inputs).reshape(v_values.shape), None
