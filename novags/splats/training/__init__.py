"""The fit of Gaussians to views: 3DGS-MCMC, its losses, optimiser, checkpoints, and the guard of finite values."""
