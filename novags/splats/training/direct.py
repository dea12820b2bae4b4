"""An iteration on the CPU without autograd: the kernels, chained, from the parameters to their Adam step.

A loss of pixels and the regularisers give the same bits as `iteration`, in two thirds of the time. Losses of whole
pictures, networks among them, use autograd for themselves alone (`pictures`), and penalties of harmonics are part of a
kernel. Anything out of the ordinary (numbers that are not finite, or very large) changes nothing here and is left to
`iteration`, which finds the fault and reports it.
"""

from functools import partial

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
from .checkpoint import TrainingState
from .config import FitConfig
from .iteration import current
from .pictures import LossTerms, OutOfRange, Rendering, observe, slopes_of

FAR = 1e10  # the default of `rasterize`
STEPS = 10  # iterations after which the coefficients are checked again


class DirectFit:
    """The cameras of a fit, checked once, and the memory that its iterations share."""

    def __init__(self, views: Views, config: FitConfig, extent: float, terms: LossTerms) -> None:
        """Check the cameras.

        Args:
            views: The training views, as given.
            config: How to train.
            extent: Of the scene, world units.
            terms: The loss.

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
        self.views, self.config, self.extent, self.terms = views, config, extent, terms
        self.image_shape = (views.height, views.width, 3)
        self.scale_reg = np.float32(config.scale_reg / config.unit)
        self.calm = 0  # iterations for which the coefficients are known to be small

    def takes(self, gaussians: Gaussians, target: Tensor, rates: LearningRates) -> bool:
        """Whether `step` can do this iteration; if not, autograd does."""
        plain = not target.requires_grad and target.device.type == "cpu"
        if self.terms.compare is not None:
            plain = plain and target.shape == self.image_shape and target.dtype == torch.float32
        plain = plain and all(tensor.is_contiguous() for tensor in gaussians.tensors().values())
        if plain and self.calm == 0:
            # in ten steps Adam moves a parameter by less than a hundred rates
            self.calm = STEPS if max(rates.sh_dc, rates.sh_rest) < 1e3 and _is_small(gaussians.sh) else 0
        return plain and self.calm > 0

    @np.errstate(over="ignore", invalid="ignore")  # infinite values are noticed below
    def step(
        self, state: TrainingState, iteration: int, target: Tensor, rates: LearningRates, means_rate: float,
        with_depth: bool,
    ) -> tuple[float, float] | None:  # fmt: skip
        """Render a view, compare it, and update the Gaussians and their moments in place.

        Cameras that are refined, and networks that are part of the loss, are left their gradients.

        Args:
            state: Its Gaussians are float32 on the CPU, contiguous.
            iteration: From 0.
            target: What its view should show.
            rates: Learning rates.
            means_rate: Of the means, world units.
            with_depth: Whether a loss needs depth.

        Returns:
            Loss and its photometric part; None, with nothing changed, if a number was out of the ordinary.
        """
        self.calm -= 1
        config, gaussians = self.config, state.gaussians
        view, degree = config.view_at(iteration, len(self.cameras)), config.degree_at(iteration)
        views, moves = self._views(state, iteration)
        shape, mean_scale, mean_opacity = self._activate(gaussians)
        opacity_reg = np.float32(config.opacity_reg_at(iteration))
        regularizer = opacity_reg * mean_opacity + self.scale_reg * mean_scale
        rendering = Rendering(gaussians=gaussians, shape=shape, cameras=self.cameras, views=views, degree=degree)
        try:
            frame, image, alpha = rendering(view, with_depth)
            observed = partial(observe, rendering, frame, iteration=iteration, view=view, config=config)
            slopes = slopes_of(self.terms, image, alpha, views, target, observed)
        except OutOfRange:
            return None
        loss = np.float32(slopes.loss + regularizer)
        if not np.isfinite(loss):
            return None
        rows = pipeline.composite_backward(frame, slopes.v_image, slopes.v_alpha)
        v_camera = pipeline.camera_sums(len(gaussians) if moves else 0)
        penalty = self._update(
            state, frame, shape, degree, rows, v_camera, slopes.pull, rates, means_rate, float(opacity_reg)
        )
        if penalty is None:
            return None
        for parameter, gradient in slopes.beside:
            parameter.grad = gradient if parameter.grad is None else parameter.grad + gradient
        if moves and state.cameras is not None:
            slopes.v_viewmats[view] += torch.from_numpy(pipeline.viewmat_gradient(frame.camera, *v_camera))
            (state.cameras.twists.grad,) = torch.autograd.grad(views.viewmats, state.cameras.twists, slopes.v_viewmats)
        return float(loss + penalty), slopes.photometric

    def _views(self, state: TrainingState, iteration: int) -> tuple[Views, bool]:
        """The views where they are now, and whether their cameras learn in this iteration."""
        refinement = self.config.refine_cameras
        moves = refinement is not None and refinement.factor_at(iteration, self.config.iterations) > 0
        if state.cameras is not None:
            state.cameras.twists.requires_grad_(moves)
        return current(self.views, state, self.extent), moves

    def _update(
        self, state: TrainingState, frame: pipeline.RasterFrame, shape: pipeline.Shape, degree: int,
        rows: tuple[np.ndarray, np.ndarray], v_camera: tuple[np.ndarray, np.ndarray], pull: np.ndarray,
        rates: LearningRates, means_rate: float, opacity_reg: float,
    ) -> np.float32 | None:  # fmt: skip
        """An Adam step from the gradient rows; the value of the penalties, or None if nothing was changed."""
        gaussians, adam = state.gaussians, state.adam
        n, sh, (v_rows, slots) = len(gaussians), _rows(gaussians.sh), rows
        v_means, v_quats, v_scales, v_opacities, v_features, v_log_scales, v_logits = carve(
            *(((n, k), np.float32) for k in (3, 4, 3)), (n, np.float32), ((n, 3), np.float32), (3 * n, np.float32),
            (n, np.float32), empty=empty,
        )  # fmt: skip
        trained = [
            t.detach() for t in (gaussians.means, gaussians.quats, gaussians.log_scales, gaussians.logit_opacities)
        ]
        names, found = ("means", "quats", "log_scales", "logit_opacities"), np.zeros(1, np.int64)
        # a penalty reaches harmonics that are not rendered yet
        n_columns = sh.shape[1] if len(pull) else min(3 * (degree + 1) ** 2, sh.shape[1])
        columns = np.full(n_columns, rates.sh_rest, np.float32)
        columns[:3] = rates.sh_dc
        penalties = np.zeros(-(-len(pull) // project_backward.BLOCK))
        run_chain(
            chains.step, n, shape.arrays, frame.vector, frame.center, degree, frame.depth_channel, v_rows.reshape(-1),
            slots, (v_means, v_quats, v_scales, v_opacities), v_features, v_camera, self._shares(n, opacity_reg),
            (v_log_scales, v_logits),
            tuple(t.numpy().reshape(-1) for t in trained),
            tuple(adam.first[name].numpy().reshape(-1) for name in names),
            tuple(adam.second[name].numpy().reshape(-1) for name in names),
            tuple(np.float32(r) for r in (means_rate, rates.quats, rates.log_scales, rates.logit_opacities)),
            (sh, _rows(adam.first["sh"]), _rows(adam.second["sh"])), columns, (pull, penalties),
            adam.numbers(adam.count + 1), found,
        )  # fmt: skip
        if found[0]:
            return None
        adam.count += 1
        return np.float32(penalties.sum())

    def _shares(self, n: int, opacity_reg: float) -> tuple[np.float32, np.float32]:
        """Gradient of each scale and of each opacity from the regularisers of their means."""
        return np.float32(float(self.scale_reg) / (3 * n)), np.float32(opacity_reg / n)

    def _activate(self, gaussians: Gaussians) -> tuple[pipeline.Shape, np.float32, np.float32]:
        """The shape to render, and the means of its scales and opacities."""
        log_scales, logits = _array(gaussians.log_scales), _array(gaussians.logit_opacities)
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
