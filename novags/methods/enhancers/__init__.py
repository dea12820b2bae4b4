"""A dark picture in, a bright one out: one file an enhancer."""
