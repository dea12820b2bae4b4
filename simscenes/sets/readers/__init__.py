"""Sets from elsewhere: COLMAP models, nerfstudio and instant-ngp, NeRF-synthetic, and pictures without poses."""
