"""Methods that fit a radiance field instead of Gaussians: a NeRF, and the low-light methods that were built on one."""
