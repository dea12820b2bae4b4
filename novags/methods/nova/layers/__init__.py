"""Layers of the denoiser's network that torch has slowly or not at all."""
