"""An iteration on the CPU without autograd: the kernels, chained, from the parameters to their Adam step.

For the plain fit only, whose loss is one of the picture plus regularisers: the same bits as `iteration`, in two thirds
of the time. Anything out of the ordinary (numbers that are not finite, or very large) changes nothing here and is left
to `iteration`, which finds the fault and reports it.
"""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from novags.splats.training.config import LearningRates

from ..cpu import pipeline
from ..cpu.chains import training as chains
from ..cpu.memory import carve, empty
from ..cpu.parallel import run_chain
from ..cpu.raster import project_backward
from ..cpu.training import activations, optimizer
from ..gaussians import Gaussians
from ..raster.validation import check_camera
from ..views import Views
from .config import FitConfig
from .updates.adam import Adam

FAR = 1e10  # the default of `rasterize`
STEPS = 10  # iterations after which the coefficients are checked again


class DirectFit:
    """The cameras of a fit, checked once, and the memory that its iterations share."""

    def __init__(
        self, views: Views, config: FitConfig,
        compare: Callable[[np.ndarray, np.ndarray], tuple[np.float32, np.ndarray]],
    ) -> None:  # fmt: skip
        """Check the cameras.

        Args:
            views: The training views.
            config: How to train.
            compare: Loss of a picture and its target, and its gradient for the picture.

        Raises:
            ValueError: For a camera that `rasterize` would refuse.
        """
        for viewmat, K in zip(views.viewmats, views.Ks, strict=True):
            check_camera({"viewmats": viewmat[None], "Ks": K[None]})
        self.cameras = [
            pipeline.RasterCamera(
                viewmat=_array(viewmat), K=_array(K), width=views.width, height=views.height, near=config.near_plane,
                far=FAR, eps2d=config.eps2d, antialiased=config.antialiased,
            )
            for viewmat, K in zip(views.viewmats, views.Ks, strict=True)
        ]  # fmt: skip
        self.image_shape = (views.height, views.width, 3)
        self.compare = compare
        self.scale_reg = np.float32(config.scale_reg / config.unit)
        self.v_alpha = np.zeros((views.height, views.width), np.float32)
        self.calm = 0  # iterations for which the coefficients are known to be small

    def takes(self, gaussians: Gaussians, target: Tensor, rates: LearningRates) -> bool:
        """Whether `step` can do this iteration; if not, autograd does."""
        plain = target.shape == self.image_shape and not target.requires_grad
        plain = plain and target.dtype == torch.float32 and target.device.type == "cpu"
        plain = plain and all(tensor.is_contiguous() for tensor in gaussians.tensors().values())
        if plain and self.calm == 0:
            # in ten steps Adam moves a parameter by less than a hundred rates
            self.calm = STEPS if max(rates.sh_dc, rates.sh_rest) < 1e3 and _is_small(gaussians.sh) else 0
        return plain and self.calm > 0

    @np.errstate(over="ignore", invalid="ignore")  # infinite values are noticed below
    def step(
        self, gaussians: Gaussians, adam: Adam, view: int, target: Tensor, rates: LearningRates, means_rate: float,
        sh_degree: int, opacity_reg: float,
    ) -> tuple[float, float] | None:  # fmt: skip
        """Render a view, compare it, and update the Gaussians and their moments in place.

        Args:
            gaussians: Float32 on the CPU, contiguous, as is the target.
            adam: Their optimiser.
            view: Number of the camera.
            target: The picture it should show [H, W, 3].
            rates: Learning rates.
            means_rate: Of the means, world units.
            sh_degree: Of the harmonics that are rendered and trained.
            opacity_reg: Weight of the mean opacity.

        Returns:
            Loss and its photometric part; None, with nothing changed, if a number was out of the ordinary.
        """
        self.calm -= 1
        n, sh = len(gaussians), _rows(gaussians.sh)
        log_scales, logits = _array(gaussians.log_scales), _array(gaussians.logit_opacities)
        shape, mean_scale, mean_opacity = self._activate(gaussians, log_scales, logits)
        regularizer = np.float32(opacity_reg) * mean_opacity + self.scale_reg * mean_scale
        frame, image, _ = pipeline.forward(shape, _array(gaussians.sh), self.cameras[view], sh_degree, True, False)
        if frame.splats.suspect:
            return None
        photometric, v_image = self.compare(image, _array(target))
        loss = np.float32(photometric + regularizer)
        if not np.isfinite(loss):
            return None
        v_rows, slots = pipeline.composite_backward(frame, v_image, self.v_alpha)
        v_means, v_quats, v_scales, v_opacities, v_features, v_log_scales, v_logits = carve(
            *(((n, k), np.float32) for k in (3, 4, 3)), (n, np.float32), ((n, 3), np.float32), (3 * n, np.float32),
            (n, np.float32), empty=empty,
        )  # fmt: skip
        trained = [
            t.detach() for t in (gaussians.means, gaussians.quats, gaussians.log_scales, gaussians.logit_opacities)
        ]
        names, found = ("means", "quats", "log_scales", "logit_opacities"), np.zeros(1, np.int64)
        columns = np.full(min(3 * (sh_degree + 1) ** 2, sh.shape[1]), rates.sh_rest, np.float32)
        columns[:3] = rates.sh_dc
        run_chain(
            chains.step, n, shape.arrays, frame.vector, frame.center, sh_degree, v_rows.reshape(-1), slots,
            (v_means, v_quats, v_scales, v_opacities), v_features, np.empty((0, project_backward.V_VIEW), np.float32),
            self._shares(n, opacity_reg), (v_log_scales, v_logits),
            tuple(t.numpy().reshape(-1) for t in trained),
            tuple(adam.first[name].numpy().reshape(-1) for name in names),
            tuple(adam.second[name].numpy().reshape(-1) for name in names),
            tuple(np.float32(r) for r in (means_rate, rates.quats, rates.log_scales, rates.logit_opacities)),
            (sh, _rows(adam.first["sh"]), _rows(adam.second["sh"])), columns, adam.numbers(adam.count + 1), found,
        )  # fmt: skip
        if found[0]:
            return None
        adam.count += 1
        return float(loss), float(photometric)

    def _shares(self, n: int, opacity_reg: float) -> tuple[np.float32, np.float32]:
        """Gradient of each scale and of each opacity from the regularisers of their means."""
        return np.float32(float(self.scale_reg) / (3 * n)), np.float32(float(np.float32(opacity_reg)) / n)

    def _activate(
        self, gaussians: Gaussians, log_scales: np.ndarray, logits: np.ndarray
    ) -> tuple[pipeline.Shape, np.float32, np.float32]:
        """The shape to render, and the means of its scales and opacities."""
        n = len(logits)
        scales, opacities = carve(((n, 3), np.float32), (n, np.float32), empty=empty)
        sums = np.empty(-(-3 * n // activations.BLOCK)), np.empty(-(-n // activations.BLOCK))
        flat = log_scales.reshape(-1), logits, scales.reshape(-1), opacities
        run_chain(chains.activate, n, *flat, *sums)
        shape = pipeline.Shape(
            means=_array(gaussians.means), quats=_array(gaussians.quats), scales=scales, opacities=opacities
        )
        return shape, np.float32(sums[0].sum() / (3 * n)), np.float32(sums[1].sum() / n)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


def _rows(tensor: Tensor) -> np.ndarray:
    """[N, K, 3] as [N, 3 K]."""
    return tensor.detach().numpy().reshape(len(tensor), 3 * tensor.shape[1])


def _is_small(tensor: Tensor) -> bool:
    """Whether no number is so large that a gradient times it might overflow."""
    return bool(tensor.detach().abs().max() < 1e-2 * float(optimizer.LARGE))
