"""The splat engine: 3D Gaussians, their rasterisers, 3DGS-MCMC and the training loop every method shares."""
