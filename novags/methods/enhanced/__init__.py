"""Gaussians fitted to pictures that were enhanced one by one: the fit, its trainers, the floor and the ceiling."""
