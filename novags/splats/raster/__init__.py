"""The call of gsplat and the rasterisers behind it."""
