"""The surroundings of the pixel noise of one frame: random streams, fixed pattern, optics, charge that spreads."""
