"""The kernels of a render and its gradient, from Gaussians to pixels and back."""
