"""A fit that is over in a moment, and has been through all that a long one goes through."""

from novags.splats import FitConfig, McmcConfig

SHORT = FitConfig(iterations=60, sh_degree=1, sh_every=20, checkpoint_every=25, mcmc=McmcConfig(refine_start=10))
