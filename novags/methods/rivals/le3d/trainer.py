"""LE3D (Jin et al. 2024): Gaussians in linear light, coloured by a network, and kept close together along each ray.

    loss = RawNeRF's (`light.raw_loss`) + 0.01 R_T + 0.1 R_dist + 0.01 R_nf

Published: the loss and the weights, the cone scatter (`cone.py`) with 5 points for each first point and an opacity of
0.1, the network and its start (`colours.py`), the learning rates, which fall by half a cosine, and the regularisers
(`regularisers.py`). Of f and b the rates are those of its code; its text has them the other way round.

Chosen by us, for want of them: M = 1 Gaussian at each end of a ray; that R_nf has a gradient for T, and takes expected
depths; that the network first sees each Gaussian from the middle of the cameras.

Differences from the publication: The fit is 3DGS-MCMC with as many Gaussians as all methods have, so that the cone gets
as many points as the first ones leave room for: dense first points leave none. Light is in a unit that brings bright
light to 1, where its first logarithms are at least -5. R_dist and R_nf are taken from pictures of at most `seen` px a
side, 800 in the publication. The colour of a first Gaussian, the mean of the raw data at its projections, is of mosaics
that are interpolated linearly. There is one exposure time.
"""

import dataclasses
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from novags.cameras.points import seen_colors
from novags.methods.denoised.packing import filled
from novags.methods.enhanced.gaussian_fit import fit_for, reconstructed
from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.applying import enhanced
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.light import MeasuredLight, brightness, problem_light, raw_loss
from novags.methods.noise_estimate import noise_of
from novags.methods.problem import Problem, gathered
from novags.methods.reconstruction import Progress, Reconstruction
from novags.methods.rivals.le3d.colours import ColourNetwork, ColourScene, seen_from, with_first_colours
from novags.methods.rivals.le3d.cone import cone_scatter
from novags.methods.rivals.le3d.ends import first_and_last
from novags.methods.rivals.le3d.regularisers import bin_edges, in_bins, near_far, opaque, spread
from novags.methods.rivals.rows.le3d import ColourRates, Le3dConfig
from novags.splats.gaussians import Gaussians
from novags.splats.raster.rasterize import rasterize
from novags.splats.training.companion import Companion
from novags.splats.training.config import FitConfig
from novags.splats.training.fit import fit
from novags.splats.training.step import Info, Step


class SmallView:
    """The Gaussians of a Step from the place of its view, on a picture of at most so many px a side."""

    def __init__(self, step: Step, longest: int, fit: FitConfig) -> None:
        views, share = step.views, min(1.0, longest / max(step.views.width, step.views.height))
        self.width, self.height = (max(1, round(share * side)) for side in (views.width, views.height))
        scale = views.Ks.new_tensor([self.width / views.width, self.height / views.height, 1])
        self.camera = views.viewmats[step.view][None], (scale[:, None] * views.Ks[step.view])[None]
        self.fit, self.gaussians = fit, step.gaussians
        self.scales, self.opacities = self.gaussians.scales, self.gaussians.opacities

    def splat(self, values: Tensor, mode: str, chosen: Tensor | None = None) -> tuple[Tensor, Tensor, Info]:
        """Render values [N, D] of all Gaussians, or of `chosen` ones [N] bool: image, alpha [h, w], and info."""
        g, opacities = self.gaussians, self.opacities
        image, alpha, info = rasterize(
            g.means, g.quats, self.scales, opacities if chosen is None else torch.where(chosen, opacities, 0.0), values,
            *self.camera, self.width, self.height, render_mode=mode, packed=False, backend=self.fit.backend,
            **self.fit.splatting,
        )  # fmt: skip
        return image[0], alpha[0, ..., 0], info


class Le3dLoss:
    """The loss of a Step against raw data; nan data are left out.

    Attributes:
        network: Of the colours.
        white: Where each channel saturates, [3], unit of the render.
        epsilon: In the same unit.
        config: All other choices, with the extent of the scene.
    """

    def __init__(self, network: ColourNetwork, white: Tensor, epsilon: float, config: Le3dConfig) -> None:
        self.network, self.white, self.epsilon, self.config = network, white, epsilon, config

    def __call__(self, step: Step, target: Tensor) -> Tensor:
        """The loss, a scalar."""
        g, config = step.gaussians, self.config
        assert g.features is not None
        colors = seen_from(step.views.centers[step.view], g.means, g.features, g.sh[:, 0], self.network)
        # alpha as a fourth channel: four take as long as three
        image = step.splat(torch.cat([colors, torch.ones_like(colors[:, :1])], 1))
        loss = raw_loss(image[..., :3], target, self.epsilon, self.white.to(image))
        return loss + config.opaque_weight * opaque(image[..., 3]) + self.along_rays(step)

    def along_rays(self, step: Step) -> Tensor | float:
        """R_dist and R_nf, weighted."""
        config, unit = self.config, self.config.fit.unit
        if config.spread_weight == config.near_far_weight == 0:
            return 0.0
        depths = step.info["depths"][0] / unit
        edges = bin_edges(depths[step.visible])
        if edges is None:
            return 0.0
        small, bins = SmallView(step, config.seen, config.fit), in_bins(depths, edges)
        histogram, _, info = small.splat(bins, "RGB")
        loss = config.spread_weight * spread(histogram, edges)
        if config.near_far_weight == 0:
            return loss
        ends = first_and_last(info, small.width, small.height, config.ends)
        maps = (small.splat(bins, "ED", chosen) for chosen in ends)
        near, far = ((depth[..., 0] / unit, alpha) for depth, alpha, _ in maps)
        return loss + config.near_far_weight * near_far(near, far)


def train(
    problem: Problem, config: Le3dConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct the light of a scene from raw frames, or from linear 16-bit pictures; see `Method.train`.

    Returns:
        A reconstruction in linear light, in the unit of the linear 16-bit pictures. Seconds: "fit".

    Raises:
        LacksInput: If the problem has neither raw frames nor 16-bit linear pictures.
        ValueError: If the pictures hold no light; and as `Method.train` says.
    """
    started = time.perf_counter()
    config = dataclasses.replace(config, fit=dataclasses.replace(fit_for(problem, config.fit), sh_degree=0))
    data = problem_light(problem, noise_of(problem), problem.channels_share)
    unit = brightness(data.light)
    with torch.random.fork_rng([]):
        torch.manual_seed(problem.seed)
        network = ColourNetwork().to(data.light.device)
    start = first_gaussians(problem, data, unit, config, network)
    adam = torch.optim.Adam(network.parameters(), lr=config.network_rate)
    companion = Companion(network=network, optimizer=adam)

    def before_step(iteration: int) -> None:
        rates = config.fit.rates
        if isinstance(rates, ColourRates):
            companion.rates = [rates.falling(config.network_rate, iteration, config.fit.iterations)]

    result = fit(
        start, problem.views, lambda i: data.light[i] / unit, config.fit, companion=companion, before_step=before_step,
        photometric=Le3dLoss(network, data.white / unit, config.epsilon / unit, config), progress=progress,
        checkpoint=checkpoint,
    )  # fmt: skip
    matrix = torch.eye(3) if data.matrix is None else data.matrix.cpu()
    base = dataclasses.replace(GaussianScene.of(result.gaussians, config.fit), matrix=unit * matrix)
    centers = dataclasses.replace(problem.views, viewmats=result.viewmats).centers
    return reconstructed(
        result, config, ColourScene.of(base, network.requires_grad_(False), centers.mean(0)), "linear", started,
        found={"unit": unit, "scattered": len(start) - len(problem.start.points)},
        enhancement=enhancement_record(config.enhance, config.pictures),
        enhanced=enhanced(problem, config.enhance, config.pictures),
    )  # fmt: skip


def first_gaussians(
    problem: Problem, data: MeasuredLight, unit: float, config: Le3dConfig, network: ColourNetwork
) -> Gaussians:
    """Gaussians at the first points and in the cone, in the mean colour of the data at their projections."""
    views, like = problem.views, data.light
    viewmats, Ks = (t.cpu().double().numpy() for t in (views.viewmats, views.Ks))
    points = problem.start.points.cpu().double().numpy()
    room = 0 if config.fit.cap_max is None else max(0, config.fit.cap_max - len(points))
    count, rng = min(room, round(config.scatter * len(points))), np.random.default_rng([problem.seed, 0x1E3D])
    more = cone_scatter(points, viewmats, Ks, (views.width, views.height), count, rng)
    points = np.concatenate([points, more])
    mask = data.measured[:1].movedim(-1, 1).to(like)
    whole = (filled(view.nan_to_num(0).movedim(-1, 0)[None], mask)[0].movedim(0, -1) for view in like)
    light = gathered(whole, like).cpu().numpy()
    colors = torch.from_numpy(seen_colors(points, light, viewmats, Ks) / unit).to(like)
    start = Gaussians.from_points(
        torch.from_numpy(points).to(like), colors, sh_degree=0, init_opacity=config.init_opacity,
        init_scale=config.init_scale,
    )  # fmt: skip
    with_first_colours(start, colors, network, views.centers.mean(0), problem.seed)
    return start
