"""3DGS4LL: pseudo-targets through a small model of the camera that is calibrated on one lit scene."""
