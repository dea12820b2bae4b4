"""What moves Gaussians and cameras from one iteration to the next."""
