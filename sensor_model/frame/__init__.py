"""What surrounds the pixel noise of one frame: random streams, fixed pattern, optics, charge that spreads."""
