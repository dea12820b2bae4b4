"""Every kernel that fits and renders Gaussians, called once: `novags.warm` compiles them ahead."""

import torch

from novags.splats.training.config import McmcConfig

from .gaussians import Gaussians
from .raster.rasterize import rasterize
from .training.config import FitConfig
from .training.fit import fit
from .training.losses import photometric_loss
from .views import Views


def warm() -> None:
    """Run everything that fits and renders once, on a few Gaussians."""
    g = torch.Generator().manual_seed(0)
    start = Gaussians.from_points(torch.rand(40, 3, generator=g), torch.rand(40, 3, generator=g), sh_degree=0)
    viewmat = torch.eye(4)
    viewmat[2, 3] = 3.0
    K = torch.tensor([[16.0, 0, 8], [0, 16.0, 8], [0, 0, 1]])
    views, image = Views(viewmat[None], K[None], 16, 16), torch.rand(16, 16, 3, generator=g)
    config = FitConfig(iterations=2, sh_degree=1, sh_every=1, mcmc=McmcConfig(refine_start=0, refine_every=1))
    fit(start, views, lambda i: image, config)  # the plain fit, and one whose losses go through autograd
    fit(start, views, lambda i: image, config, extra_losses=[lambda step: step.depth.mean()], needs_depth=True)
    shape = start.means, start.quats, start.scales, start.opacities
    features = torch.rand(40, 6, generator=g).requires_grad_()  # plain channels, more than one pass of them
    renders, _, _ = rasterize(*shape, features, views.viewmats, views.Ks, 16, 16)
    photometric_loss(renders[0], torch.zeros(16, 16, 6), 0.2).backward()
