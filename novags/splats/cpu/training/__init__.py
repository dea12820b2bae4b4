"""The kernels of a fit beside its renders: activations, losses, optimiser, noise."""
