"""The second engine: a radiance field on grids, and its ray marcher, for methods that fit no splats."""
