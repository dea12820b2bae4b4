"""The splat engine: 3D Gaussians, their rasterisers, 3DGS-MCMC and the training loop every method shares."""

import lazy_loader

# Each name is imported when it is used: a stage reaches no more code than it needs. The names: __init__.pyi.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
