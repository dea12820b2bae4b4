"""Steps that move Gaussians and cameras from one iteration to the next."""
